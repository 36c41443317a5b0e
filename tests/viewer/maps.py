"""Small maps to look at."""

from __future__ import annotations

import numpy as np

from companion.mapping.voxels.chunks import NOTHING, OFFSETS
from companion.mapping.voxels.piece import MapPiece
from companion.viewer.voxels import PackedVoxels, packed
from tests.mapping.files.test_facts import Held

VOXEL_M, THRESHOLD = 0.1, 847
FREE, UNDECIDED, OCCUPIED = -1000, 100, 2000


def tunnel(length: int = 60) -> PackedVoxels:
    """Free where 0 <= x < length, 0 <= y < 20, 0 <= z < 12, a shell around it, and (-9, 0, 0) undecided; in voxels."""
    last = -(-length // 16) + 1
    chunks = np.stack(np.meshgrid(range(-1, last), range(-1, 2), range(-1, 2), indexing="ij"), axis=-1).reshape(-1, 3)
    voxels = chunks[:, None] * 16 + OFFSETS
    size = np.array([length, 20, 12])
    free = ((voxels >= 0) & (voxels < size)).all(axis=-1)
    shell = ((voxels >= -1) & (voxels <= size)).all(axis=-1) & ~free
    values = np.full(free.shape, NOTHING)
    values[free], values[shell] = FREE, OCCUPIED
    values[(voxels == [-9, 0, 0]).all(axis=-1)] = UNDECIDED
    return packed(Held(chunks.astype(np.int32), values))


def nothing() -> PackedVoxels:
    """A map in which nothing was seen."""
    empty = MapPiece(np.zeros((1, 3), np.int32), np.full((1, 4096), NOTHING))
    return packed(Held(empty.chunks, empty.values))
