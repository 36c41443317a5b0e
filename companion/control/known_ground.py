"""What of the mine's plan has been seen.

This is what makes the choice at a tangent better than a fixed coin. The theorem of the paper needs both outcomes of
every draw to stay possible, not the coin to be fixed: whatever chooses must keep each probability within
[p_min, 1 - p_min]. Nothing but these probabilities depends on the grid, so an error in it costs time, never safety.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled
from companion.control.ground_grid import (
    FREE,
    GIVEN_UP,
    HIGHEST_M,
    HIT_WEIGHT,
    MOST_LEVELS,
    UNSEEN,
    WALL,
    GroundGrid,
    doubt,
    enter,
    level_at,
)
from companion.control.heard_ground import Sheet, with_heard
from companion.model import ABSURD, HIT, UNKNOWN, Measurement, Pose, Scan, wrap_rad

CELL_M, CELL_SHARE = 0.5, 0.625
"""Size of a cell: so much at most, and that share of d_c. A vehicle for narrow drifts needs smaller ones: the cells
beside a wall count as too near to it, and with 0.5 m a drift 2 m wide has no others."""

LOOK_M, LOOK_DEEP_M, LAST_M = 5.0, 1.0, 0.5
"""Ground counts as seen as far as this, and where the roof is so high that it comes into the picture only there, so
much further. The last half metre counts in any case."""

DOUBTED_M = 1.0
"""A wall is doubted by what is seen so far behind it: the rays along a wall pass through its cells as well."""

LEAST_LOOK_SHARE = 0.7
"""Of the reach of the map, however high the roof is: there walls and floor are mapped, if not the roof."""

FIRST_CELLS, MOST_CELLS = 256, 2048
"""Side of the grid at the start and at most, in cells: 128 m with the largest cells, doubled as needed up to 1 km.
Ground outside of the largest grid counts as seen, so that it does not attract."""

SEARCH_CELLS = 384
"""Side of the window about the vehicle in which ways are searched, in cells: 192 m with the largest, two milliseconds.
Beyond it everything counts as seen, so that the nearer unseen ground decides."""

BORDER_CELLS = 3
"""A part of the grid is searched but for its outermost cells."""

MOST_BLOCKED = 256
"""Places through which no way leads, the newest."""

FLOWN_M, MOST_FLOWN = 0.2, 65536
"""The way flown is kept in steps of this, less than a cell, for 13 km."""


class Outlook(NamedTuple):
    """What of floor and roof the camera sees from a vehicle that hovers level.

    Attributes:
        down: how far ahead its lowest ray meets a floor that lies a metre below; infinite when it never does.
        up: the same for its highest ray, and a roof a metre above.
        towards_rad: where it looks, to the left.
        half_width_rad: how far to each side of that it sees.
        reach_m: how far the map believes it, along a ray.
        dense_m: focal length in rows of the picture, times how far from each other these may meet a floor.
    """

    down: float
    up: float
    towards_rad: float
    half_width_rad: float
    reach_m: float
    dense_m: float = math.inf

    @classmethod
    def of(
        cls,
        lowest_rad: float,
        highest_rad: float,
        rightmost_rad: float,
        leftmost_rad: float,
        reach_m: float,
        dense_m: float = math.inf,
    ) -> Outlook:
        """That of a camera whose image ends at these elevations, upward positive, and bearings, to the left."""
        down, up = (1.0 / math.tan(off) if off > 0.0 else math.inf for off in (-lowest_rad, highest_rad))
        towards_rad, half_width_rad = (leftmost_rad + rightmost_rad) / 2.0, (leftmost_rad - rightmost_rad) / 2.0
        return cls(down, up, towards_rad, half_width_rad, reach_m, dense_m)

    def seen_m(self, h_m: float, roof_m: float) -> tuple[float, float]:
        """Between which distances ground ahead counts as seen, floor and roof being so far below and above.

        Nearer they lie outside of the picture, and what is only passed beside or in a turn stays unseen: corners most
        of all. Under a roof that never comes into the picture the furthest half metre counts. Aside, at a bearing β,
        they come into the picture 1/cos β as far away: the picture is flat.

        Far off the rows of the picture meet the floor further and further apart, and the map has holes between them: at
        a distance x, with a focal length of f rows, x² / (f h).
        """
        from_m = max(h_m * self.down, roof_m * self.up)
        believed_m = math.sqrt(max(self.reach_m**2 - max(h_m, roof_m) ** 2, 0.0))
        closed_m = math.inf if math.isinf(self.dense_m) else math.sqrt(max(self.dense_m * h_m, 0.0))
        mapped_m = max(min(believed_m, closed_m), LEAST_LOOK_SHARE * self.reach_m)
        to_m = min(max(LOOK_M, from_m + LOOK_DEEP_M), mapped_m)
        return max(min(from_m, to_m - LAST_M), 0.0), to_m


UPRIGHT_57_DEG = Outlook.of(-math.radians(28.5), math.radians(28.5), -math.radians(43.0), math.radians(43.0), 6.0)
"""That of the camera of preset flight."""


@dataclass(frozen=True, slots=True)
class Place:
    """A point of the plan, and the height of the ground there."""

    x_m: float
    y_m: float
    ground_m: float

    @classmethod
    def under(cls, pose: Pose, h_m: float | None) -> Place:
        """The ground below a vehicle; where h is not known, or is no number, as if it flew at its own height."""
        z_m, h_m = (value if value is not None and abs(value) < ABSURD else 0.0 for value in (pose.z_m, h_m))
        return cls(pose.x_m, pose.y_m, z_m - h_m)

    def bearing_rad(self, pose: Pose) -> float:
        """Bearing from a vehicle."""
        return wrap_rad(math.atan2(self.y_m - pose.y_m, self.x_m - pose.x_m) - pose.yaw_rad)

    @property
    def ground_dm(self) -> int:
        """The height as the grid has it."""
        return round(10.0 * min(max(self.ground_m, -HIGHEST_M), HIGHEST_M))


NOWHERE: NDArray[np.int64] = np.empty((0, 3), np.int64)
"""No cell."""


@dataclass(frozen=True, slots=True)
class Window:
    """A part of the grid.

    Attributes:
        grid: of it.
        blocked: (k, 3) rows, columns and heights in dm through which no way leads, whatever is seen there.
        x_m, y_m: of its low corner.
        cell_m: side of a cell.
        flown: (k, 3) levels, rows and columns that were flown through, where there is room whatever is seen there.
    """

    grid: GroundGrid
    blocked: NDArray[np.int64]
    x_m: float
    y_m: float
    cell_m: float
    flown: NDArray[np.int64] = field(default_factory=lambda: NOWHERE)

    def cell(self, place: Place) -> tuple[int, int]:
        """Row and column of a point."""
        return math.floor((place.y_m - self.y_m) / self.cell_m), math.floor((place.x_m - self.x_m) / self.cell_m)

    @property
    def free_m2(self) -> float:
        """Area of what was seen to be free, in m²; of what lies above each other each."""
        return float(np.count_nonzero(self.grid.cells == FREE)) * self.cell_m**2

    def middle(self, level: int, row: int, column: int) -> Place:
        """The point in the middle of a cell."""
        x_m, y_m = self.x_m + (column + 0.5) * self.cell_m, self.y_m + (row + 0.5) * self.cell_m
        return Place(x_m, y_m, float(self.grid.ground_dm[level, row, column]) / 10.0)


class KnownGround:
    """A grid of unseen, free and wall cells about the place where the flight began, by levels.

    Args:
        outlook: what the camera sees of floor and roof.
        cell_m: side of a cell.
    """

    def __init__(self, outlook: Outlook = UPRIGHT_57_DEG, cell_m: float = CELL_M) -> None:
        self._outlook = outlook
        self.cell_m = cell_m
        """Side of a cell."""
        self._grid = GroundGrid.unseen(FIRST_CELLS, FIRST_CELLS)
        self._origin: tuple[float, float] | None = None
        self._blocked: deque[Place] = deque(maxlen=MOST_BLOCKED)
        self._flown: list[Place] = []

    def go_on_from(self, earlier: Window) -> None:
        """Know what earlier flights have seen, in the same coordinates; called before the first look.

        What they gave up, and what was blocked for them, may be tried again. A wall of theirs is believed as after one
        look: a vehicle that was put back by hand stands a little beside, and sees it elsewhere.

        Raises:
            ValueError: its cells are of another size, or too many; nothing is known then, as before.
        """
        if not math.isclose(earlier.cell_m, self.cell_m, rel_tol=1e-6):
            raise ValueError(f"its cells are {earlier.cell_m:g} m wide, those of this flight {self.cell_m:g} m")
        levels, rows, columns = earlier.grid.cells.shape
        side = FIRST_CELLS
        while side < max(rows, columns):
            side *= 2
        if side > MOST_CELLS:
            raise ValueError(f"it has {rows} x {columns} cells, of which {MOST_CELLS} to a side are the most")
        if not earlier.grid.cells.any():
            return
        low, left = (side - rows) // 2, (side - columns) // 2
        self._grid = GroundGrid.unseen(side, side, levels)
        known = self._grid.part(slice(low, low + rows), slice(left, left + columns))
        known.cells[:], known.ground_dm[:] = earlier.grid.cells, earlier.grid.ground_dm
        known.belief[:] = np.minimum(earlier.grid.belief, HIT_WEIGHT)
        self._origin = (earlier.x_m - left * self.cell_m, earlier.y_m - low * self.cell_m)
        self.take_up_again()

    def fly(self, place: Place) -> None:
        """The vehicle has flown here: there is room, whatever is seen of it later."""
        last = self._flown[-1] if self._flown else None
        is_step = last is None or math.hypot(place.x_m - last.x_m, place.y_m - last.y_m) >= FLOWN_M
        if is_step and len(self._flown) < MOST_FLOWN:
            self._flown.append(place)

    def see(self, measurement: Measurement, pose: Pose) -> None:
        """Enter what is in view: free along each bearing, a wall where it is HIT, at the height of the ground there.

        Without a height of the vehicle that is a number nothing is entered: nobody knows on which level it would be.
        """
        scan = measurement.scan
        if scan is None or not abs(pose.z_m) < ABSURD:
            return
        if self._origin is None:
            half_m = FIRST_CELLS * self.cell_m / 2.0
            self._origin = (pose.x_m - half_m, pose.y_m - half_m)
        while not self._holds(pose) and self._grow():
            pass
        below = Place.under(pose, measurement.h_m)
        # A height that is not known is taken for that of the other one.
        h_m = _first(measurement.h_m, measurement.roof_m)
        from_m, to_m = self._outlook.seen_m(h_m, _first(measurement.roof_m, h_m))
        had_room = _see(
            self._grid,
            (pose.x_m - self._origin[0]) / self.cell_m,
            (pose.y_m - self._origin[1]) / self.cell_m,
            pose.yaw_rad,
            scan,
            from_m,
            to_m,
            self._outlook.towards_rad,
            self._outlook.half_width_rad,
            below.ground_dm,
            measurement.ground_slope or 0.0,
            self.cell_m,
        )
        if not had_room and len(self._grid.cells) < MOST_LEVELS:
            # What had no room is entered with the next look.
            self._grid = self._grid.with_level()

    def learn(self, theirs: Window, at_m: tuple[float, float, float], turn_rad: float) -> None:
        """Know what another vehicle has seen, where this one knows nothing itself; before its first look it does not.

        A wall that was seen once here gives way to ground that is free there, as to another look.

        Args:
            theirs: in the other vehicle's frame.
            at_m: where the origin of this vehicle's frame is in that.
            turn_rad: by how much this vehicle's x axis is turned to the left from the other's.
        """
        if self._origin is None:
            return
        self._grid = with_heard(
            Sheet(self._grid, *self._origin, self.cell_m),
            Sheet(theirs.grid, theirs.x_m, theirs.y_m, theirs.cell_m),
            at_m,
            turn_rad,
        )

    def window(self, x_m: float, y_m: float) -> Window | None:
        """A copy of the part about a place in which ways are searched; None before anything has been seen."""
        if self._origin is None:
            return None
        side = self._side
        size = min(side, SEARCH_CELLS)
        column, row = self._cell(x_m, y_m)
        left = min(max(column - size // 2, 0), side - size)
        low = min(max(row - size // 2, 0), side - size)
        return self._part(slice(low, low + size), slice(left, left + size), 1)

    def whole(self) -> Window | None:
        """A copy of all that is known, and a little around it; None before anything has been seen."""
        return None if self._origin is None or not self._grid.cells.any() else self._known(BORDER_CELLS)

    def with_way_flown(self) -> Window | None:
        """A copy of all that is known, in which the way that was flown is free; None before anything has been seen."""
        window = self.whole()
        if window is None or not self._flown:
            return window
        cells = np.array([(*window.cell(place), place.ground_dm) for place in self._flown], np.int64)
        while True:
            flown, had_room = _open(window.grid, cells)
            if had_room or len(window.grid.cells) >= MOST_LEVELS:
                return replace(window, flown=flown)
            window = replace(window, grid=window.grid.with_level())

    def seen(self) -> Window:
        """A copy of all that has been seen, as far as it goes: without rows and columns before anything has been."""
        if self._origin is None or not self._grid.cells.any():
            return Window(GroundGrid.unseen(0, 0), NOWHERE, 0.0, 0.0, self.cell_m)
        return self._known(0)

    def _known(self, around: int) -> Window:
        """What is known and so many cells around it."""
        rows, columns = (np.flatnonzero(self._grid.cells.any(axis=axes)) for axes in ((0, 2), (0, 1)))
        along_y, along_x = (slice(int(max(at[0] - around, 0)), int(at[-1]) + 1 + around) for at in (rows, columns))
        return self._part(along_y, along_x, min(around, 1))

    def _part(self, rows: slice, columns: slice, border: int) -> Window:
        """A copy of a part of the grid, with what is blocked in it, so many cells from its border at least."""
        assert self._origin is not None  # noqa: S101 - set by the first look
        low_x_m, low_y_m = self._origin[0] + columns.start * self.cell_m, self._origin[1] + rows.start * self.cell_m
        part = self._grid.part(rows, columns).copy()
        return self._with_blocked(Window(part, NOWHERE, low_x_m, low_y_m, self.cell_m), border)

    def block(self, place: Place) -> None:
        """No way leads through the cells about this place any more."""
        self._blocked.append(place)

    def give_up(self, place: Place, radius_m: float) -> None:
        """What is unseen about that place attracts nobody any more; if it is seen after all, it is free."""
        if self._origin is None:
            return
        column, row = self._cell(place.x_m, place.y_m)
        _give_up(self._grid, row, column, math.ceil(radius_m / self.cell_m), place.ground_dm)

    def take_up_again(self) -> None:
        """What was given up attracts again, and what was blocked may be tried again."""
        self._grid.cells[self._grid.cells == GIVEN_UP] = UNSEEN
        self.unblock()

    def unblock(self) -> None:
        """What was blocked may be tried again."""
        self._blocked.clear()

    def _with_blocked(self, window: Window, border: int) -> Window:
        """The same with what is blocked in it, so many cells from its border at least."""
        blocked = np.array([(*window.cell(place), place.ground_dm) for place in self._blocked], np.int64).reshape(-1, 3)
        most = np.array(window.grid.cells.shape[1:]) - border
        inside = np.all((blocked[:, :2] >= border) & (blocked[:, :2] < most), axis=1)
        return replace(window, blocked=blocked[inside])

    @property
    def _side(self) -> int:
        return int(self._grid.cells.shape[1])

    def _cell(self, x_m: float, y_m: float) -> tuple[int, int]:
        """Column and row of a point."""
        assert self._origin is not None  # noqa: S101 - set by the first look
        return math.floor((x_m - self._origin[0]) / self.cell_m), math.floor((y_m - self._origin[1]) / self.cell_m)

    def _holds(self, pose: Pose) -> bool:
        assert self._origin is not None  # noqa: S101 - set by the first look
        side_m = self._side * self.cell_m
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
        self._origin = (self._origin[0] - side / 2 * self.cell_m, self._origin[1] - side / 2 * self.cell_m)
        return True


def _first(*heights_m: float | None) -> float:
    """The first that is known and can be a height; 0 when none is."""
    return next((height_m for height_m in heights_m if height_m is not None and abs(height_m) < ABSURD), 0.0)


@compiled
def _open(grid: GroundGrid, cells: NDArray[np.int64]) -> tuple[NDArray[np.int64], bool]:
    """Cells of a way (n, 3), rows, columns and heights in dm, are free, with one beside two that touch at a corner.

    Returns:
        (k, 3) their levels, rows and columns; and whether the grid had a level for all of them.
    """
    _, rows, columns = grid.cells.shape
    opened = np.empty((2 * cells.shape[0], 3), np.int64)
    size, had_room = 0, True
    for k in range(cells.shape[0]):
        for corner in range(2):
            row, column = cells[k, 0], cells[k, 1]
            if corner == 0:
                # Of two that touch at a corner one beside them both.
                if k == 0 or row == cells[k - 1, 0] or column == cells[k - 1, 1]:
                    continue
                row = cells[k - 1, 0]
            if not (1 < row < rows - 2 and 1 < column < columns - 2):
                continue
            level = level_at(grid, row, column, cells[k, 2])
            if level < 0:
                had_room &= enter(grid, row, column, cells[k, 2], FREE)
                level = level_at(grid, row, column, cells[k, 2])
            if level >= 0:
                grid.cells[level, row, column] = FREE
                # Seen from afar down a steep ramp it lay too high, and the next cell of the way on another level.
                grid.ground_dm[level, row, column] = cells[k, 2]
                opened[size, 0], opened[size, 1], opened[size, 2] = level, row, column
                size += 1
    return opened[:size], had_room


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
    towards_rad: float,
    half_width_rad: float,
    ground_dm: int,
    slope: float,
    cell_m: float,
) -> bool:
    """Enter a scan made at a place that is given in cells, above ground that rises ahead by the slope.

    Returns:
        whether the grid had a level for all of it.
    """
    look_from, look, last = seen_from_m / cell_m, seen_to_m / cell_m, LAST_M / cell_m
    side = grid.cells.shape[1]
    had_room = True
    for i in range(scan.bearings_rad.size):
        if scan.state[i] == UNKNOWN or not scan.fresh[i]:
            continue
        wall, range_cells = scan.state[i] == HIT, scan.ranges_m[i] / cell_m
        dx = np.cos(yaw_rad + scan.bearings_rad[i])
        dy = np.sin(yaw_rad + scan.bearings_rad[i])
        rise_dm = 10.0 * cell_m * slope * np.cos(scan.bearings_rad[i])
        # Free up to half a cell before the obstacle, so that the cell of a wall does not become free at a slant.
        free = min(range_cells - 0.5, look) if wall else min(range_cells, look)
        aside_rad = abs((scan.bearings_rad[i] - towards_rad + np.pi) % (2.0 * np.pi) - np.pi)
        distance = min(look_from / np.cos(aside_rad), look - last) if aside_rad <= half_width_rad else np.inf
        while distance <= free:
            column, row = int(np.floor(x + distance * dx)), int(np.floor(y + distance * dy))
            if 0 <= row < side and 0 <= column < side:
                had_room &= enter(grid, row, column, int(ground_dm + distance * rise_dm), FREE)
            distance += 0.5
        behind = DOUBTED_M / cell_m
        distance = 0.5
        while distance <= min(range_cells, look) - behind:
            column, row = int(np.floor(x + distance * dx)), int(np.floor(y + distance * dy))
            if 0 <= row < side and 0 <= column < side:
                doubt(grid, row, column, int(ground_dm + distance * rise_dm))
            distance += 1.0
        if wall and range_cells <= look:
            column, row = int(np.floor(x + range_cells * dx)), int(np.floor(y + range_cells * dy))
            if 0 <= row < side and 0 <= column < side:
                had_room &= enter(grid, row, column, int(ground_dm + range_cells * rise_dm), WALL)
    return had_room
