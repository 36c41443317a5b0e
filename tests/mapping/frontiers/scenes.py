"""Small maps for the tests of what is known, made without the code under test."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from companion.mapping import FREE, OCCUPIED, UNKNOWN, MapSnapshot
from companion.mapping.frontiers.frontier import Reach
from companion.mapping.voxels.chunks import OFFSETS

Dense = NDArray[np.uint8]

REACH = Reach(
    height_m=1.5,
    margin_m=1.0,
    critical_margin_m=0.7,
    half_slab_m=0.4,
    max_slope=0.7,
    look_m=6.0,
    up_rad=math.radians(28.5),
    down_rad=math.radians(28.5),
)
"""What the vehicle of these tests can do."""


def snapshot(dense: Dense, voxel_m: float = 0.1) -> MapSnapshot:
    """The map whose voxel (i, j, k) is ``dense[i, j, k]``; beyond it everything is unknown."""
    shape = [-(-n // 16) for n in dense.shape]
    padded = np.full([16 * n for n in shape], UNKNOWN, np.uint8)
    padded[tuple(slice(n) for n in dense.shape)] = dense
    chunks = np.array(list(np.ndindex(*shape)), np.int32)
    places = 16 * chunks[:, np.newaxis, :] + OFFSETS[np.newaxis]
    return MapSnapshot(voxel_m, 1, chunks, padded[tuple(np.moveaxis(places, -1, 0))])


def some_chunks(whole: MapSnapshot, chosen: NDArray[np.integer]) -> MapSnapshot:
    """A part of a snapshot."""
    return MapSnapshot(whole.voxel_m, whole.revision, whole.chunks[chosen], whole.states[chosen])


def room(x_m: float = 8.0, y_m: float = 6.0, z_m: float = 3.0, voxel_m: float = 0.1) -> Dense:
    """A closed room that was wholly seen: free, with two voxels of rock all around."""
    cells = [round(edge_m / voxel_m) + 4 for edge_m in (x_m, y_m, z_m)]
    dense = np.full(cells, OCCUPIED, np.uint8)
    dense[2:-2, 2:-2, 2:-2] = FREE
    return dense


def speckled(seed: int, edge: int = 40) -> Dense:
    """Free space with single voxels and blocks that are occupied or unknown, drawn by a seed."""
    random = np.random.default_rng(seed)
    dense = np.full((edge, edge, edge), FREE, np.uint8)
    dense[random.random(dense.shape) < 0.004] = OCCUPIED
    dense[random.random(dense.shape) < 0.003] = UNKNOWN
    dense[5:15, 5:15, 5:15] = OCCUPIED
    dense[25:35, 20:30, 3:9] = UNKNOWN
    return dense
