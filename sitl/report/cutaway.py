"""Takes the roof off a map, so that one can look into it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sitl.report.data import Array, Points

_CELL_M = 0.25
_REACH_CELLS = 4  # 1 m: walls seen only high up still find the floor beside them


def below_cut(points_m: Points, height_m: float) -> NDArray[np.bool_]:
    """Which points (n, 3), n > 0, lie less than ``height_m`` above the floor there.

    The floor is the lowest of them within a metre, so the cut follows slopes. Where one drift passes over another, the
    lower one remains.
    """
    low, high = points_m[:, :2].min(axis=0), points_m[:, :2].max(axis=0)
    columns, rows = ((high - low) / _CELL_M).astype(np.int64) + 1
    floor = np.full((columns, rows), np.inf)
    i, j = ((points_m[:, :2] - low) / _CELL_M).astype(np.int64).T
    np.minimum.at(floor, (i, j), points_m[:, 2])
    floor = _smoothed(_lowest_around(floor), np.isfinite(floor))
    return np.asarray(points_m[:, 2] < floor[i, j] + height_m)


def _lowest_around(floor_m: Array) -> Array:
    """The least value within `_REACH_CELLS` along each axis."""
    for axis in (0, 1):
        floor_m = _windows(floor_m, axis, np.inf).min(axis=-1)
    return floor_m


def _smoothed(floor_m: Array, known: NDArray[np.bool_]) -> Array:
    """The mean over the same reach, of known cells only."""
    total, count = np.where(known, floor_m, 0.0), known.astype(np.float64)
    for axis in (0, 1):
        total, count = (_windows(field, axis, 0.0).sum(axis=-1) for field in (total, count))
    return np.divide(total, count, out=np.full_like(total, np.inf), where=count > 0)


def _windows(field: Array, axis: int, outside: float) -> Array:
    """The values within `_REACH_CELLS` of each cell along an axis, as a last axis."""
    pads = [(_REACH_CELLS, _REACH_CELLS) if k == axis else (0, 0) for k in (0, 1)]
    padded = np.pad(field, pads, constant_values=outside)
    return np.lib.stride_tricks.sliding_window_view(padded, 2 * _REACH_CELLS + 1, axis=axis)
