"""What the functions of the flood share: the map, the plan that they keep right, the cells that wait, and an order.

A cell waits with the number of steps at which something may enter it, so that those with the fewest come first.

Of two nodes on a cell the one comes first that the flood would have reached first. A node knows how it was entered:
with how many steps, with which rank and from which height. Of the same number of steps the lower rank wins. A place
flown has rank 0: there it is free, and there the flood begins. What must be free because it is near to one has the
place, from 1, of its cell in the circle around it; what lies beside a free node has `RANK_OF_SIDES` and the number of
the side.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled, inner
from companion.mapping.frontiers.plan import CELLS, FLOWN, Plan, Shape, first_sheet, is_node, on_tile
from companion.mapping.frontiers.state_grid import Grid
from companion.mapping.voxels.chunks import Integer, chunk_key, row_of_key

MOST_STEPS = 60_000
"""A flood ends so many cells from where the vehicle was."""

MOST_TASKS = 2**20
"""Cells that may wait at once to be looked at."""

RANK_OF_SIDES = 60_000
"""Who was so near that it must be free comes before who is beside a free node."""

WIDEST = 15
"""Cells around a place flown that may be free because of it: they lie on its tile or on the next one."""


class Tasks(NamedTuple):
    """Cells that wait to be looked at, by the number of steps at which something may enter them.

    Attributes:
        heads: (MOST_STEPS + 2,) int32, the last task of these steps, or -1.
        nexts: (MOST_TASKS,) int32, the one before it.
        cells: (MOST_TASKS, 2) int32.
        state: (4,) int64: tasks in use or given back, the last one that was given back or -1, most steps of a task,
            1 when there was no room for a task.
    """

    heads: NDArray[np.int32]
    nexts: NDArray[np.int32]
    cells: NDArray[np.int32]
    state: NDArray[np.int64]


def no_tasks() -> Tasks:
    """Nothing waits."""
    return Tasks(
        np.full(MOST_STEPS + 2, -1, np.int32),
        np.zeros(MOST_TASKS, np.int32),
        np.zeros((MOST_TASKS, 2), np.int32),
        np.array([0, -1, 0, 0], np.int64),
    )


class Work(NamedTuple):
    """What the functions of the flood have in common.

    Attributes:
        grid: the map.
        plan: is kept right.
        shape: its numbers.
        tasks: what is to be done.
        circle: (n, 2) int64, the cells around a place flown that are free because the vehicle was there, near ones
            first and without the place itself; none further than `WIDEST` along x or y.
        near: (n, 2) int64, room for the places flown around a cell.
        touched: (MOST_SHEETS,) bool, is set for the first sheet of each tile on which something became different.
    """

    grid: Grid
    plan: Plan
    shape: Shape
    tasks: Tasks
    circle: NDArray[np.int64]
    near: NDArray[np.int64]
    touched: NDArray[np.bool_]


@inner
def touch(work: Work, i: Integer, j: Integer) -> None:
    """Have the tile of cell (i, j) looked at in the next survey."""
    sheet = first_sheet(work.plan, i, j)
    if sheet >= 0:
        work.touched[sheet] = True


@inner
def wait(tasks: Tasks, steps: Integer, i: Integer, j: Integer) -> None:
    """Have cell (i, j) looked at for what enters it with this number of steps."""
    if steps > MOST_STEPS:
        return
    task = tasks.state[1]
    if task >= 0:
        tasks.state[1] = tasks.nexts[task]
    elif tasks.state[0] < tasks.nexts.shape[0]:
        task = tasks.state[0]
        tasks.state[0] += 1
    else:
        tasks.state[3] = 1
        return
    tasks.cells[task, 0], tasks.cells[task, 1] = i, j
    tasks.nexts[task] = tasks.heads[steps]
    tasks.heads[steps] = task
    tasks.state[2] = max(tasks.state[2], steps)


@inner
def entered_from_mm(plan: Plan, node: Integer) -> int:
    """The height of the node from which one was entered."""
    return int(plan.heights_mm[node]) - int(plan.rises_mm[node])


@inner
def is_before(plan: Plan, node: Integer, steps: Integer, rank: Integer, from_mm: Integer) -> bool:
    """Whether a node comes before one that would be entered like this, or is that one."""
    if plan.steps[node] != steps:
        return bool(plan.steps[node] < steps)
    if plan.ranks[node] != rank:
        return bool(plan.ranks[node] < rank)
    return bool(entered_from_mm(plan, node) <= from_mm)


@inner
def is_taken(plan: Plan, s: Shape, i: Integer, j: Integer, steps: Integer, rank: Integer, from_mm: Integer) -> bool:
    """Whether cell (i, j) has a node on this level that comes before one that would be entered like this."""
    sheet = first_sheet(plan, i, j)
    place = on_tile(i, j)
    while sheet >= 0:
        node = sheet * CELLS + place
        if (
            is_node(plan, node)
            and abs(plan.heights_mm[node] - from_mm) < s.level_mm
            and is_before(plan, node, steps, rank, from_mm)
        ):
            return True
        sheet = int(plan.others[sheet])
    return False


@inner
def flown_around(
    plan: Plan, circle: NDArray[np.int64], i: Integer, j: Integer, near: NDArray[np.int64], most: Integer
) -> int:
    """Find nodes in the circle around cell (i, j) where the vehicle was, in the order of their ranks.

    One loop over the arrays themselves: a call for each cell of the circle would take ten times as long.

    Returns:
        How many there are, ``most`` at the most: nodes and ranks are in ``near`` (n + 9, 2), whose last nine are room.
    """
    steps, others, keys, firsts = plan.steps, plan.others, plan.keys, plan.firsts
    blocks = near[near.shape[0] - 9 :, 0]
    for n in range(9):
        blocks[n] = row_of_key(keys, firsts, chunk_key((i >> 4) + n // 3 - 1, (j >> 4) + n % 3 - 1, 0))
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
