"""Colours for heights."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from companion.mapping.files.export import Export
from companion.model import FloatArray

_STOPS = np.array([[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]], np.float64)
"""Viridis at even steps: dark is low; it reads in grey and with any colour vision."""


def height_colours(heights_m: FloatArray, export: Export) -> NDArray[np.uint8]:
    """(n, 3) red, green and blue for ``heights_m`` (n,), from the lowest occupied voxel of the map to the highest."""
    lowest_m, highest_m = ((float(at[2]) + 0.5) * export.source.voxel_m for at in (export.lowest, export.highest))
    # All at one height are all the lowest.
    share = (heights_m - lowest_m) / max(highest_m - lowest_m, np.finfo(np.float64).tiny)
    return viridis(share)


def viridis(shares: FloatArray) -> NDArray[np.uint8]:
    """(..., 3) red, green and blue for ``shares`` (...), from 0, the lowest, to 1."""
    at = np.linspace(0.0, 1.0, len(_STOPS))
    return np.stack([np.interp(shares, at, stops) for stops in _STOPS.T], axis=-1).round().astype(np.uint8)
