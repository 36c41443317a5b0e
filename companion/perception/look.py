"""A look around: what one sensor saw horizontally, as bearing bins about the pose at which it looked."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.model import FloatArray


@dataclass(frozen=True, slots=True)
class Look:
    """One sensor's contribution to N(t).

    Attributes:
        t_s: when it looked.
        x_m, y_m, yaw_rad: from where; bearings count from ``yaw_rad``.
        ranges_m: (bins,) as in `companion.model.Scan`.
        state: (bins,) uint8; UNKNOWN where it did not look or could not tell.
        covered: (bins,) bool, True where the sensor looks at all.
        limit_m: the range limit of CLEAR.
    """

    t_s: float
    x_m: float
    y_m: float
    yaw_rad: float
    ranges_m: FloatArray
    state: NDArray[np.uint8]
    covered: NDArray[np.bool_]
    limit_m: float


def bin_bearings(bins: int) -> FloatArray:
    """Centres of ``bins`` even bearings over [-π, π)."""
    return np.asarray(-np.pi + (np.arange(bins) + 0.5) * (2.0 * np.pi / bins), np.float64)
