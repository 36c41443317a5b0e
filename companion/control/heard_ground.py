"""What another vehicle has seen of the ground, entered where nothing is known of it. Pure."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

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
    enter,
    level_at,
)


class Sheet(NamedTuple):
    """A grid, and where it lies in the frame of its vehicle.

    Attributes:
        grid: of cells.
        x_m: of its low corner; so is the next.
        y_m: see ``x_m``.
        cell_m: side of a cell.
    """

    grid: GroundGrid
    x_m: float
    y_m: float
    cell_m: float


def with_heard(own: Sheet, theirs: Sheet, at_m: tuple[float, float, float], turn_rad: float) -> GroundGrid:
    """The own grid, in which what another vehicle has seen is entered; with more levels where it needs them.

    A wall that was seen once here gives way to ground that is free there, as to another look.

    Args:
        own: is written to.
        theirs: in the other vehicle's frame.
        at_m: where the origin of this vehicle's frame is in that.
        turn_rad: by how much this vehicle's x axis is turned to the left from the other's.
    """
    while not _enter_all(own, theirs, at_m, turn_rad) and len(own.grid.cells) < MOST_LEVELS:
        own = own._replace(grid=own.grid.with_level())
    return own.grid


@compiled
def _enter_all(
    own: Sheet,
    other: Sheet,
    at_m: tuple[float, float, float],
    turn_rad: float,
) -> bool:
    """Each cell whose middle is in a known cell of theirs becomes what that is, if nothing was known of it.

    Returns:
        whether the grid had a level for all of it.
    """
    grid, low_x_m, low_y_m, cell_m = own
    theirs, their_x_m, their_y_m, their_cell_m = other
    levels, rows, columns = theirs.cells.shape
    side_rows, side_columns = grid.cells.shape[1], grid.cells.shape[2]
    cos, sin = np.cos(turn_rad), np.sin(turn_rad)
    up_dm = int(np.round(10.0 * at_m[2]))
    # The circle about theirs, in cells of the own grid.
    half_x, half_y = columns * their_cell_m / 2.0, rows * their_cell_m / 2.0
    off_x, off_y = their_x_m + half_x - at_m[0], their_y_m + half_y - at_m[1]
    middle_x = (cos * off_x + sin * off_y - low_x_m) / cell_m
    middle_y = (cos * off_y - sin * off_x - low_y_m) / cell_m
    radius = np.sqrt(half_x * half_x + half_y * half_y) / cell_m + 1.0
    had_room = True
    for r in range(max(int(middle_y - radius), 0), min(int(middle_y + radius) + 1, side_rows)):
        for c in range(max(int(middle_x - radius), 0), min(int(middle_x + radius) + 1, side_columns)):
            x, y = low_x_m + (c + 0.5) * cell_m, low_y_m + (r + 0.5) * cell_m
            column = int(np.floor((at_m[0] + cos * x - sin * y - their_x_m) / their_cell_m))
            row = int(np.floor((at_m[1] + sin * x + cos * y - their_y_m) / their_cell_m))
            if not (0 <= row < rows and 0 <= column < columns):
                continue
            for level in range(levels):
                what = theirs.cells[level, row, column]
                if what == UNSEEN or what > GIVEN_UP:
                    continue
                ground_dm = int(theirs.ground_dm[level, row, column]) - up_dm
                if abs(ground_dm) > 10.0 * HIGHEST_M:
                    continue
                at = level_at(grid, r, c, ground_dm)
                if at < 0:
                    had_room &= enter(grid, r, c, ground_dm, what)
                elif what == FREE and grid.cells[at, r, c] == WALL and grid.belief[at, r, c] <= HIT_WEIGHT:
                    grid.cells[at, r, c] = FREE
                elif what != GIVEN_UP and grid.cells[at, r, c] == GIVEN_UP:
                    grid.cells[at, r, c] = what
    return had_room
