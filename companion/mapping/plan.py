"""The plan at flight height that a flood fill draws through a map: where the vehicle could be, and what it knows there.

A cell of the plan is a square of about 10 cm, and each place on it a node. Nodes over one cell that are further apart
in height than `same_level_m` are different places, as in a spiral ramp. Compiled, because it looks at every cell once a
second.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from companion.mapping.chunks import EDGE, MASK, SHIFT, Integer, chunk_key, place_of
from companion.mapping.lookup import FREE, OCCUPIED, UNKNOWN
from companion.model import FloatArray

TILE = 16
"""Cells along one edge of a tile: cells are found through the tile that they are on."""

BEYOND = np.uint8(3)
"""Kind of a node that lies behind an unknown one: nobody has asked yet whether a way leads there."""

OPEN, MISSING, SEEN = np.uint8(0), np.uint8(1), np.uint8(2)
"""What is known of the floor or of the roof over a cell: too far off to say, should have been seen, was seen."""


class Voxels(NamedTuple):
    """A map as the compiled functions read it.

    Attributes:
        keys: (n,) int64 packed chunk coordinates, ascending.
        states: (n, 4096) uint8 states of their voxels, in Morton order.
    """

    keys: NDArray[np.int64]
    states: NDArray[np.uint8]


class Shape(NamedTuple):
    """The numbers of the flood fill.

    Attributes:
        voxel_m: edge of a voxel.
        stride: voxels along one edge of a cell.
        height_m: H.
        half_slab_m: what is this much above or below the centre of the vehicle is in its way.
        up_m: the roof counts up to this height above the vehicle.
        down_m: the floor counts down to this depth below it.
        max_slope: steepest ground that is followed, rise over run.
        same_level_m: nodes of one cell within this height are the same.
        kept_m: so near to where the vehicle was there is nothing that was not seen.
        fuzz_m: so far behind unknown cells it is asked for the wall to which they may belong.
    """

    voxel_m: float
    stride: int
    height_m: float
    half_slab_m: float
    up_m: float
    down_m: float
    max_slope: float
    same_level_m: float
    kept_m: float
    fuzz_m: float


class Plan(NamedTuple):
    """The nodes.

    Attributes:
        tiles: (a, b) int32 number of the tile there, -1 where there is none.
        low: (2,) int64 tile coordinates of the corner of ``tiles``.
        heads: (tiles, 256) int32 a node on each cell, or -1.
        nexts: (capacity,) int32 another node on the same cell, or -1.
        cells: (capacity, 2) int32 cell coordinates of each node.
        heights_m: (capacity,) height of the vehicle there.
        kinds: (capacity,) uint8 `FREE`, `OCCUPIED`, `UNKNOWN` or `BEYOND`.
        roof: (capacity,) uint8 `OPEN`, `MISSING` or `SEEN`, for free nodes.
        floor: (capacity,) uint8 likewise.
    """

    tiles: NDArray[np.int32]
    low: NDArray[np.int64]
    heads: NDArray[np.int32]
    nexts: NDArray[np.int32]
    cells: NDArray[np.int32]
    heights_m: FloatArray
    kinds: NDArray[np.uint8]
    roof: NDArray[np.uint8]
    floor: NDArray[np.uint8]


@njit(cache=True, nogil=True)
def packed(chunks: NDArray[np.int32]) -> NDArray[np.int64]:
    """(n,) the key of each of ``chunks`` (n, 3)."""
    keys = np.empty(chunks.shape[0], np.int64)
    for n in range(chunks.shape[0]):
        keys[n] = chunk_key(np.int64(chunks[n, 0]), np.int64(chunks[n, 1]), np.int64(chunks[n, 2]))
    return keys


@njit(cache=True, nogil=True)
def _row(keys: NDArray[np.int64], key: Integer) -> int:
    low, high = 0, keys.shape[0]
    while low < high:
        middle = (low + high) // 2
        if keys[middle] < key:
            low = middle + 1
        else:
            high = middle
    return low if low < keys.shape[0] and keys[low] == key else -1


_LEVELS = np.array([int(place_of.py_func(0, 0, z)) for z in range(EDGE)])
"""(16,) the part of a voxel's place that follows from its height in the chunk."""


