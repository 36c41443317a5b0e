"""Third pass over a frame: what was seen goes into the log-odds of the map. Also how one map goes into another."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from companion.mapping.carve import UNSEEN, carve_chunk, cube_of, judge
from companion.mapping.chunks import EDGE, NOTHING, OFFSETS, VOLUME, WORDS, ChunkTable, add_row, find_row, is_full
from companion.mapping.depth_image import ClearDepth
from companion.mapping.marks import Marks
from companion.mapping.sensor_model import Steps
from companion.mapping.view import Box, Projection


@njit(cache=True, nogil=True, error_model="numpy")
def update_chunks(
    table: ChunkTable,
    box: Box,
    start: int,
    marks: Marks,
    clear: ClearDepth,
    p: Projection,
    steps: Steps,
    revision: int,
    counts: NDArray[np.int64],
) -> int:
    """Update the chunks of the box from number ``start`` on, as far as there is room in the table.

    Within one frame hits win over misses: on a surface seen at a slant some pixel looks through almost every voxel, and
    a floor would be full of holes.

    Args:
        table: is changed.
        box: the chunks around what the camera could see.
        start: 0, or what the last call returned.
        marks: the voxels hit.
        clear: depth up to which each pixel has seen free space.
        p: from voxels to pixels.
        steps: the sensor model.
        revision: is noted with each chunk that changes.
        counts: (3,) hits, misses and changed chunks are added to it.

    Returns:
        The number of the chunk that did not find room, or the number of chunks when all are done.
    """
    cube = cube_of(p)
    seen = np.empty(WORDS, np.uint64)
    nothing_hit = np.zeros(WORDS, np.uint64)
    for number in range(start, box.size_x * box.size_y * box.size_z):
        a, b, c = number // (box.size_y * box.size_z), number // box.size_z % box.size_y, number % box.size_z
        i, j, k = EDGE * a, EDGE * b, EDGE * c
        slot = marks.slots[number]
        verdict = judge(clear, p, i, j, k, EDGE)
        if verdict == UNSEEN and slot < 0:
            continue
        carve_chunk(clear, p, cube, i, j, k, verdict, seen)
        if slot < 0 and not seen.any():
            continue
        row = find_row(table, box.x + a, box.y + b, box.z + c)
        if row < 0:
            if is_full(table):
                return number
            row = add_row(table, box.x + a, box.y + b, box.z + c)
        table.revisions[row] = revision
        hit = marks.bits[slot] if slot >= 0 else nothing_hit
        counts[0] += _apply_hits(table.values, row, hit, p, i, j, k, steps)
        counts[1] += _apply_misses(table.values, row, seen, hit, steps)
        counts[2] += 1
    return box.size_x * box.size_y * box.size_z


@njit(cache=True, nogil=True, error_model="numpy")
def _apply_misses(
    values: NDArray[np.int16], row: int, seen: NDArray[np.uint64], hit: NDArray[np.uint64], steps: Steps
) -> int:
    """One miss for each voxel that was looked through and not hit; how many these are."""
    misses = 0
    step, lowest, zero = np.int16(steps.miss), np.int16(steps.lowest), np.int16(0)
    for w in range(WORDS):
        word = seen[w] & ~hit[w]
        if word == np.uint64(0):
            continue
        # All 64 without a branch: so it runs on the processor's vector unit.
        for bit in range(64):
            old = values[row, 64 * w + bit]
            new = max(np.int16((zero if old == NOTHING else old) + step), lowest)
            free = (word >> np.uint64(bit)) & np.uint64(1) != np.uint64(0)
            values[row, 64 * w + bit] = new if free else old
            misses += free
    return misses


@njit(cache=True, nogil=True, error_model="numpy")
def _apply_hits(
    values: NDArray[np.int16], row: int, hit: NDArray[np.uint64], p: Projection, i: int, j: int, k: int, steps: Steps
) -> int:
    """One hit for each marked voxel of the chunk whose lowest voxel is (i, j, k) of the box; how many these are."""
    hits = 0
    last_bin = steps.hits.shape[0] - 1
    for w in range(WORDS):
        word = hit[w]
        if word == np.uint64(0):
            continue
        for bit in range(64):
            if (word >> np.uint64(bit)) & np.uint64(1):
                place = 64 * w + bit
                x, y, z = i + OFFSETS[place, 0], j + OFFSETS[place, 1], k + OFFSETS[place, 2]
                depth_m = p.depth_0 + x * p.depth_i + y * p.depth_j + z * p.depth_k
                step = steps.hits[min(max(int(depth_m * steps.bins_per_m), 0), last_bin)]
                old = values[row, place]
                values[row, place] = min((0 if old == NOTHING else old) + step, steps.highest)
                hits += 1
    return hits


@njit(cache=True, nogil=True)
def merge_rows(table: ChunkTable, other: ChunkTable, start: int, lowest: int, highest: int, revision: int) -> int:
    """Add the log-odds of ``other`` from row ``start`` on, as far as there is room in ``table``.

    Returns:
        The row that did not find room, or the number of rows when all are done.
    """
    for source in range(start, other.size[0]):
        x, y, z = other.coords[source, 0], other.coords[source, 1], other.coords[source, 2]
        row = find_row(table, x, y, z)
        if row < 0:
            if is_full(table):
                return source
            row = add_row(table, x, y, z)
        table.revisions[row] = revision
        for place in range(VOLUME):
            theirs, ours = other.values[source, place], table.values[row, place]
            if theirs != NOTHING:
                total = theirs + (0 if ours == NOTHING else ours)
                table.values[row, place] = min(max(total, lowest), highest)
    return int(other.size[0])
