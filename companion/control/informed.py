"""The way over known ground to what has not been seen: how long it is, and where it can be flown straight. Pure.

Where following on would take longer than that, the law may leave the boundary for it, as R2. Nothing but that choice,
and where to, depends on the grid: the corridor is confirmed by the scan before it is flown, and the speed is governed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled
from companion.control.ground_grid import FREE, LEVEL_DM, WALL, GroundGrid, is_frontier, level_at, step_to
from companion.control.known_ground import KnownGround, Place, Window
from companion.model import wrap_rad

NEAR_STEPS = 3
"""A goal is where there is room to fly within so many cells of ground from which the unseen begins."""

LEAST_CLUSTER = 3
"""Fewer such cells together are a chink: they attract nobody until nothing else is left."""

TRACE_CELLS = 20
"""So far a boundary is followed in thought; from there on the way over known ground counts."""

MOST_HIDDEN = 100
"""Where a line has no room to so many cells of a way one after the other, those behind them are not looked at."""

Steps = NDArray[np.int32]


@dataclass(frozen=True, slots=True)
class WallFollowing:
    """Where the vehicle would begin to follow a wall, heading where, with the wall on which side (Γ)."""

    place: Place
    direction_rad: float
    gamma: int


class Way(NamedTuple):
    """A way to the unseen.

    Attributes:
        length_m: of it, the first turn included.
        straight: how far it can be flown straight on.
        goal: where the unseen begins.
    """

    length_m: float
    straight: Place
    goal: Place


class Route(NamedTuple):
    """A whole way: its length, and how much is turned on it."""

    length_m: float
    turn_rad: float


@dataclass(frozen=True, slots=True)
class Ways:
    """Distances over known ground to the nearest goal, as they are just now.

    Attributes:
        window: the grid that they were searched in.
        room: (levels, rows, columns) cells to the nearest wall, 2 at most; 0 where the body has no room.
        steps: (levels, rows, columns) cells to go to where the unseen begins, those near a wall counted twice; -1: no
            way.
    """

    window: Window
    room: NDArray[np.uint8]
    steps: Steps

    def way(self, place: Place, yaw_rad: float, turn_m_per_rad: float) -> Way | None:
        """From a place, for a vehicle that points there; None when no way is known.

        Args:
            place: where it is.
            yaw_rad: where it points.
            turn_m_per_rad: what the first turn costs: the way that it could fly meanwhile.
        """
        window = self.window
        row, column = window.cell(place)
        path = _path(window.grid, self.steps, self.room, row, column, place.ground_dm)
        if len(path) == 0:
            return None
        last = _straight(window.grid, self.room, row, column, place.ground_dm, path)
        straight = window.middle(*(int(at) for at in path[last]))
        goal = window.middle(*(int(at) for at in path[-1]))
        bearing_rad = math.atan2(straight.y_m - place.y_m, straight.x_m - place.x_m) - yaw_rad
        turn_rad = abs(math.remainder(bearing_rad, 2.0 * math.pi))
        return Way(int(self.steps[tuple(path[0])]) * window.cell_m + turn_m_per_rad * turn_rad, straight, goal)

    def route(self, place: Place, yaw_rad: float) -> Route | None:
        """The whole way from a place, as it is flown, straight by straight; None when no way is known.

        Args:
            place: where the vehicle is.
            yaw_rad: where it points.
        """
        window = self.window
        path = _path(window.grid, self.steps, self.room, *window.cell(place), place.ground_dm)
        if len(path) == 0:
            return None
        length_m = turn_rad = 0.0
        at = 0
        while True:
            at += max(1, _straight(window.grid, self.room, *window.cell(place), place.ground_dm, path[at:]))
            end = window.middle(*(int(where) for where in path[min(at, len(path) - 1)]))
            x_m, y_m = end.x_m - place.x_m, end.y_m - place.y_m
            length_m += math.hypot(x_m, y_m)
            turn_rad += abs(wrap_rad(math.atan2(y_m, x_m) - yaw_rad))
            place, yaw_rad = end, math.atan2(y_m, x_m)
            if at >= len(path) - 1:
                return Route(length_m, turn_rad)

    def cost_m(self, place: Place) -> float | None:
        """What the way from a place costs, which is its length where there is room; None when no way is known."""
        window = self.window
        level, row, column = _nearest_known(window.grid, self.steps, *window.cell(place), place.ground_dm)
        return None if level < 0 else int(self.steps[level, row, column]) * window.cell_m

    def is_goal(self, place: Place) -> bool:
        """Whether the unseen still begins there; also where that is not known, beyond what was searched."""
        row, column = self.window.cell(place)
        _, rows, columns = self.steps.shape
        if not (0 <= row < rows and 0 <= column < columns):
            return True
        level = level_at(self.window.grid, row, column, place.ground_dm)
        return bool(level >= 0 and self.steps[level, row, column] == 0)

    def along_m(self, start: WallFollowing) -> float:
        """Length of the way to the unseen for whoever follows a wall from there first; infinite when there is none."""
        row, column = self.window.cell(start.place)
        cells = _trace(
            *(self.window.grid, self.room, self.steps, row, column, start.place.ground_dm),
            *(start.direction_rad, start.gamma),
        )
        return float(cells) * self.window.cell_m


def find_ways(ground: KnownGround, place: Place) -> Ways | None:
    """Search about a place; None before anything has been seen."""
    window = ground.window(place.x_m, place.y_m)
    return None if window is None else ways_within(window, place)


def find_ways_but(ground: KnownGround, place: Place, taken: Sequence[Place], within_m: float) -> Ways | None:
    """Search about a place for what is unseen, but not as near as that to others; None where no way leads to any."""
    window = ground.window(place.x_m, place.y_m)
    if window is None:
        return None
    goals = frontier_cells(window)
    levels, rows, columns = np.nonzero(goals)
    for goal in taken:
        row, column = window.cell(goal)
        near = np.hypot(rows - row, columns - column) * window.cell_m <= within_m
        near &= np.abs(window.grid.ground_dm[levels, rows, columns] - goal.ground_dm) <= LEVEL_DM
        goals[levels[near], rows[near], columns[near]] = False
    ways = ways_within(window, place, goals)
    return None if ways.cost_m(place) is None else ways


def ways_within(window: Window, place: Place, goals: NDArray[np.bool_] | None = None) -> Ways:
    """Search in a part of the known ground.

    Args:
        window: the part.
        place: where the vehicle is: only when no way leads from there to a frontier, chinks are goals as well.
        goals: (levels, rows, columns) where the unseen is to begin; None: at every frontier.
    """
    room = _room(window.grid)
    _widen(room, window.flown)
    for row, column, ground_dm in window.blocked.tolist():
        _close(window.grid, room, row, column, ground_dm)
    if goals is not None:
        return Ways(window, room, _steps(window.grid, room, goals))
    steps = _steps(window.grid, room, frontier_cells(window))
    if _nearest_known(window.grid, steps, *window.cell(place), place.ground_dm)[0] < 0:
        steps = _steps(window.grid, room, _frontier(window.grid, 1))
    return Ways(window, room, steps)


def frontier_cells(window: Window) -> NDArray[np.bool_]:
    """(levels, rows, columns) from which the unseen begins, but for chinks."""
    return _frontier(window.grid, LEAST_CLUSTER)


@compiled
def _room(grid: GroundGrid) -> NDArray[np.uint8]:
    """How many cells from the nearest wall, 2 at most; 0 where there is no room: beside a wall, and in the unseen."""
    levels, rows, columns = grid.cells.shape
    room = np.zeros((levels, rows, columns), np.uint8)
    for level in range(levels):
        for r in range(2, rows - 2):
            for c in range(2, columns - 2):
                if grid.cells[level, r, c] == FREE:
                    room[level, r, c] = 2
    for level in range(levels):
        for r in range(rows):
            for c in range(columns):
                if grid.cells[level, r, c] != WALL:
                    continue
                ground_dm = int(grid.ground_dm[level, r, c])
                for a in range(max(r - 2, 0), min(r + 3, rows)):
                    for b in range(max(c - 2, 0), min(c + 3, columns)):
                        beside = level_at(grid, a, b, ground_dm)
                        if beside >= 0:
                            room[beside, a, b] = min(room[beside, a, b], max(abs(a - r), abs(b - c), 1) - 1)
    return room


@compiled
def _widen(room: NDArray[np.uint8], flown: NDArray[np.int64]) -> None:
    """Where it was flown there is room for the body, if not for more."""
    for k in range(flown.shape[0]):
        level, row, column = flown[k]
        room[level, row, column] = max(room[level, row, column], 1)


@compiled
def _close(grid: GroundGrid, room: NDArray[np.uint8], row: int, column: int, ground_dm: int) -> None:
    """No room in a cell and all about it, at a height."""
    for r in range(row - 1, row + 2):
        for c in range(column - 1, column + 2):
            level = level_at(grid, r, c, ground_dm)
            if level >= 0:
                room[level, r, c] = 0


@compiled
def _frontier(grid: GroundGrid, least: int) -> NDArray[np.bool_]:
    """The cells of frontiers in which so many lie together."""
    levels, rows, columns = grid.cells.shape
    at = np.zeros((levels, rows, columns), np.bool_)
    for level in range(levels):
        for r in range(1, rows - 1):
            for c in range(1, columns - 1):
                at[level, r, c] = grid.cells[level, r, c] == FREE and is_frontier(grid, level, r, c)
    done = np.zeros((levels, rows, columns), np.bool_)
    stack = np.empty((levels * rows * columns, 3), np.int32)
    for level in range(levels):
        for r in range(1, rows - 1):
            for c in range(1, columns - 1):
                if not at[level, r, c] or done[level, r, c]:
                    continue
                size, top = 0, 1
                stack[0, 0], stack[0, 1], stack[0, 2] = level, r, c
                done[level, r, c] = True
                # The stack is not emptied by writing over it: what was taken from it is the cluster.
                while size < top:
                    k, a, b = stack[size, 0], stack[size, 1], stack[size, 2]
                    size += 1
                    for dr in range(-1, 2):
                        for dc in range(-1, 2):
                            to = step_to(grid, k, a, b, a + dr, b + dc)
                            if to >= 0 and at[to, a + dr, b + dc] and not done[to, a + dr, b + dc]:
                                done[to, a + dr, b + dc] = True
                                stack[top, 0], stack[top, 1], stack[top, 2] = to, a + dr, b + dc
                                top += 1
                if size < least:
                    for n in range(size):
                        at[stack[n, 0], stack[n, 1], stack[n, 2]] = False
    return at


@compiled
def _cost(room: NDArray[np.uint8], level: int, row: int, column: int) -> int:
    """What a cell costs to be flown through: one near a wall counts twice, so that ways keep to the middle."""
    return 2 if room[level, row, column] == 1 else 1


@compiled
def _steps(grid: GroundGrid, room: NDArray[np.uint8], goals: NDArray[np.bool_]) -> Steps:
    """Cost of the way to the goals, by Dijkstra's algorithm; through cells with room, at its end through any free.

    Costs are 1 and 2, so three queues that take turns hold what is to be visited in order.
    """
    levels, rows, columns = grid.cells.shape
    steps = np.full((levels, rows, columns), -1, np.int32)
    done = np.zeros((levels, rows, columns), np.bool_)
    queues = np.empty((3, 2 * levels * rows * columns, 3), np.int32)
    sizes = np.zeros(3, np.int64)
    for level in range(levels):
        for r in range(2, rows - 2):
            for c in range(2, columns - 2):
                if goals[level, r, c]:
                    steps[level, r, c] = 0
                    queues[0, sizes[0], 0], queues[0, sizes[0], 1], queues[0, sizes[0], 2] = level, r, c
                    sizes[0] += 1
    now, idle = 0, 0
    while idle < 3:
        which = now % 3
        idle = idle + 1 if sizes[which] == 0 else 0
        for k in range(sizes[which]):
            level, r, c = queues[which, k, 0], queues[which, k, 1], queues[which, k, 2]
            if done[level, r, c] or steps[level, r, c] != now:
                continue
            done[level, r, c] = True
            for n in range(4):
                a, b = r + (n == 0) - (n == 1), c + (n == 2) - (n == 3)
                if not (1 < a < rows - 2 and 1 < b < columns - 2):
                    continue
                to = step_to(grid, level, r, c, a, b)
                if to < 0 or done[to, a, b]:
                    continue
                step = now + _cost(room, to, a, b)
                near = step <= NEAR_STEPS and grid.cells[to, a, b] == FREE
                if (room[to, a, b] > 0 or near) and not 0 <= steps[to, a, b] <= step:
                    steps[to, a, b] = step
                    queue = step % 3
                    queues[queue, sizes[queue], 0], queues[queue, sizes[queue], 1] = to, a
                    queues[queue, sizes[queue], 2] = b
                    sizes[queue] += 1
        sizes[which] = 0
        now += 1
    return steps


@compiled
def _nearest_known(grid: GroundGrid, steps: Steps, row: int, column: int, ground_dm: int) -> tuple[int, int, int]:
    """The cell itself, or the nearest within two of it from which a way is known; (-1, -1, -1) when there is none."""
    _, rows, columns = steps.shape
    best, found = np.inf, (-1, -1, -1)
    for r in range(max(row - 2, 0), min(row + 3, rows)):
        for c in range(max(column - 2, 0), min(column + 3, columns)):
            off = (r - row) ** 2 + (c - column) ** 2
            level = level_at(grid, r, c, ground_dm)
            if level >= 0 and steps[level, r, c] >= 0 and off < best:
                best, found = off, (level, r, c)
    return found


@compiled
def _path(grid: GroundGrid, steps: Steps, room: NDArray[np.uint8], row: int, column: int, ground_dm: int) -> Steps:
    """(n, 3) levels, rows and columns from there to where the unseen begins, both ends included; empty: no way."""
    level, r, c = _nearest_known(grid, steps, row, column, ground_dm)
    if level < 0:
        return np.empty((0, 3), np.int32)
    path = np.empty((steps[level, r, c] + 1, 3), np.int32)
    path[0, 0], path[0, 1], path[0, 2] = level, r, c
    size, before = 1, 0
    while steps[level, r, c] > 0:
        # Straight on where that is as short, so that corridors stay straight.
        for turn in range(4):
            towards = (before + turn) % 4
            a, b = r + (towards == 0) - (towards == 1), c + (towards == 2) - (towards == 3)
            to = step_to(grid, level, r, c, a, b)
            if to >= 0 and steps[to, a, b] == steps[level, r, c] - _cost(room, level, r, c):
                before = towards
                break
        level, r, c = to, a, b
        path[size, 0], path[size, 1], path[size, 2] = level, r, c
        size += 1
    return path[:size]


@compiled
def _straight(grid: GroundGrid, room: NDArray[np.uint8], row: int, column: int, ground_dm: int, path: Steps) -> int:
    """Index of the last cell of a path to which a straight line has room, but for its first metre and last cell.

    The more room the better: only where no line has two cells to every wall is one enough.
    """
    for least in (2, 1):
        last = 0
        for k in range(path.shape[0]):
            dr, dc = path[k, 1] - row, path[k, 2] - column
            far = max(abs(dr), abs(dc))
            along_dm, free = ground_dm, True
            for i in range(3, 2 * far - 1):
                r = row + int(np.floor(dr * i / (2.0 * far) + 0.5))
                c = column + int(np.floor(dc * i / (2.0 * far) + 0.5))
                level = level_at(grid, r, c, along_dm)
                free = free and level >= 0 and room[level, r, c] >= least
                if not free:
                    break
                along_dm = int(grid.ground_dm[level, r, c])
            if free:
                last = k
            elif k - last > MOST_HIDDEN:
                break
        if last > 3:
            break
    return last


@compiled
def _may_go(grid: GroundGrid, room: NDArray[np.uint8], row: int, column: int, ground_dm: int) -> bool:
    """Whether a cell may be flown into in thought: there is room, or nothing is known of it."""
    _, rows, columns = grid.cells.shape
    if not (0 < row < rows - 1 and 0 < column < columns - 1):
        return False
    level = level_at(grid, row, column, ground_dm)
    return bool(level < 0 or room[level, row, column] > 0)


@compiled
def _trace(
    grid: GroundGrid,
    room: NDArray[np.uint8],
    steps: Steps,
    row: int,
    column: int,
    ground_dm: int,
    direction_rad: float,
    gamma: int,
) -> float:
    """Cells along a wall, hand on it, to where the unseen begins, or for `TRACE_CELLS` and the way from there."""
    _, rows, columns = grid.cells.shape
    row_step, column_step = (0, 1, 0, -1), (1, 0, -1, 0)
    heading = int(np.floor(direction_rad / (np.pi / 2.0) + 0.5)) % 4
    aside = (heading + gamma) % 4
    for k in range(4):
        # The grid is coarse: begin at the wall, not beside it.
        r, c = row + row_step[aside] * k, column + column_step[aside] * k
        if not _may_go(grid, room, r + row_step[aside], c + column_step[aside], ground_dm):
            row, column = r, c
            break
    for k in range(TRACE_CELLS):
        if not (0 < row < rows - 1 and 0 < column < columns - 1):
            return np.inf
        level = level_at(grid, row, column, ground_dm)
        if level < 0 or 0 <= steps[level, row, column] <= 1:
            return float(k)
        ground_dm = int(grid.ground_dm[level, row, column])
        turned = False
        for turn in (gamma, 0, -gamma, 2):
            towards = (heading + turn) % 4
            a, b = row + row_step[towards], column + column_step[towards]
            if _may_go(grid, room, a, b, ground_dm):
                heading, row, column = towards, a, b
                turned = True
                break
        if not turned:
            break
    level, r, c = _nearest_known(grid, steps, row, column, ground_dm)
    return np.inf if level < 0 else float(TRACE_CELLS + steps[level, r, c])
