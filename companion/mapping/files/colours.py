"""Colours for heights."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from companion.model import FloatArray

_STOPS = np.array([[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]], np.float64)
"""Viridis at even steps: dark is low; it reads in grey and with any colour vision."""


def height_colours(heights_m: FloatArray) -> NDArray[np.uint8]:
    """(n, 3) red, green and blue for ``heights_m`` (n,), from the lowest to the highest of them."""
    if len(heights_m) == 0:
        return np.zeros((0, 3), np.uint8)
    lowest_m, highest_m = float(heights_m.min()), float(heights_m.max())
    # All at one height are all the lowest.
    share = (heights_m - lowest_m) / max(highest_m - lowest_m, np.finfo(np.float64).tiny)
    at = np.linspace(0.0, 1.0, len(_STOPS))
    return np.stack([np.interp(share, at, stops) for stops in _STOPS.T], axis=1).round().astype(np.uint8)
