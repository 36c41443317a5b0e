"""Fewer values that show the same."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sitl.report.data import Array


def thinned(t_s: Array, values: Array, bins: int) -> tuple[Array, Array]:
    """The least and the greatest value of each of at most ``bins`` pieces, in their order.

    A dip of one sample stays visible. A piece of nothing but NaN leaves one, so gaps stay gaps.
    """
    size = -(-len(values) // bins)
    if size <= 2:
        return t_s, values
    padded = np.concatenate([values, np.full(-len(values) % size, np.nan)]).reshape(-1, size)
    known = np.isfinite(padded)
    lowest = np.argmin(np.where(known, padded, np.inf), axis=1)
    highest = np.argmax(np.where(known, padded, -np.inf), axis=1)
    picked = np.sort(np.stack([lowest, highest], axis=1), axis=1) + size * np.arange(len(padded))[:, None]
    picked = np.minimum(picked.ravel(), len(values) - 1)
    return t_s[picked], values[picked]


def stretches(modes: NDArray[np.uint8]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Where each run of equal values begins, and the index after its end."""
    changes = np.flatnonzero(np.diff(modes)) + 1
    bounds = np.unique(np.concatenate([[0], changes, [len(modes)]]))
    return bounds[:-1], bounds[1:]
