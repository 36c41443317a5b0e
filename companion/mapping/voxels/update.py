"""Third pass over a frame: what was seen goes into the log-odds of the map."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled_unchecked
from companion.mapping.voxels.carve import CLEAR, MIXED, UNSEEN, judge, look_through, offsets_of
from companion.mapping.voxels.chunk_table import (
    Table,
    code_of,
    has_room,
    keep_row,
    load_brick,
    next_row,
    shared_value,
    store_brick,
)
from companion.mapping.voxels.chunks import BRICK, EDGE, chunk_key, row_of_key
from companion.mapping.voxels.depth_image import ClearDepth
from companion.mapping.voxels.marks import Marks
from companion.mapping.voxels.sensor_model import (
    CHANGED,
    HITS,
    LOWERED,
    Steps,
    compared,
    lower,
    lowered,
    raise_,
    spread,
)
from companion.mapping.voxels.view import Box, Projection

_CELL_SHIFT = 2
"""Chunks are first judged in cubes of four: most of the box around a view lies outside of it, or behind walls."""

_UNJUDGED = -1


@compiled_unchecked
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
    offsets, pixels, depths_m = offsets_of(p), np.empty(BRICK, np.int32), np.empty(BRICK, np.float32)
    seen, gains, hits = np.zeros(BRICK, np.int16), np.zeros(BRICK, np.int16), np.zeros(BRICK, np.int16)
    old, new = np.zeros(BRICK, np.int16), np.zeros(BRICK, np.int16)
    keys, rows, slots, bits = table.keys, table.rows, marks.slots, marks.bits
    codes, voxels, spare, used = table.codes, table.voxels, table.spare, table.used
    clear_m, least_m, most_m = clear
    by_depth, bins_per_m = steps.hits, np.float32(steps.bins_per_m)
    miss, lowest, highest = np.int16(steps.miss), np.int16(steps.lowest), np.int16(steps.highest)
    sure = code_of(steps.lowest)
    nothing = np.uint64(0)
    cells_y, cells_z = (box.size_y >> _CELL_SHIFT) + 1, (box.size_z >> _CELL_SHIFT) + 1
    cells = np.full(((box.size_x >> _CELL_SHIFT) + 1) * cells_y * cells_z, _UNJUDGED, np.int8)
    hit_count, lowered_count = 0, 0
    for number in range(start, box.size_x * box.size_y * box.size_z):
        a, b, c = number // (box.size_y * box.size_z), number // box.size_z % box.size_y, number % box.size_z
        i, j, k = EDGE * a, EDGE * b, EDGE * c
        slot = slots[number]
        cell = ((a >> _CELL_SHIFT) * cells_y + (b >> _CELL_SHIFT)) * cells_z + (c >> _CELL_SHIFT)
        if cells[cell] == _UNJUDGED:
            edge = EDGE << _CELL_SHIFT
            cells[cell] = judge(least_m, most_m, p, i & -edge, j & -edge, k & -edge, edge)
        verdict = UNSEEN if cells[cell] == UNSEEN else judge(least_m, most_m, p, i, j, k, EDGE)
        if verdict == UNSEEN and slot < 0:
            continue
        row = row_of_key(keys, rows, chunk_key(box.x + a, box.y + b, box.z + c))
        if not has_room(table):
            counts[HITS] += hit_count
            counts[LOWERED] += lowered_count
            return number
        is_new = row < 0
        if is_new:
            row = next_row(table, box.x + a, box.y + b, box.z + c)
        changed = False
        for eighth in range(8):
            x, y, z = i + 8 * (eighth & 1), j + 4 * (eighth & 2), k + 2 * (eighth & 4)
            verdict_8 = judge(least_m, most_m, p, x, y, z, EDGE // 2) if verdict == MIXED else verdict
            for word in range(8 * eighth, 8 * eighth + 8):
                hit = bits[slot, word] if slot >= 0 else nothing
                code = codes[row, word]
                if hit == nothing and (verdict_8 == UNSEEN or code == sure):
                    continue
                at_x, at_y, at_z = x + 4 * (word & 1), y + 2 * (word & 2), z + (word & 4)
                verdict_4 = verdict_8
                if verdict_8 == MIXED and hit == nothing:
                    # Where a ray ended there is nearly always something of everything, and no need to ask.
                    verdict_4 = judge(least_m, most_m, p, at_x, at_y, at_z, EDGE // 4)
                    if verdict_4 == UNSEEN:
                        continue
                if hit == nothing and verdict_4 == CLEAR and code < 0:
                    codes[row, word] = code_of(lowered(np.int16(shared_value(code)), miss, lowest))
                    lowered_count += BRICK
                    changed = True
                    continue
                if verdict_4 == MIXED:
                    look_through(clear_m, p, offsets, at_x, at_y, at_z, pixels, depths_m, seen)
                else:
                    seen[:] = np.int16(verdict_4 == CLEAR)
                load_brick(voxels, code, old)
                lower(old, seen, miss, lowest, new)
                spread(hit, hits)
                if hit != nothing:
                    weigh(by_depth, bins_per_m, p, offsets, at_x, at_y, at_z, gains)
                    raise_(old, hits, gains, highest, new)
                hit_here, changed_here, missed_here = compared(old, new, hits)
                hit_count += int(hit_here)
                if changed_here:
                    lowered_count += int(missed_here)
                    store_brick(codes, voxels, spare, used, row, word, new)
                    changed = True
        if changed:
            if is_new:
                keep_row(table)
            table.revisions[row] = revision
            counts[CHANGED] += 1
    counts[HITS] += hit_count
    counts[LOWERED] += lowered_count
    return box.size_x * box.size_y * box.size_z


@compiled_unchecked
def weigh(
    by_depth: NDArray[np.int16],
    bins_per_m: np.float32,
    p: Projection,
    offsets: NDArray[np.float32],
    i: int,
    j: int,
    k: int,
    gains: NDArray[np.int16],
) -> None:
    """Fill in ``gains`` (64,): what a hit says of each voxel of the brick at (i, j, k), by its depth."""
    depth_0 = np.float32(p.depth_0 + i * p.depth_i + j * p.depth_j + k * p.depth_k)
    last_bin = np.int32(by_depth.shape[0] - 1)
    for n in range(BRICK):
        number = np.int32((depth_0 + offsets[0, n]) * bins_per_m)
        gains[n] = by_depth[np.uint32(min(max(number, np.int32(0)), last_bin))]
