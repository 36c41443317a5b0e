"""What of the mine's plan has been seen, and how far it is from anywhere to what has not.

This is what makes the choice at a tangent better than a fixed coin. The theorem of the paper needs both outcomes of
every draw to stay possible, not the coin to be fixed: whatever chooses must keep each probability within
[p_min, 1 - p_min]. Nothing but these probabilities depends on the grid, so an error in it costs time, never safety.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled
from companion.model import HIT, UNKNOWN, Pose, Scan

CELL_M = 0.5
"""Size of a cell: a fraction of any drift that a vehicle fits through, and few enough cells for a search in a tick."""

SEEN_FROM_M, LOOK_M = 2.76, 5.0
"""Ground counts as seen between these distances. Nearer, floor and roof 1.5 m below and above lie outside of the
picture of a camera that sees 57° upright, and what is only passed beside or in a turn stays unseen; further, depth is
not good enough for a map."""

FIRST_CELLS, MOST_CELLS = 256, 2048
"""Side of the grid at the start and at most, in cells: 128 m, doubled as needed up to 1 km. Ground outside of the
largest grid counts as seen, so that it does not attract."""

SEARCH_CELLS = 384
"""Side of the window about the vehicle in which ways are searched, in cells: 192 m, about two milliseconds. Beyond it
everything counts as seen, so that the nearer unseen ground decides."""

FOLLOW_CELLS = 240
"""How far a wall is followed in thought, in cells: 120 m, once round a large pillar."""

MOST_BLOCKED = 256
"""Places through which no way leads, the newest."""

DETOUR = 3.0
"""Ground that a followed wall passes at a distance counts this much further than that distance: to get there another
tangent must come and be taken."""

UNSEEN, FREE, WALL, GIVEN_UP = np.uint8(0), np.uint8(1), np.uint8(2), np.uint8(3)
"""What is known of a cell; what could not be seen from where it was looked for is given up."""


@dataclass(frozen=True, slots=True)
class WallFollowing:
    """Where the vehicle would begin to follow a wall, heading where, with the wall on which side (Γ)."""

    x_m: float
    y_m: float
    direction_rad: float
    gamma: int


@dataclass(frozen=True, slots=True)
class Window:
    """A part of the grid.

    Attributes:
        cells: (rows, columns), rows along y.
        blocked: (k, 2) rows and columns through which no way leads, whatever is seen there.
        x_m, y_m: of its low corner.
        cell_m: side of a cell.
    """

    cells: NDArray[np.uint8]
    blocked: NDArray[np.int64]
    x_m: float
    y_m: float
    cell_m: float

    def cell(self, x_m: float, y_m: float) -> tuple[int, int]:
        """Row and column of a point."""
        return math.floor((y_m - self.y_m) / self.cell_m), math.floor((x_m - self.x_m) / self.cell_m)

    def middle(self, row: int, column: int) -> tuple[float, float]:
        """The point x, y in the middle of a cell."""
        return self.x_m + (column + 0.5) * self.cell_m, self.y_m + (row + 0.5) * self.cell_m


class KnownGround:
    """A plan grid of unseen, free and wall cells about the place where the flight began.

    Args:
        seen_from_m: nearer, floor and roof are not in the picture.
    """

    def __init__(self, seen_from_m: float = SEEN_FROM_M) -> None:
        self._seen_from_m = min(seen_from_m, LOOK_M - CELL_M)
        self._cells = np.zeros((FIRST_CELLS, FIRST_CELLS), np.uint8)
        self._origin: tuple[float, float] | None = None
        self._blocked_m: deque[tuple[float, float]] = deque(maxlen=MOST_BLOCKED)

    def see(self, scan: Scan, pose: Pose) -> None:
        """Enter what is in view: free along each bearing, a wall where it is HIT."""
        if self._origin is None:
            half_m = FIRST_CELLS * CELL_M / 2.0
            self._origin = (pose.x_m - half_m, pose.y_m - half_m)
        while not self._holds(pose) and self._grow():
            pass
        _see(
            self._cells,
            (pose.x_m - self._origin[0]) / CELL_M,
            (pose.y_m - self._origin[1]) / CELL_M,
            pose.yaw_rad,
            scan,
            self._seen_from_m,
        )

    def window(self, x_m: float, y_m: float) -> Window | None:
        """A copy of the part about a place in which ways are searched; None before anything has been seen."""
        if self._origin is None:
            return None
        side = len(self._cells)
        size = min(side, SEARCH_CELLS)
        column, row = self._cell(x_m, y_m)
        left = min(max(column - size // 2, 0), side - size)
        low = min(max(row - size // 2, 0), side - size)
        cells = self._cells[low : low + size, left : left + size].copy()
        low_x_m, low_y_m = self._origin[0] + left * CELL_M, self._origin[1] + low * CELL_M
        places_m = np.array(self._blocked_m).reshape(-1, 2)
        blocked = np.floor((places_m[:, ::-1] - [low_y_m, low_x_m]) / CELL_M).astype(np.int64)
        inside = np.all((blocked >= 1) & (blocked < size - 1), axis=1)
        return Window(cells, blocked[inside], low_x_m, low_y_m, CELL_M)

    def block(self, x_m: float, y_m: float) -> None:
        """No way leads through the cells about this place any more."""
        self._blocked_m.append((x_m, y_m))

    def give_up(self, x_m: float, y_m: float, radius_m: float) -> None:
        """What is unseen about that place attracts nobody any more; if it is seen after all, it is free."""
        if self._origin is None:
            return
        column, row = self._cell(x_m, y_m)
        reach = math.ceil(radius_m / CELL_M)
        part = self._cells[max(row - reach, 0) : row + reach + 1, max(column - reach, 0) : column + reach + 1]
        part[part == UNSEEN] = GIVEN_UP

    def take_up_again(self) -> None:
        """What was given up attracts again, and what was blocked may be tried again."""
        self._cells[self._cells == GIVEN_UP] = UNSEEN
        self._blocked_m.clear()

    def way_to_unseen_m(self, from_m: tuple[float, float], starts: Sequence[WallFollowing]) -> list[float]:
        """Length of the way from a point to unseen ground, for each of several walls that it may go and follow.

        The wall is followed in thought on the grid, with the hand on it, until unseen ground is reached; ground that is
        only passed by counts as far as a detour to it. inf when there is none.

        Args:
            from_m: x and y of the vehicle.
            starts: where each following begins; the straight way there counts too.
        """
        window = self.window(*from_m)
        if window is None:
            return [math.inf for _ in starts]
        steps = _steps_to_unseen(window.cells)
        ways = []
        for start in starts:
            r, c = window.cell(start.x_m, start.y_m)
            onward = _follow(window.cells, steps, r, c, start.direction_rad, start.gamma, FOLLOW_CELLS)
            there_m = abs(start.x_m - from_m[0]) + abs(start.y_m - from_m[1])
            ways.append(there_m + onward * CELL_M)
        return ways

    def _cell(self, x_m: float, y_m: float) -> tuple[int, int]:
        """Column and row of a point."""
        assert self._origin is not None  # noqa: S101 - set by the first look
        return math.floor((x_m - self._origin[0]) / CELL_M), math.floor((y_m - self._origin[1]) / CELL_M)

    def _holds(self, pose: Pose) -> bool:
        assert self._origin is not None  # noqa: S101 - set by the first look
        side_m = len(self._cells) * CELL_M
        border_m = LOOK_M + 1.0
        x, y = pose.x_m - self._origin[0], pose.y_m - self._origin[1]
        return border_m < x < side_m - border_m and border_m < y < side_m - border_m

    def _grow(self) -> bool:
        """Double the grid about its centre; False when it is as large as it may be."""
        assert self._origin is not None  # noqa: S101 - set by the first look
        side = len(self._cells)
        if side >= MOST_CELLS:
            return False
        larger = np.zeros((2 * side, 2 * side), np.uint8)
        larger[side // 2 : side // 2 + side, side // 2 : side // 2 + side] = self._cells
        self._cells = larger
        self._origin = (self._origin[0] - side / 2 * CELL_M, self._origin[1] - side / 2 * CELL_M)
        return True


@compiled
def _see(cells: NDArray[np.uint8], x: float, y: float, yaw_rad: float, scan: Scan, seen_from_m: float) -> None:
    """Enter a scan made at a place that is given in cells."""
    look_from, look = seen_from_m / CELL_M, LOOK_M / CELL_M
    side = cells.shape[0]
    for i in range(scan.bearings_rad.size):
        if scan.state[i] == UNKNOWN or not scan.fresh[i]:
            continue
        wall, range_cells = scan.state[i] == HIT, scan.ranges_m[i] / CELL_M
        dx = np.cos(yaw_rad + scan.bearings_rad[i])
        dy = np.sin(yaw_rad + scan.bearings_rad[i])
        # Free up to half a cell before the obstacle, so that the cell of a wall does not become free at a slant.
        free = min(range_cells - 0.5, look) if wall else min(range_cells, look)
        distance = look_from
        while distance <= free:
            column, row = int(np.floor(x + distance * dx)), int(np.floor(y + distance * dy))
            if 0 <= row < side and 0 <= column < side and cells[row, column] in (UNSEEN, GIVEN_UP):
                cells[row, column] = FREE
            distance += 0.5
        if wall and range_cells <= look:
            column, row = int(np.floor(x + range_cells * dx)), int(np.floor(y + range_cells * dy))
            if 0 <= row < side and 0 <= column < side:
                cells[row, column] = WALL


@compiled
def is_frontier(cells: NDArray[np.uint8], row: int, column: int) -> bool:
    """Whether a cell is free and beside two unseen ones or more; not at the border of the grid.

    A chink between the points of a wall is no frontier: there a wall is beside the unseen.
    """
    unseen, wall = 0, 0
    for r in range(row - 1, row + 2):
        for c in range(column - 1, column + 2):
            unseen += cells[r, c] == UNSEEN
            wall += cells[r, c] == WALL
    return bool(cells[row, column] == FREE and unseen >= 2 and wall == 0)


@compiled
def _steps_to_unseen(cells: NDArray[np.uint8]) -> NDArray[np.int32]:
    """Breadth-first search from every frontier through free cells; -1 where it does not come, 0 in unseen cells."""
    side = cells.shape[0]
    steps = np.full((side, side), -1, np.int32)
    queue = np.empty(side * side, np.int32)
    head, tail = 0, 0
    for row in range(1, side - 1):
        for column in range(1, side - 1):
            if cells[row, column] == UNSEEN:
                steps[row, column] = 0
            elif is_frontier(cells, row, column):
                steps[row, column] = 1
                queue[tail] = row * side + column
                tail += 1
    while head < tail:
        row, column = queue[head] // side, queue[head] % side
        head += 1
        for k in range(4):
            r = row + (k == 0) - (k == 1)
            c = column + (k == 2) - (k == 3)
            if 0 < r < side - 1 and 0 < c < side - 1 and cells[r, c] == FREE and steps[r, c] < 0:
                steps[r, c] = steps[row, column] + 1
                queue[tail] = r * side + c
                tail += 1
    return steps


@compiled
def _has_room(cells: NDArray[np.uint8], row: int, column: int) -> bool:
    """Whether a cell may be flown through: not a wall, nor beside one; unseen ground may."""
    side = cells.shape[0]
    if not (0 < row < side - 1 and 0 < column < side - 1):
        return False
    for r in range(row - 1, row + 2):
        for c in range(column - 1, column + 2):
            if cells[r, c] == WALL:
                return False
    return True


@compiled
def _follow(
    cells: NDArray[np.uint8],
    steps: NDArray[np.int32],
    row: int,
    column: int,
    direction_rad: float,
    gamma: int,
    most: int,
) -> float:
    """Steps along a wall, hand on it, to unseen ground: the rule of the maze, toward the wall whenever that is open."""
    side = cells.shape[0]
    row_step, column_step = (0, 1, 0, -1), (1, 0, -1, 0)
    # Quarter turns counter-clockwise, 0 along x: rows grow with y.
    heading = int(np.floor(direction_rad / (np.pi / 2.0) + 0.5)) % 4
    for k in range(4):
        # The grid is coarse: begin at the wall, not beside it.
        r = row + row_step[(heading + gamma) % 4] * k
        c = column + column_step[(heading + gamma) % 4] * k
        if not _has_room(cells, r + row_step[(heading + gamma) % 4], c + column_step[(heading + gamma) % 4]):
            row, column = r, c
            break
    best = np.inf
    for k in range(most):
        if not (0 <= row < side and 0 <= column < side):
            break
        if steps[row, column] >= 0:
            best = min(best, k + DETOUR * steps[row, column])
            if steps[row, column] <= 1:
                break
        turned = False
        for turn in (gamma, 0, -gamma, 2):
            towards = (heading + turn) % 4
            if _has_room(cells, row + row_step[towards], column + column_step[towards]):
                heading = towards
                row, column = row + row_step[towards], column + column_step[towards]
                turned = True
                break
        if not turned:
            break
    return best
