"""How good a map is against the truth (METHOD: Definition 2.3 in simulation)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def precision(distances_m: NDArray[np.floating], voxel_m: float) -> float:
    """The share of occupied voxels within one voxel of the true surface; NaN when there are none.

    Args:
        distances_m: (n,) distance of each occupied voxel's centre to the true surface, never negative.
        voxel_m: edge of a voxel.
    """
    return float(np.mean(distances_m <= voxel_m)) if len(distances_m) else float("nan")


def accuracy_m(distances_m: NDArray[np.floating]) -> float:
    """The mean of ``distances_m`` (n,), from occupied voxels' centres to the true surface; NaN when there are none."""
    return float(np.mean(distances_m)) if len(distances_m) else float("nan")
