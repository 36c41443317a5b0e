"""Third pass over a frame: what was seen goes into the log-odds of the map."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from companion.mapping.brick import CHANGED, LOWERED, look, lowered, update_brick
from companion.mapping.carve import CLEAR, MIXED, UNSEEN, Brick, brick_of, judge, look_through
from companion.mapping.chunks import BRICK, EDGE, WORDS
from companion.mapping.depth_image import ClearDepth
from companion.mapping.marks import Marks
from companion.mapping.sensor_model import Steps
from companion.mapping.store import (
    Table,
    code_of,
    find_row,
    has_room,
    keep_row,
    next_row,
    shared_value,
)
from companion.mapping.view import Box, Projection


@njit(cache=True, nogil=True, error_model="numpy")
def update_chunks(
    table: Table,
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
    a floor would be full of holes. Space that is free already with all certainty is passed over at once.

    Args:
        table: is changed.
        box: the chunks around what the camera could see.
        start: 0, or what the last call returned.
        marks: the voxels hit.
        clear: depth up to which each pixel has seen free space.
        p: from voxels to pixels.
        steps: the sensor model.
        revision: is noted with each chunk that changes.
        counts: (3,) hits, voxels made surer of being free, and changed chunks are added to it.

    Returns:
        The number of the chunk that did not find room, or the number of chunks when all are done.
    """
    brick = brick_of(p)
    work = look()
    miss, lowest = np.int16(steps.miss), np.int16(steps.lowest)
    no_hits = np.zeros(WORDS, np.uint64)
    sure = code_of(steps.lowest)
    for number in range(start, box.size_x * box.size_y * box.size_z):
        a, b, c = number // (box.size_y * box.size_z), number // box.size_z % box.size_y, number % box.size_z
        i, j, k = EDGE * a, EDGE * b, EDGE * c
        slot = marks.slots[number]
        verdict = judge(clear, p, i, j, k, EDGE)
        if verdict == UNSEEN and slot < 0:
            continue
        row = find_row(table, box.x + a, box.y + b, box.z + c)
        if not has_room(table):
            return number
        is_new = row < 0
        if is_new:
            row = next_row(table, box.x + a, box.y + b, box.z + c)
        hits = marks.bits[slot] if slot >= 0 else no_hits
        changed = False
        for eighth in range(8):
            x, y, z = i + 8 * (eighth & 1), j + 4 * (eighth & 2), k + 2 * (eighth & 4)
            verdict_8 = judge(clear, p, x, y, z, EDGE // 2) if verdict == MIXED else verdict
            for word in range(8 * eighth, 8 * eighth + 8):
                hit, code = hits[word], table.codes[row, word]
                if hit == np.uint64(0) and (verdict_8 == UNSEEN or code == sure):
                    continue
                at_x, at_y, at_z = x + 4 * (word & 1), y + 2 * (word & 2), z + (word & 4)
                verdict_4 = verdict_8
                if verdict_8 == MIXED and hit == np.uint64(0):
                    # Where a ray ended there is nearly always something of everything, and no need to ask.
                    verdict_4 = judge(clear, p, at_x, at_y, at_z, EDGE // 4)
                if hit == np.uint64(0) and verdict_4 == UNSEEN:
                    continue
                if hit == np.uint64(0) and verdict_4 == CLEAR and code < 0:
                    table.codes[row, word] = code_of(lowered(np.int16(shared_value(code)), miss, lowest))
                    counts[LOWERED] += BRICK
                    changed = True
                    continue
                if verdict_4 == MIXED:
                    look_through(clear, p, brick, at_x, at_y, at_z, work.seen)
                else:
                    work.seen[:] = np.int16(verdict_4 == CLEAR)
                if hit != np.uint64(0):
                    _weigh(p, brick, at_x, at_y, at_z, steps, work.gains)
                changed |= update_brick(table, row, word, work, hit, steps, counts)
        if changed:
            if is_new:
                keep_row(table)
            table.revisions[row] = revision
            counts[CHANGED] += 1
    return box.size_x * box.size_y * box.size_z


@njit(cache=True, nogil=True, error_model="numpy")
def _weigh(p: Projection, brick: Brick, i: int, j: int, k: int, steps: Steps, gains: NDArray[np.int16]) -> None:
    """Fill in ``gains`` (64,): what a hit says of each voxel of the brick at (i, j, k), by its depth."""
    depth_0 = np.float32(p.depth_0 + i * p.depth_i + j * p.depth_j + k * p.depth_k)
    bins_per_m, hits, offset_m = np.float32(steps.bins_per_m), steps.hits, brick.depth_m
    last_bin = np.int32(hits.shape[0] - 1)
    for n in range(BRICK):
        number = np.int32((depth_0 + offset_m[n]) * bins_per_m)
        gains[n] = hits[np.uint32(min(max(number, np.int32(0)), last_bin))]