@njit(cache=True, nogil=True)
def _read_column(voxels: Voxels, x: int, y: int, z: int, column: NDArray[np.uint8]) -> None:
    """The states of the voxels from (x, y, z) upwards."""
    base = place_of(x & MASK, y & MASK, 0)
    row = -1
    for n in range(column.shape[0]):
        at = (z + n) & MASK
        if n == 0 or at == 0:
            row = _row(voxels.keys, chunk_key(x >> SHIFT, y >> SHIFT, (z + n) >> SHIFT))
        column[n] = voxels.states[row, base | _LEVELS[at]] if row >= 0 else UNKNOWN


@njit(cache=True, nogil=True)
def _tile(plan: Plan, i: int, j: int) -> int:
    a, b = i // TILE - plan.low[0], j // TILE - plan.low[1]
    inside = 0 <= a < plan.tiles.shape[0] and 0 <= b < plan.tiles.shape[1]
    return int(plan.tiles[a, b]) if inside else -1


@njit(cache=True, nogil=True)
def node_at(plan: Plan, i: int, j: int, height_m: float, same_level_m: float) -> int:
    """The node on cell (i, j) at about this height, or -1."""
    tile = _tile(plan, i, j)
    if tile < 0:
        return -1
    node = int(plan.heads[tile, i % TILE * TILE + j % TILE])
    while node >= 0 and abs(plan.heights_m[node] - height_m) >= same_level_m:
        node = int(plan.nexts[node])
    return node


@njit(cache=True, nogil=True)
def _surface(column: NDArray[np.uint8], start: int, step: int, limit: int, gap: int) -> np.uint8:
    """What is known of the first surface from ``start`` on, up to ``limit`` voxels away.

    A few voxels of which the looks did not decide may lie before it.
    """
    unknown, at = 0, start
    for _ in range(limit):
        if at < 0 or at >= column.shape[0]:
            return OPEN
        if column[at] == OCCUPIED:
            return SEEN
        unknown += column[at] == UNKNOWN
        if unknown > gap:
            return MISSING
        at += step
    return OPEN


@njit(cache=True, nogil=True)
def _add(
    voxels: Voxels, plan: Plan, s: Shape, tile: int, i: int, j: int, from_m: float, flown: bool, node: int
) -> None:
    """Make ``node`` of cell (i, j), coming from a height of ``from_m`` beside it."""
    half = max(1, round(s.half_slab_m / s.voxel_m))
    gap = max(1, round(_GAP_M / s.voxel_m))
    below = math.ceil((max(s.height_m + _DROP_M, s.down_m) + s.half_slab_m) / s.voxel_m)
    above = math.ceil((s.up_m + s.half_slab_m) / s.voxel_m) + gap + 1
    bottom = math.floor(from_m / s.voxel_m) - below
    column = np.empty(below + above, np.uint8)
    middle = s.stride // 2
    _read_column(voxels, i * s.stride + middle, j * s.stride + middle, bottom, column)

    height_m = from_m
    if not flown:
        for n in range(below - half, -1, -1):
            if column[n] == OCCUPIED:
                most_m = s.max_slope * s.stride * s.voxel_m
                wanted_m = (bottom + n + 1) * s.voxel_m + s.height_m
                height_m += min(max(wanted_m - from_m, -most_m), most_m)
                break
    centre = math.floor(height_m / s.voxel_m) - bottom

    low = max(centre - half, 0)
    occupied, free = 0, 0
    for a in range(s.stride):
        for b in range(s.stride):
            slab = column[low : low + 2 * half + 1]
            if a != middle or b != middle:
                slab = np.empty(2 * half + 1, np.uint8)
                _read_column(voxels, i * s.stride + a, j * s.stride + b, bottom + low, slab)
            for state in slab:
                occupied += state == OCCUPIED
                free += state == FREE
    kind = OCCUPIED if occupied > 0 else FREE if 2 * free > (2 * half + 1) * s.stride**2 else UNKNOWN
    # Whoever has been there knows that it is free.
    plan.kinds[node] = FREE if flown else kind
    plan.roof[node] = _surface(column, centre + half, 1, math.floor(s.up_m / s.voxel_m) - half + gap, gap)
    plan.floor[node] = _surface(column, centre - half, -1, math.floor(s.down_m / s.voxel_m) - half + gap, gap)
    plan.cells[node, 0], plan.cells[node, 1] = i, j
    plan.heights_m[node] = height_m
    place = i % TILE * TILE + j % TILE
    plan.nexts[node] = plan.heads[tile, place]
    plan.heads[tile, place] = node


