"""What the functions of the flood share: the map, the plan that they keep right, and the cells that wait for them.

A cell waits with the number of steps at which something may enter it, so that those with the fewest come first.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from companion.compiled import inner
from companion.mapping.frontiers.plan import Plan, first_sheet
from companion.mapping.frontiers.plan_shape import Shape
from companion.mapping.frontiers.state_grid import Grid
from companion.mapping.voxels.chunks import Integer

MOST_STEPS = 60_000
"""A flood ends so many cells from where the vehicle was."""

MOST_TASKS = 2**20
"""Cells that may wait at once to be looked at."""


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
