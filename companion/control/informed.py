"""The way over known ground to what has not been seen: how long it is, and where it can be flown straight. Pure.

Where following on would take longer than that, the law may leave the boundary for it, as R2. Nothing but that choice,
and where to, depends on the grid: the corridor is confirmed by the scan before it is flown, and the speed is governed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled
from companion.control.known_ground import FREE, UNSEEN, WALL, KnownGround, WallFollowing, Window, is_frontier

NEAR_STEPS = 3
"""A goal is where there is room to fly within so many cells of ground from which the unseen begins."""

LEAST_CLUSTER = 3
"""Fewer such cells together are a chink: they attract nobody until nothing else is left."""

TRACE_CELLS = 20
"""So far a boundary is followed in thought; from there on the way over known ground counts."""

TURN_M_PER_RAD = 0.5
"""What the first turn costs, as a way: 0.8 s at 0.6 rad/s."""

Grid = NDArray[np.int32]


class Way(NamedTuple):
    """A way to the unseen.

    Attributes:
        length_m: of it, the first turn included.
        x_m, y_m: how far it can be flown straight on.
        goal_x_m, goal_y_m: where the unseen begins.
    """

    length_m: float
    x_m: float
    y_m: float
    goal_x_m: float
    goal_y_m: float


@dataclass(frozen=True, slots=True)
class Ways:
    """Distances over known ground to the nearest goal, as they are just now.

    Attributes:
        window: the grid that they were searched in.
        room: (rows, columns) cells to the nearest wall, 2 at most; 0 where the body has no room.
        steps: (rows, columns) cells to go to where the unseen begins, those near a wall counted twice; -1: no way.
    """

    window: Window
    room: NDArray[np.uint8]
    steps: Grid

    def way(self, x_m: float, y_m: float, yaw_rad: float) -> Way | None:
        """From a place, for a vehicle that points there; None when no way is known."""
        window = self.window
        row, column = window.cell(x_m, y_m)
        path = _path(self.steps, self.room, row, column)
        if len(path) == 0:
            return None
        to_row, to_column = path[_straight(self.room, row, column, path)]
        to_x_m, to_y_m = window.middle(int(to_row), int(to_column))
        goal = window.middle(int(path[-1, 0]), int(path[-1, 1]))
        turn_rad = abs(math.remainder(math.atan2(to_y_m - y_m, to_x_m - x_m) - yaw_rad, 2.0 * math.pi))
        return Way(
            int(self.steps[path[0, 0], path[0, 1]]) * window.cell_m + TURN_M_PER_RAD * turn_rad, to_x_m, to_y_m, *goal
        )

    def along_m(self, start: WallFollowing) -> float:
        """Length of the way to the unseen for whoever follows a wall from there first; infinite when there is none."""
        row, column = self.window.cell(start.x_m, start.y_m)
        cells = _trace(self.window.cells, self.room, self.steps, row, column, start.direction_rad, start.gamma)
        return float(cells) * self.window.cell_m


def find_ways(ground: KnownGround, x_m: float, y_m: float) -> Ways | None:
    """Search about a place; None before anything has been seen."""
    window = ground.window(x_m, y_m)
    if window is None:
        return None
    room = _room(window.cells)
    for row, column in window.blocked.tolist():
        room[row - 1 : row + 2, column - 1 : column + 2] = 0
    steps = _steps(window.cells, room, _frontier(window.cells, LEAST_CLUSTER))
    row, column = window.cell(x_m, y_m)
    if _nearest_known(steps, row, column)[0] < 0:
        steps = _steps(window.cells, room, _frontier(window.cells, 1))
    return Ways(window, room, steps)


@compiled
def _room(cells: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """How many cells from the nearest wall, 2 at most; 0 where there is no room: beside a wall, and in the unseen."""
    rows, columns = cells.shape
    room = np.zeros((rows, columns), np.uint8)
    for r in range(2, rows - 2):
        for c in range(2, columns - 2):
            if cells[r, c] != FREE:
                continue
            off = 3
            for dr in range(-2, 3):
                for dc in range(-2, 3):
                    if cells[r + dr, c + dc] == WALL:
                        off = min(off, max(abs(dr), abs(dc)))
            room[r, c] = off - 1
    return room


@compiled
def _frontier(cells: NDArray[np.uint8], least: int) -> NDArray[np.bool_]:
    """The cells of frontiers in which so many lie together."""
    rows, columns = cells.shape
    at = np.zeros((rows, columns), np.bool_)
    for r in range(1, rows - 1):
        for c in range(1, columns - 1):
            at[r, c] = is_frontier(cells, r, c)
    done = np.zeros((rows, columns), np.bool_)
    stack = np.empty((rows * columns, 2), np.int32)
    for r in range(1, rows - 1):
        for c in range(1, columns - 1):
            if not at[r, c] or done[r, c]:
                continue
            size, top = 0, 1
            stack[0, 0], stack[0, 1] = r, c
            done[r, c] = True
            # The stack is not emptied by writing over it: what was taken from it is the cluster.
            while size < top:
                a, b = stack[size, 0], stack[size, 1]
                size += 1
                for dr in range(-1, 2):
                    for dc in range(-1, 2):
                        if at[a + dr, b + dc] and not done[a + dr, b + dc]:
                            done[a + dr, b + dc] = True
                            stack[top, 0], stack[top, 1] = a + dr, b + dc
                            top += 1
            if size < least:
                for k in range(size):
                    at[stack[k, 0], stack[k, 1]] = False
    return at


@compiled
def _cost(room: NDArray[np.uint8], row: int, column: int) -> int:
    """What a cell costs to be flown through: one near a wall counts twice, so that ways keep to the middle."""
    return 2 if room[row, column] == 1 else 1


@compiled
def _steps(cells: NDArray[np.uint8], room: NDArray[np.uint8], frontier: NDArray[np.bool_]) -> Grid:
    """Cost of the way to the frontier, by Dijkstra's algorithm; through cells with room, at its end through any free.

    Costs are 1 and 2, so three queues that take turns hold what is to be visited in order.
    """
    rows, columns = cells.shape
    steps = np.full((rows, columns), -1, np.int32)
    done = np.zeros((rows, columns), np.bool_)
    queues = np.empty((3, 2 * rows * columns, 2), np.int32)
    sizes = np.zeros(3, np.int64)
    for r in range(2, rows - 2):
        for c in range(2, columns - 2):
            if frontier[r, c]:
                steps[r, c] = 0
                queues[0, sizes[0], 0], queues[0, sizes[0], 1] = r, c
                sizes[0] += 1
    now, idle = 0, 0
    while idle < 3:
        which = now % 3
        idle = idle + 1 if sizes[which] == 0 else 0
        for k in range(sizes[which]):
            r, c = queues[which, k, 0], queues[which, k, 1]
            if done[r, c] or steps[r, c] != now:
                continue
            done[r, c] = True
            for n in range(4):
                a, b = r + (n == 0) - (n == 1), c + (n == 2) - (n == 3)
                if not (1 < a < rows - 2 and 1 < b < columns - 2) or done[a, b]:
                    continue
                step = now + _cost(room, a, b)
                if (room[a, b] > 0 or (step <= NEAR_STEPS and cells[a, b] == FREE)) and not 0 <= steps[a, b] <= step:
                    steps[a, b] = step
                    queue = step % 3
                    queues[queue, sizes[queue], 0], queues[queue, sizes[queue], 1] = a, b
                    sizes[queue] += 1
        sizes[which] = 0
        now += 1
    return steps


@compiled
def _nearest_known(steps: Grid, row: int, column: int) -> tuple[int, int]:
    """The cell itself, or the nearest within two of it from which a way is known; (-1, -1) when there is none."""
    rows, columns = steps.shape
    best, found = np.inf, (-1, -1)
    for r in range(max(row - 2, 0), min(row + 3, rows)):
        for c in range(max(column - 2, 0), min(column + 3, columns)):
            off = (r - row) ** 2 + (c - column) ** 2
            if steps[r, c] >= 0 and off < best:
                best, found = off, (r, c)
    return found


@compiled
def _path(steps: Grid, room: NDArray[np.uint8], row: int, column: int) -> Grid:
    """(n, 2) rows and columns from there to where the unseen begins, both ends included; empty when there is no way."""
    r, c = _nearest_known(steps, row, column)
    if r < 0:
        return np.empty((0, 2), np.int32)
    path = np.empty((steps[r, c] + 1, 2), np.int32)
    path[0, 0], path[0, 1] = r, c
    size, before = 1, 0
    while steps[r, c] > 0:
        # Straight on where that is as short, so that corridors stay straight.
        for turn in range(4):
            towards = (before + turn) % 4
            a, b = r + (towards == 0) - (towards == 1), c + (towards == 2) - (towards == 3)
            if steps[a, b] == steps[r, c] - _cost(room, r, c):
                before = towards
                break
        r, c = a, b
        path[size, 0], path[size, 1] = r, c
        size += 1
    return path[:size]


@compiled
def _straight(room: NDArray[np.uint8], row: int, column: int, path: Grid) -> int:
    """Index of the last cell of a path to which a straight line has room, but for its first metre and last cell.

    The more room the better: only where no line has two cells to every wall is one enough.
    """
    for least in (2, 1):
        last = 0
        for k in range(path.shape[0]):
            dr, dc = path[k, 0] - row, path[k, 1] - column
            far = max(abs(dr), abs(dc))
            free = True
            for i in range(3, 2 * far - 1):
                r = row + int(np.floor(dr * i / (2.0 * far) + 0.5))
                c = column + int(np.floor(dc * i / (2.0 * far) + 0.5))
                free = free and room[r, c] >= least
            if free:
                last = k
        if last > 3:
            break
    return last


@compiled
def _trace(
    cells: NDArray[np.uint8],
    room: NDArray[np.uint8],
    steps: Grid,
    row: int,
    column: int,
    direction_rad: float,
    gamma: int,
) -> float:
    """Cells along a wall, hand on it, to where the unseen begins, or for `TRACE_CELLS` and the way from there."""
    rows, columns = cells.shape
    row_step, column_step = (0, 1, 0, -1), (1, 0, -1, 0)
    heading = int(np.floor(direction_rad / (np.pi / 2.0) + 0.5)) % 4
    for k in range(4):
        # The grid is coarse: begin at the wall, not beside it.
        r = row + row_step[(heading + gamma) % 4] * k
        c = column + column_step[(heading + gamma) % 4] * k
        a, b = r + row_step[(heading + gamma) % 4], c + column_step[(heading + gamma) % 4]
        if not (0 < a < rows - 1 and 0 < b < columns - 1) or not (room[a, b] > 0 or cells[a, b] == UNSEEN):
            row, column = r, c
            break
    for k in range(TRACE_CELLS):
        if not (0 < row < rows - 1 and 0 < column < columns - 1):
            return np.inf
        if cells[row, column] == UNSEEN or 0 <= steps[row, column] <= 1:
            return float(k)
        turned = False
        for turn in (gamma, 0, -gamma, 2):
            towards = (heading + turn) % 4
            a, b = row + row_step[towards], column + column_step[towards]
            if 0 <= a < rows and 0 <= b < columns and (room[a, b] > 0 or cells[a, b] == UNSEEN):
                heading, row, column = towards, a, b
                turned = True
                break
        if not turned:
            break
    r, c = _nearest_known(steps, row, column)
    return np.inf if r < 0 else float(TRACE_CELLS + steps[r, c])
