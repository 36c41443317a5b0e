"""Small maps to look at."""

from __future__ import annotations

import functools

import numpy as np

from companion.mapping.voxels.chunks import NOTHING, OFFSETS
from companion.mapping.voxels.piece import MapPiece
from companion.viewer.voxels import PackedVoxels, packed
from tests.mapping.files.test_facts import Held

VOXEL_M, THRESHOLD = 0.1, 847
FREE, UNDECIDED, OCCUPIED = -1000, 100, 2000


@functools.cache
def tunnel(length: int = 60) -> PackedVoxels:
    """Free where 0 <= x < length, 0 <= y < 20, 0 <= z < 12, a shell around it, and (-9, 0, 0) undecided; in voxels."""
    last = -(-length // 16) + 1
    chunks = np.stack(np.meshgrid(range(-1, last), range(-1, 2), range(-1, 2), indexing="ij"), axis=-1).reshape(-1, 3)
    # Axis by axis, and small numbers: the places of all voxels at once take gigabytes, and half a minute.
    free = np.ones((len(chunks), len(OFFSETS)), np.bool_)
    within, undecided = free.copy(), free.copy()
    for axis, (size, odd) in enumerate(((length, -9), (20, 0), (12, 0))):
        at = 16 * chunks[:, None, axis].astype(np.int32) + OFFSETS[:, axis].astype(np.int32)
        free &= (at >= 0) & (at < size)
        within &= (at >= -1) & (at <= size)
        undecided &= at == odd
    values = np.full(free.shape, NOTHING, np.int16)
    values[within], values[free], values[undecided] = OCCUPIED, FREE, UNDECIDED
    return packed(Held(chunks.astype(np.int32), values))


def nothing() -> PackedVoxels:
    """A map in which nothing was seen."""
    empty = MapPiece(np.zeros((1, 3), np.int32), np.full((1, 4096), NOTHING))
    return packed(Held(empty.chunks, empty.values))