_GAP_M = 0.2
_DROP_M = 1.0
"""How far below where it should be the ground is still looked for."""


@njit(cache=True, nogil=True)
def flood(voxels: Voxels, plan: Plan, shape: Shape, flown_m: FloatArray) -> tuple[int, int]:
    """Fill an empty plan from the places flown, through all that is free at flight height.

    Args:
        voxels: the map.
        plan: is filled.
        shape: the numbers.
        flown_m: (n, 3) places where the vehicle was.

    Returns:
        How many nodes there are, of which the first are the places flown, and how many these are. A number of -1 nodes
        says that there was no room.
    """
    edge_m = shape.stride * shape.voxel_m
    size = 0
    for n in range(flown_m.shape[0]):
        i, j = math.floor(flown_m[n, 0] / edge_m), math.floor(flown_m[n, 1] / edge_m)
        size += _enter(voxels, plan, shape, i, j, flown_m[n, 2], True, size)
    flown = size
    # The camera looks past what is beside it: around the place of the take-off nothing is known for a while.
    last_i, last_j = 0, 0
    for n in range(flown):
        i, j = plan.cells[n, 0], plan.cells[n, 1]
        if n > 0 and max(abs(i - last_i), abs(j - last_j)) * edge_m < shape.kept_m / 2.0:
            continue
        last_i, last_j = i, j
        before = size
        size = _enter_around(voxels, plan, shape, n, shape.kept_m / edge_m, size)
        for m in range(before, size):
            plan.kinds[m] = FREE if plan.kinds[m] == UNKNOWN else plan.kinds[m]
    done = 0
    while done < size:
        if plan.kinds[done] == FREE:
            for side in range(4):
                i, j = plan.cells[done, 0] + SIDES[side, 0], plan.cells[done, 1] + SIDES[side, 1]
                size += _enter(voxels, plan, shape, i, j, plan.heights_m[done], False, size)
        done += 1
    for n in range(done):
        if plan.kinds[n] == UNKNOWN:
            before = size
            size = _enter_around(voxels, plan, shape, n, shape.fuzz_m / edge_m, size)
            for m in range(before, size):
                plan.kinds[m] = OCCUPIED if plan.kinds[m] == OCCUPIED else BEYOND
    return -1 if size == plan.nexts.shape[0] else size, flown


@njit(cache=True, nogil=True)
def _enter(voxels: Voxels, plan: Plan, shape: Shape, i: int, j: int, from_m: float, flown: bool, size: int) -> int:
    """Make a node where there is none; how many were made: one or none."""
    tile = _tile(plan, i, j)
    if tile < 0 or size == plan.nexts.shape[0] or node_at(plan, i, j, from_m, shape.same_level_m) >= 0:
        return 0
    _add(voxels, plan, shape, tile, i, j, from_m, flown, size)
    return 1


@njit(cache=True, nogil=True)
def _enter_around(voxels: Voxels, plan: Plan, shape: Shape, n: int, radius_cells: float, size: int) -> int:
    """Make the nodes that are missing around node ``n``; how many nodes there are then."""
    rim = math.floor(radius_cells)
    for a in range(-rim, rim + 1):
        for b in range(-rim, rim + 1):
            if a * a + b * b <= radius_cells * radius_cells:
                i, j = plan.cells[n, 0] + a, plan.cells[n, 1] + b
                size += _enter(voxels, plan, shape, i, j, plan.heights_m[n], False, size)
    return size


SIDES = np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
"""From a cell to the four beside it."""
