"""Where the vehicle was: there it is free, and there the flood begins."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled, inner
from companion.mapping.frontiers.plan import CELLS, FLOWN, Plan, first_sheet, is_node, on_tile
from companion.mapping.frontiers.state_grid import slot_of
from companion.mapping.voxels.chunks import Integer, chunk_key

WIDEST = 15
"""Cells around a place flown that may be free because of it: they lie on its tile or on the next one."""


@inner
def flown_around(
    plan: Plan, circle: NDArray[np.int64], i: Integer, j: Integer, near: NDArray[np.int64], most: Integer
) -> int:
    """Find nodes in the circle around cell (i, j) where the vehicle was, in the order of their ranks.

    One loop over the arrays themselves: a call for each cell of the circle would take ten times as long.

    Args:
        plan: the plan.
        circle: see `Work`.
        i: the cell.
        j: the cell.
        near: (n + 9, 2) is filled with nodes and their ranks; the last nine are used to work in.
        most: as many as are wanted.

    Returns:
        How many there are.
    """
    steps, others, keys, firsts = plan.steps, plan.others, plan.keys, plan.firsts
    blocks = near[near.shape[0] - 9 :, 0]
    for n in range(9):
        key = chunk_key((i >> 4) + n // 3 - 1, (j >> 4) + n % 3 - 1, 0)
        slot = slot_of(keys, key)
        blocks[n] = firsts[slot] if keys[slot] == key else -1
    count = 0
    for n in range(circle.shape[0]):
        a, b = i - circle[n, 0], j - circle[n, 1]
        sheet = blocks[3 * ((a >> 4) - (i >> 4) + 1) + (b >> 4) - (j >> 4) + 1]
        place = (a & 15) << 4 | (b & 15)
        while sheet >= 0:
            if steps[sheet * CELLS + place] == 1:
                near[count, 0], near[count, 1] = sheet * CELLS + place, n + 1
                count += 1
                if count == most:
                    return count
            sheet = np.int64(others[sheet])
    return count


@inner
def _flown_on(plan: Plan, i: Integer, j: Integer, after: Integer) -> int:
    """The next node on cell (i, j) where the vehicle was, in the order of their sheets, or -1."""
    sheet = first_sheet(plan, i, j)
    place = on_tile(i, j)
    passed = after < 0
    while sheet >= 0:
        node = sheet * CELLS + place
        if passed and is_node(plan, node) and plan.flags[node] & FLOWN:
            return node
        passed = passed or node == after
        sheet = int(plan.others[sheet])
    return -1


@compiled
def flown_at(plan: Plan, i: Integer, j: Integer, height_mm: Integer, level_mm: Integer) -> int:
    """The node on cell (i, j) where the vehicle was at about this height, or -1."""
    node = _flown_on(plan, i, j, -1)
    while node >= 0 and abs(plan.heights_mm[node] - height_mm) >= level_mm:
        node = _flown_on(plan, i, j, node)
    return node
