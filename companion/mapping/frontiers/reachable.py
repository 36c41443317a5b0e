"""Where the vehicle can get to from where it is or was, and how long the way is.

Each sheet is divided into the parts that hang together, again only where something changed. The one look at everything,
`reached_parts`, goes from part to part and not from cell to cell.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled, inner
from companion.mapping.frontiers.plan import (
    BLOCKED,
    CELLS,
    FLOWN,
    SIDES,
    TILE,
    Plan,
    Shape,
    first_sheet,
    is_node,
    kind_of,
    on_tile,
)
from companion.mapping.frontiers.state_grid import has
from companion.mapping.frontiers.tiles import REACHED_CELLS
from companion.mapping.voxels.chunks import Integer
from companion.mapping.voxels.lookup import FREE
from companion.model import FloatArray


@inner
def is_way(plan: Plan, node: Integer) -> bool:
    """Whether the vehicle can be there: it is free and nothing is nearer than d_s, or it was there."""
    flags = plan.flags[node]
    return bool(is_node(plan, node) and kind_of(plan, node) == FREE and (flags & FLOWN or not flags & BLOCKED))


@compiled
def part_sheets(plan: Plan, s: Shape, tiles: NDArray[np.bool_]) -> None:
    """Number the parts of each sheet that hang together and where the vehicle can be."""
    waiting = np.empty(CELLS, np.int64)
    for first in range(plan.used[0]):
        sheet = int(first if tiles[first] else -1)
        while sheet >= 0:
            base = sheet * CELLS
            plan.parts[base : base + CELLS] = 0
            last = 0
            for start in range(CELLS):
                if plan.parts[base + start] > 0 or not is_way(plan, base + start):
                    continue
                last += 1
                plan.parts[base + start] = last
                waiting[0], count = start, 1
                while count > 0:
                    count -= 1
                    place = waiting[count]
                    for side in range(4):
                        a, b = (place >> 4) + SIDES[side, 0], (place & 15) + SIDES[side, 1]
                        if not (0 <= a < TILE and 0 <= b < TILE):
                            continue
                        other = a * TILE + b
                        apart = abs(plan.heights_mm[base + other] - plan.heights_mm[base + place])
                        new = plan.parts[base + other] == 0 and is_way(plan, base + other)
                        if new and apart < s.level_mm:
                            plan.parts[base + other] = last
                            waiting[count] = other
                            count += 1
            sheet = int(plan.others[sheet])


@compiled
def reached_parts(
    plan: Plan, s: Shape, start: NDArray[np.int64], flown: NDArray[np.int64], away_m: FloatArray, tile_m: float
) -> NDArray[np.bool_]:
    """(sheets, 256) which parts of each sheet can be got to from where the vehicle was.

    Args:
        plan: the plan.
        s: its numbers.
        start: (n,) nodes from which ways are measured: where the vehicle is.
        flown: (m,) nodes where it was.
        away_m: (sheets,) is filled with the shortest way to each sheet, at most as exact as a tile is wide; infinite
            where no way leads from the start.
        tile_m: edge of a tile.
    """
    used = plan.used[0]
    found = np.zeros((used, CELLS), np.bool_)
    away_m[:] = np.inf
    queue = np.empty((used * 4 + 4, 2), np.int64)
    for turn in range(2):
        # First from where the vehicle is, then from all places where it was and to which no way was found.
        begin, end = 0, 0
        for node in start if turn == 0 else flown:
            sheet, part = node // CELLS, np.int64(plan.parts[node])
            if part > 0 and not found[sheet, part]:
                found[sheet, part] = True
                away_m[sheet] = 0.0 if turn == 0 else np.inf
                if end == queue.shape[0]:
                    queue = np.concatenate((queue, np.empty_like(queue)))
                queue[end, 0], queue[end, 1] = sheet, part
                end += 1
        while begin < end:
            sheet, part = queue[begin]
            begin += 1
            i0, j0 = np.int64(plan.corners[sheet, 0]), np.int64(plan.corners[sheet, 1])
            alone = plan.others[sheet] < 0 and first_sheet(plan, i0, j0) == sheet
            for edge in range(CELLS):
                row, column = edge >> 4, edge & 15
                base = sheet * CELLS + edge
                if plan.parts[base] != part:
                    continue
                if alone and 0 < row < TILE - 1 and 0 < column < TILE - 1:
                    continue
                for side in range(4):
                    inside = 0 <= row + SIDES[side, 0] < TILE and 0 <= column + SIDES[side, 1] < TILE
                    if inside and alone:
                        continue
                    i, j = i0 + row + SIDES[side, 0], j0 + column + SIDES[side, 1]
                    place = on_tile(i, j)
                    other = first_sheet(plan, i, j)
                    while other >= 0:
                        its = other * CELLS + place
                        its_part = np.int64(plan.parts[its])
                        if (
                            its_part > 0
                            and not found[other, its_part]
                            and abs(plan.heights_mm[its] - plan.heights_mm[base]) < s.level_mm
                        ):
                            found[other, its_part] = True
                            away_m[other] = min(away_m[other], away_m[sheet] + tile_m)
                            if end == queue.shape[0]:
                                queue = np.concatenate((queue, np.empty_like(queue)))
                            queue[end, 0], queue[end, 1] = other, its_part
                            end += 1
                        other = int(plan.others[other])
    return found


@compiled
def count_reached(
    plan: Plan, found: NDArray[np.bool_], was: NDArray[np.uint64], tiles: NDArray[np.bool_], counts: NDArray[np.int32]
) -> None:
    """Fill in `REACHED_CELLS` of ``counts`` (MOST_SHEETS, COUNTS), the cells that can be got to, where it is different.

    ``found`` is from `reached_parts`; ``was`` (MOST_SHEETS, 4) is the same as bits, from the last time, and is brought
    up to date. To the ``tiles`` (MOST_SHEETS,) that are different, by their first sheets, come those where it is.
    """
    used = plan.used[0]
    for first in range(used):
        if first_sheet(plan, np.int64(plan.corners[first, 0]), np.int64(plan.corners[first, 1])) != first:
            continue
        sheet = first
        while sheet >= 0:
            for word in range(4):
                bits = np.uint64(0)
                for bit in range(64):
                    bits |= np.uint64(found[sheet, 64 * word + bit]) << np.uint64(bit)
                if bits != was[sheet, word]:
                    was[sheet, word] = bits
                    tiles[first] = True
            sheet = int(plan.others[sheet])
        if not tiles[first]:
            continue
        counts[first, REACHED_CELLS] = 0
        sheet = first
        while sheet >= 0:
            for node in range(sheet * CELLS, (sheet + 1) * CELLS):
                if plan.parts[node] > 0 and found[sheet, plan.parts[node]]:
                    counts[first, REACHED_CELLS] += 1
            sheet = int(plan.others[sheet])


@inner
def is_reached(plan: Plan, was: NDArray[np.uint64], node: Integer) -> bool:
    """Whether the vehicle can get to a node, by what `count_reached` kept."""
    part = np.int64(plan.parts[node])
    return bool(part > 0 and has(was[node // CELLS, part >> 6], part & 63))
