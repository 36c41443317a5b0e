"""Whether a place is one where the vehicle was before, though its position drifts. Pure."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator

from companion.control.ground_grid import LEVEL_DM

SAME_M = 1.5
"""Two passes at one tangent point lie so near to each other without drift: a tangent is drawn for a metre sooner or
later, as the scan shows its edge. Boundaries with the wall on the same side are 2·d_s and some rock apart."""

DRIFT_SHARE = 0.01
"""A position drifts by so much of the way flown: visual and lidar odometry underground by half of it to all of it."""

MOST_M = 3.0
"""Further apart two places are never one, however long the way: the next drift, or the next corner, may be there."""

LEVEL_M = LEVEL_DM / 10.0
"""Grounds that differ by more are two levels, as in the known ground."""


def tolerance_m(way_m: float) -> float:
    """How far a place may be off when the vehicle comes back to it, with a way of ``way_m`` flown since."""
    return min(SAME_M + DRIFT_SHARE * way_m, MOST_M)


def moved_m(off_m: float) -> float:
    """By how much a place that is met ``off_m`` beside where it was has moved with the drift.

    What `SAME_M` explains does not move it, or a place would be carried along a wall from pass to pass.
    """
    return max(0.0, off_m - SAME_M)


class Places:
    """Numbered points of the plan, found by where they are, in a time that does not grow with their number."""

    def __init__(self) -> None:
        self._cells: defaultdict[tuple[int, int], list[int]] = defaultdict(list)

    def add(self, number: int, x_m: float, y_m: float) -> None:
        """Note where a point is."""
        self._cells[_cell(x_m, y_m)].append(number)

    def move(self, number: int, from_m: tuple[float, float], to_m: tuple[float, float]) -> None:
        """Note that a point is elsewhere now."""
        self._cells[_cell(*from_m)].remove(number)
        self.add(number, *to_m)

    def near(self, x_m: float, y_m: float) -> Iterator[int]:
        """The points that may lie within `MOST_M` of a place; all that do are among them."""
        row, column = _cell(x_m, y_m)
        for r in range(row - 1, row + 2):
            for c in range(column - 1, column + 2):
                yield from self._cells.get((r, c), ())


def _cell(x_m: float, y_m: float) -> tuple[int, int]:
    return math.floor(x_m / MOST_M), math.floor(y_m / MOST_M)
