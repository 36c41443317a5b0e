"""The cells of the known ground, by levels: what lies above each other in a mine is not one place. Pure.

A cell of the plan holds as many grounds as were met in it, each with its height. Which of them is meant is said by a
height: from a neighbour's ground, or from the vehicle's, it is the one that is nearest to it, and no further than a
ramp, a step or a drift of the estimate could be off. So a way leads over a ramp from level to level, and not through
the rock between a drift and the one below it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled

LEVEL_DM = 15
"""Grounds of one cell that differ by more, in dm, are two levels. A drift has 2 m at least and rock above it; along 5 m
of a ramp the height is known to less than that."""

MOST_LEVELS = 8
"""So many grounds above each other; of one more nothing is kept, as of what was never seen."""

HIT_WEIGHT, MOST_WEIGHT = 3, 30
"""A wall is believed by so much for each ray that ends in it, at most so far, and by one less for each that is seen to
go on behind it: a bump of the roof in a nod of the vehicle would close a drift for ever."""

HIGHEST_M = 3000.0
"""Above and below the origin of the flight: heights are kept as 16 bits of decimetres."""

UNSEEN, FREE, WALL, GIVEN_UP = np.uint8(0), np.uint8(1), np.uint8(2), np.uint8(3)
"""What is known of a cell; what could not be seen from where it was looked for is given up."""


class GroundGrid(NamedTuple):
    """Cells, rows along y, columns along x.

    Attributes:
        cells: (levels, rows, columns) what is known.
        ground_dm: (levels, rows, columns) height of the ground there, in dm; nothing where the cell is unseen.
        belief: (levels, rows, columns) how well a wall is believed.
    """

    cells: NDArray[np.uint8]
    ground_dm: NDArray[np.int16]
    belief: NDArray[np.int8]

    @classmethod
    def unseen(cls, rows: int, columns: int, levels: int = 1) -> GroundGrid:
        """A grid of which nothing is known."""
        shape = (levels, rows, columns)
        return cls(np.zeros(shape, np.uint8), np.zeros(shape, np.int16), np.zeros(shape, np.int8))

    def with_level(self) -> GroundGrid:
        """The same with room for one more level."""
        above = self.unseen(*self.cells.shape[1:])
        return GroundGrid(
            np.concatenate([self.cells, above.cells]),
            np.concatenate([self.ground_dm, above.ground_dm]),
            np.concatenate([self.belief, above.belief]),
        )

    def part(self, rows: slice, columns: slice) -> GroundGrid:
        """A view of a part."""
        at = (slice(None), rows, columns)
        return GroundGrid(self.cells[at], self.ground_dm[at], self.belief[at])

    def grown(self) -> GroundGrid:
        """Twice as large about the same centre."""
        levels, rows, columns = self.cells.shape
        larger = self.unseen(2 * rows, 2 * columns, levels)
        middle = larger.part(slice(rows // 2, rows // 2 + rows), slice(columns // 2, columns // 2 + columns))
        middle.cells[:], middle.ground_dm[:], middle.belief[:] = self
        return larger

    def copy(self) -> GroundGrid:
        """The same, by itself."""
        return GroundGrid(self.cells.copy(), self.ground_dm.copy(), self.belief.copy())


@compiled
def level_at(grid: GroundGrid, row: int, column: int, ground_dm: int) -> int:
    """The level of a cell whose ground is nearest to a height; -1 where nothing is known at that height."""
    nearest, found = LEVEL_DM, -1
    for level in range(grid.cells.shape[0]):
        if grid.cells[level, row, column] != UNSEEN:
            off = abs(int(grid.ground_dm[level, row, column]) - ground_dm)
            if off < nearest or (off == LEVEL_DM and found < 0):
                nearest, found = off, level
    return found


@compiled
def step_to(grid: GroundGrid, level: int, row: int, column: int, to_row: int, to_column: int) -> int:
    """The level on which one comes from a known cell into its neighbour; -1 where nothing is known of it.

    Only where one comes back the same way: with three grounds within a step of each other it might not be so.
    """
    ground_dm = int(grid.ground_dm[level, row, column])
    to = level_at(grid, to_row, to_column, ground_dm)
    if to < 0 or level_at(grid, row, column, int(grid.ground_dm[to, to_row, to_column])) != level:
        return -1
    return to


@compiled
def enter(grid: GroundGrid, row: int, column: int, ground_dm: int, what: np.uint8) -> bool:
    """Enter what is seen of a cell: a wall stays one until `doubt` clears it, what is unseen or given up becomes it.

    Returns:
        whether there was a level for it.
    """
    level = level_at(grid, row, column, ground_dm)
    if level < 0:
        for free in range(grid.cells.shape[0]):
            if grid.cells[free, row, column] == UNSEEN:
                grid.cells[free, row, column] = what
                grid.ground_dm[free, row, column] = ground_dm
                grid.belief[free, row, column] = HIT_WEIGHT
                return True
        return False
    if what == WALL:
        before = grid.belief[level, row, column] if grid.cells[level, row, column] == WALL else 0
        grid.belief[level, row, column] = min(before + HIT_WEIGHT, MOST_WEIGHT)
        grid.cells[level, row, column] = WALL
    elif grid.cells[level, row, column] == GIVEN_UP:
        grid.cells[level, row, column] = what
    return True


@compiled
def doubt(grid: GroundGrid, row: int, column: int, ground_dm: int) -> None:
    """A ray goes on well behind a cell: a wall there is believed less, and in the end it is free."""
    level = level_at(grid, row, column, ground_dm)
    if level >= 0 and grid.cells[level, row, column] == WALL:
        grid.belief[level, row, column] -= 1
        if grid.belief[level, row, column] <= 0:
            grid.cells[level, row, column] = FREE


@compiled
def is_frontier(grid: GroundGrid, level: int, row: int, column: int) -> bool:
    """Whether a free cell is beside two unseen ones or more; not at the border of the grid.

    A chink between the points of a wall is no frontier: there a wall is beside the unseen.
    """
    ground_dm = int(grid.ground_dm[level, row, column])
    unseen = 0
    for r in range(row - 1, row + 2):
        for c in range(column - 1, column + 2):
            beside = level_at(grid, r, c, ground_dm)
            if beside < 0:
                unseen += 1
            elif grid.cells[beside, r, c] == WALL:
                return False
    return unseen >= 2
