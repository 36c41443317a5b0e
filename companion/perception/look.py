"""A look around: what one sensor saw horizontally, as bearing bins about the pose at which it looked."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from companion.model import CLEAR, HIT, UNKNOWN, FloatArray, PlanarScan


class Look(NamedTuple):
    """One sensor's contribution to N(t). A tuple, so that compiled functions take it whole.

    Attributes:
        t_s: when it looked.
        x_m, y_m, yaw_rad: from where; bearings count from ``yaw_rad``.
        ranges_m: (bins,) as in `companion.model.Scan`.
        state: (bins,) uint8; UNKNOWN where it did not look or could not tell.
        covered: (bins,) bool, True where the sensor looks at all.
        limit_m: the range limit of CLEAR.
        inferred: (bins,) bool, HIT though nothing came back from there: floor and roof end at it.
    """

    t_s: float
    x_m: float
    y_m: float
    yaw_rad: float
    ranges_m: FloatArray
    state: NDArray[np.uint8]
    covered: NDArray[np.bool_]
    limit_m: float
    inferred: NDArray[np.bool_]


def bin_bearings(bins: int) -> FloatArray:
    """Centres of ``bins`` even bearings over [-π, π)."""
    return np.asarray(-np.pi + (np.arange(bins) + 0.5) * (2.0 * np.pi / bins), np.float64)


def planar_look(planar: PlanarScan, bins: int) -> Look:
    """A planar scan as a look: the nearest ray of each bearing bin; CLEAR where all its rays saw nothing near."""
    ranges, state = np.zeros(bins), np.full(bins, UNKNOWN, np.uint8)
    index = ((planar.bearings_rad + np.pi) / (2.0 * np.pi) * bins).astype(np.int64) % bins
    # Many scanners say 0 for no return: it is no obstacle at 0 m.
    measured = planar.ranges_m > 0.0
    nearest = np.full(bins, np.inf)
    np.minimum.at(nearest, index[measured], planar.ranges_m[measured])
    looked = np.zeros(bins, np.bool_)
    looked[index[measured]] = True
    hit = looked & (nearest < planar.max_range_m)
    ranges[hit], state[hit] = nearest[hit], HIT
    clear = looked & ~hit
    ranges[clear], state[clear] = planar.max_range_m, CLEAR
    pose = planar.pose
    return Look(
        planar.t_s,
        pose.x_m,
        pose.y_m,
        pose.yaw_rad,
        ranges,
        state,
        looked,
        planar.max_range_m,
        np.zeros(bins, np.bool_),
    )
