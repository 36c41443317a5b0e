"""What of the mine's plan has been seen.

This is what makes the choice at a tangent better than a fixed coin. The theorem of the paper needs both outcomes of
every draw to stay possible, not the coin to be fixed: whatever chooses must keep each probability within
[p_min, 1 - p_min]. Nothing but these probabilities depends on the grid, so an error in it costs time, never safety.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled
from companion.control.ground_grid import FREE, GIVEN_UP, MOST_LEVELS, UNSEEN, WALL, GroundGrid, enter, level_at
from companion.model import HIT, UNKNOWN, Measurement, Pose, Scan

CELL_M = 0.5
"""Size of a cell: a fraction of any drift that a vehicle fits through, and few enough cells for a search in a tick."""

LOOK_M, LOOK_DEEP_M = 5.0, 1.0
"""Ground counts as seen as far as this, and where the roof is so high that it comes into the picture only there, so
much further."""

FIRST_CELLS, MOST_CELLS = 256, 2048
"""Side of the grid at the start and at most, in cells: 128 m, doubled as needed up to 1 km. Ground outside of the
largest grid counts as seen, so that it does not attract."""

SEARCH_CELLS = 384
"""Side of the window about the vehicle in which ways are searched, in cells: 192 m, about two milliseconds. Beyond it
everything counts as seen, so that the nearer unseen ground decides."""

BORDER_CELLS = 3
"""A part of the grid is searched but for its outermost cells."""

MOST_BLOCKED = 256
"""Places through which no way leads, the newest."""

HIGHEST_M = 3000.0
"""Above and below the origin of the flight: heights are kept as 16 bits of decimetres."""


class Outlook(NamedTuple):
    """What of floor and roof the camera sees from a vehicle that hovers level.

    Attributes:
        down: how far ahead its lowest ray meets a floor that lies a metre below; infinite when it never does.
        up: the same for its highest ray, and a roof a metre above.
        reach_m: how far the map believes it.
    """

    down: float
    up: float
    reach_m: float

    @classmethod
    def of(cls, lowest_rad: float, highest_rad: float, reach_m: float) -> Outlook:
        """That of a camera whose image ends at these elevations, upward positive."""
        down, up = (1.0 / math.tan(off) if off > 0.0 else math.inf for off in (-lowest_rad, highest_rad))
        return cls(down, up, reach_m)

    def seen_m(self, h_m: float, roof_m: float) -> tuple[float, float]:
        """Between which distances ground counts as seen, floor and roof being so far below and above.

        Nearer they lie outside of the picture, and what is only passed beside or in a turn stays unseen: corners most
        of all. Under a roof that never comes into the picture the furthest half metre counts.
        """
        from_m = max(h_m * self.down, roof_m * self.up)
        to_m = min(max(LOOK_M, from_m + LOOK_DEEP_M), self.reach_m)
        return max(min(from_m, to_m - CELL_M), 0.0), to_m


UPRIGHT_57_DEG = Outlook.of(-math.radians(28.5), math.radians(28.5), 6.0)
"""That of the camera of preset flight."""


@dataclass(frozen=True, slots=True)
class Place:
    """A point of the plan, and the height of the ground there."""

    x_m: float
    y_m: float
    ground_m: float

    @classmethod
    def under(cls, pose: Pose, h_m: float | None) -> Place:
        """The ground below a vehicle; where h is not known, as if it flew at its own height."""
        return cls(pose.x_m, pose.y_m, pose.z_m - (0.0 if h_m is None else h_m))

    @property
    def ground_dm(self) -> int:
        """The height as the grid has it."""
        return round(10.0 * min(max(self.ground_m, -HIGHEST_M), HIGHEST_M))


@dataclass(frozen=True, slots=True)
class Window:
    """A part of the grid.

    Attributes:
        grid: of it.
        blocked: (k, 3) rows, columns and heights in dm through which no way leads, whatever is seen there.
        x_m, y_m: of its low corner.
        cell_m: side of a cell.
    """

    grid: GroundGrid
    blocked: NDArray[np.int64]
    x_m: float
    y_m: float
    cell_m: float

    def cell(self, place: Place) -> tuple[int, int]:
        """Row and column of a point."""
        return math.floor((place.y_m - self.y_m) / self.cell_m), math.floor((place.x_m - self.x_m) / self.cell_m)

    def middle(self, level: int, row: int, column: int) -> Place:
        """The point in the middle of a cell."""
        x_m, y_m = self.x_m + (column + 0.5) * self.cell_m, self.y_m + (row + 0.5) * self.cell_m
        return Place(x_m, y_m, float(self.grid.ground_dm[level, row, column]) / 10.0)


class KnownGround:
    """A grid of unseen, free and wall cells about the place where the flight began, by levels.

    Args:
        outlook: what the camera sees of floor and roof.
    """

    def __init__(self, outlook: Outlook = UPRIGHT_57_DEG) -> None:
        self._outlook = outlook
        self._grid = GroundGrid.unseen(FIRST_CELLS, FIRST_CELLS)
        self._origin: tuple[float, float] | None = None
        self._blocked: deque[Place] = deque(maxlen=MOST_BLOCKED)

    def see(self, measurement: Measurement, pose: Pose) -> None:
        """Enter what is in view: free along each bearing, a wall where it is HIT, at the height of the ground there."""
        scan = measurement.scan
        if scan is None:
            return
        if self._origin is None:
            half_m = FIRST_CELLS * CELL_M / 2.0
            self._origin = (pose.x_m - half_m, pose.y_m - half_m)
        while not self._holds(pose) and self._grow():
            pass
        below = Place.under(pose, measurement.h_m)
        # A height that is not known is taken for that of the other one.
        h_m = _first(measurement.h_m, measurement.roof_m)
        from_m, to_m = self._outlook.seen_m(h_m, _first(measurement.roof_m, h_m))
        had_room = _see(
            self._grid,
            (pose.x_m - self._origin[0]) / CELL_M,
            (pose.y_m - self._origin[1]) / CELL_M,
            pose.yaw_rad,
            scan,
            from_m,
            to_m,
            below.ground_dm,
            measurement.ground_slope or 0.0,
        )
        if not had_room and len(self._grid.cells) < MOST_LEVELS:
            # What had no room is entered with the next look.
            self._grid = self._grid.with_level()

    def window(self, x_m: float, y_m: float) -> Window | None:
        """A copy of the part about a place in which ways are searched; None before anything has been seen."""
        if self._origin is None:
            return None
        side = self._side
        size = min(side, SEARCH_CELLS)
        column, row = self._cell(x_m, y_m)
        left = min(max(column - size // 2, 0), side - size)
        low = min(max(row - size // 2, 0), side - size)
        return self._part(slice(low, low + size), slice(left, left + size))

    def whole(self) -> Window | None:
        """A copy of all that is known, and a little around it; None before anything has been seen."""
        known = np.any(self._grid.cells != UNSEEN, axis=0)
        if self._origin is None or not known.any():
            return None
        rows, columns = np.flatnonzero(known.any(axis=1)), np.flatnonzero(known.any(axis=0))
        spans = (slice(max(at[0] - BORDER_CELLS, 0), at[-1] + 1 + BORDER_CELLS) for at in (rows, columns))
        return self._part(*spans)

    def _part(self, rows: slice, columns: slice) -> Window:
        """A copy of a part of the grid, with what is blocked in it."""
        assert self._origin is not None  # noqa: S101 - set by the first look
        part = self._grid.part(rows, columns)
        low_x_m, low_y_m = self._origin[0] + columns.start * CELL_M, self._origin[1] + rows.start * CELL_M
        window = Window(
            GroundGrid(part.cells.copy(), part.ground_dm.copy()), np.empty((0, 3), np.int64), low_x_m, low_y_m, CELL_M
        )
        blocked = np.array([(*window.cell(place), place.ground_dm) for place in self._blocked], np.int64).reshape(-1, 3)
        most = np.array(part.cells.shape[1:]) - 1
        inside = np.all((blocked[:, :2] >= 1) & (blocked[:, :2] < most), axis=1)
        return replace(window, blocked=blocked[inside])

    def block(self, place: Place) -> None:
        """No way leads through the cells about this place any more."""
        self._blocked.append(place)

    def give_up(self, place: Place, radius_m: float) -> None:
        """What is unseen about that place attracts nobody any more; if it is seen after all, it is free."""
        if self._origin is None:
            return
        column, row = self._cell(place.x_m, place.y_m)
        _give_up(self._grid, row, column, math.ceil(radius_m / CELL_M), place.ground_dm)

    def take_up_again(self) -> None:
        """What was given up attracts again, and what was blocked may be tried again."""
        self._grid.cells[self._grid.cells == GIVEN_UP] = UNSEEN
        self._blocked.clear()

    @property
    def _side(self) -> int:
        return int(self._grid.cells.shape[1])

    def _cell(self, x_m: float, y_m: float) -> tuple[int, int]:
        """Column and row of a point."""
        assert self._origin is not None  # noqa: S101 - set by the first look
        return math.floor((x_m - self._origin[0]) / CELL_M), math.floor((y_m - self._origin[1]) / CELL_M)

    def _holds(self, pose: Pose) -> bool:
        assert self._origin is not None  # noqa: S101 - set by the first look
        side_m = self._side * CELL_M
        border_m = LOOK_M + 1.0
        x, y = pose.x_m - self._origin[0], pose.y_m - self._origin[1]
        return border_m < x < side_m - border_m and border_m < y < side_m - border_m

    def _grow(self) -> bool:
        """Double the grid about its centre; False when it is as large as it may be."""
        assert self._origin is not None  # noqa: S101 - set by the first look
        side = self._side
        if side >= MOST_CELLS:
            return False
        self._grid = self._grid.grown()
        self._origin = (self._origin[0] - side / 2 * CELL_M, self._origin[1] - side / 2 * CELL_M)
        return True


def _first(*numbers: float | None) -> float:
    """The first that is known; 0 when none is."""
    return next((number for number in numbers if number is not None), 0.0)


@compiled
def _give_up(grid: GroundGrid, row: int, column: int, reach: int, ground_dm: int) -> None:
    """What is unseen at that height in a cell and so many around it is given up."""
    side = grid.cells.shape[1]
    for r in range(max(row - reach, 0), min(row + reach + 1, side)):
        for c in range(max(column - reach, 0), min(column + reach + 1, side)):
            if level_at(grid, r, c, ground_dm) < 0:
                enter(grid, r, c, ground_dm, GIVEN_UP)


@compiled
def _see(
    grid: GroundGrid,
    x: float,
    y: float,
    yaw_rad: float,
    scan: Scan,
    seen_from_m: float,
    seen_to_m: float,
    ground_dm: int,
    slope: float,
) -> bool:
    """Enter a scan made at a place that is given in cells, above ground that rises ahead by the slope.

    Returns:
        whether the grid had a level for all of it.
    """
    look_from, look = seen_from_m / CELL_M, seen_to_m / CELL_M
    side = grid.cells.shape[1]
    had_room = True
    for i in range(scan.bearings_rad.size):
        if scan.state[i] == UNKNOWN or not scan.fresh[i]:
            continue
        wall, range_cells = scan.state[i] == HIT, scan.ranges_m[i] / CELL_M
        dx = np.cos(yaw_rad + scan.bearings_rad[i])
        dy = np.sin(yaw_rad + scan.bearings_rad[i])
        rise_dm = 10.0 * CELL_M * slope * np.cos(scan.bearings_rad[i])
        # Free up to half a cell before the obstacle, so that the cell of a wall does not become free at a slant.
        free = min(range_cells - 0.5, look) if wall else min(range_cells, look)
        distance = look_from
        while distance <= free:
            column, row = int(np.floor(x + distance * dx)), int(np.floor(y + distance * dy))
            if 0 <= row < side and 0 <= column < side:
                had_room &= enter(grid, row, column, int(ground_dm + distance * rise_dm), FREE)
            distance += 0.5
        if wall and range_cells <= look:
            column, row = int(np.floor(x + range_cells * dx)), int(np.floor(y + range_cells * dy))
            if 0 <= row < side and 0 <= column < side:
                had_room &= enter(grid, row, column, int(ground_dm + range_cells * rise_dm), WALL)
    return had_room
