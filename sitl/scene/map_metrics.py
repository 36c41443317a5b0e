"""How good a map is against the truth (METHOD: Definition 2.3 in simulation)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from companion.mapping.voxels.voxel_map import VoxelMap


def completeness(voxels: VoxelMap, truth_points: NDArray[np.floating]) -> float:
    """The share of ``truth_points`` (n, 3), in m, within one voxel of an occupied voxel; NaN when there are none."""
    return _share(voxels.occupied_near(truth_points))


def precision(distances_m: NDArray[np.floating], voxel_m: float) -> float:
    """The share of occupied voxels within one voxel of the true surface; NaN when there are none.

    Args:
        distances_m: (n,) distance of each occupied voxel's centre to the true surface, never negative.
        voxel_m: edge of a voxel.
    """
    return _share(distances_m <= voxel_m)


def accuracy_m(distances_m: NDArray[np.floating]) -> float:
    """The mean of ``distances_m`` (n,), from occupied voxels' centres to the true surface; NaN when there are none."""
    return float(np.mean(distances_m)) if len(distances_m) else float("nan")


def _share(true: NDArray[np.bool_]) -> float:
    return float(np.mean(true)) if len(true) else float("nan")
