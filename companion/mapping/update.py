"""Third pass over a frame: what was seen goes into the log-odds of the map."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from companion.mapping.carve import UNSEEN, carve_chunk, cube_of, judge
from companion.mapping.chunks import EDGE, NOTHING, OFFSETS, ChunkTable, add_row, find_row
from companion.mapping.depth_image import ClearDepth
from companion.mapping.marks import WORDS, Marks
from companion.mapping.view import Box, Projection


class Steps(NamedTuple):
    """What one frame does to a voxel, in thousandths of log-odds."""

    miss: int
    lowest: int
    highest: int


@njit(cache=True, nogil=True, error_model="numpy")
def update_chunks(
    table: ChunkTable,
    box: Box,
    start: int,
    marks: Marks,
    clear: ClearDepth,
    p: Projection,
    steps: Steps,
    hit_steps: NDArray[np.int16],
    revision: int,
    counts: NDArray[np.int64],
) -> int:
    """Update the chunks of the box from number ``start`` on, as far as there is room in the table.

    Returns:
        The number of the chunk that did not find room, or the number of chunks when all are done.
    """
    chunks = box.size_x * box.size_y * box.size_z
    cube = cube_of(p)
    seen = np.empty(WORDS, np.uint64)
    nothing_hit = np.zeros(WORDS, np.uint64)
    for number in range(start, chunks):
        a, b, c = number // (box.size_y * box.size_z), number // box.size_z % box.size_y, number % box.size_z
        slot = marks.slots[number]
        verdict = judge(clear, p, a * EDGE, b * EDGE, c * EDGE, EDGE)
        if verdict == UNSEEN and slot < 0:
            continue
        carve_chunk(clear, p, cube, a * EDGE, b * EDGE, c * EDGE, verdict, seen)
        if slot < 0 and not seen.any():
            continue
        row = find_row(table, box.x + a, box.y + b, box.z + c)
        if row < 0:
            if table.size[0] == table.coords.shape[0]:
                return number
            row = add_row(table, box.x + a, box.y + b, box.z + c)
        table.revisions[row] = revision
        hit = marks.bits[slot] if slot >= 0 else nothing_hit
        counts[0] += _apply_hits(table.values, row, hit, p, a * EDGE, b * EDGE, c * EDGE, hit_steps, steps.highest)
        counts[1] += _apply_misses(table.values, row, seen, hit, steps)
        counts[2] += 1
    return chunks


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
        for bit in range(64):
            old = values[row, 64 * w + bit]
            new = max(np.int16((zero if old == NOTHING else old) + step), lowest)
            free = (word >> np.uint64(bit)) & np.uint64(1) != np.uint64(0)
            values[row, 64 * w + bit] = new if free else old
            misses += free
    return misses


@njit(cache=True, nogil=True, error_model="numpy")
def _apply_hits(
    values: NDArray[np.int16],
    row: int,
    hit: NDArray[np.uint64],
    p: Projection,
    i: int,
    j: int,
    k: int,
    hit_steps: NDArray[np.int16],
    highest: int,
) -> int:
    hits = 0
    per_bin = (len(hit_steps) - 1) / p.limit_m
    for w in range(WORDS):
        word = hit[w]
        if word == np.uint64(0):
            continue
        for bit in range(64):
            if (word >> np.uint64(bit)) & np.uint64(1):
                place = 64 * w + bit
                x, y, z = i + OFFSETS[place, 0], j + OFFSETS[place, 1], k + OFFSETS[place, 2]
                depth = p.depth_0 + x * p.depth_i + y * p.depth_j + z * p.depth_k
                step = hit_steps[min(max(int(depth * per_bin), 0), len(hit_steps) - 1)]
                old = values[row, place]
                values[row, place] = min((0 if old == NOTHING else old) + step, highest)
                hits += 1
    return hits
