"""How far a look is off another one of the same place: correlative matching of walls in the plan. Pure."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled

CELL_M = 0.05
"""Side of the cells in which walls are compared."""

NEAR_CELLS = 4
"""A wall is the same up to so many cells away, the less the further."""

COARSE_M, FINE_M = 0.2, 0.05
COARSE_RAD, FINE_RAD = math.radians(2.0), math.radians(0.5)

COARSE_POINTS = 80
"""About so many points of walls, evenly chosen, are enough to find the place roughly: thousands are tried."""

FAR_SHARE, PER_RAD = 0.1, 0.1
"""What a look must agree better by to be moved as far as it may be off, and for each radian: along a smooth drift
nothing says how far, and then it stays."""

ROUND_M, ROUND = 0.4, 24
"""A place is told by its walls when they agree less so far to any side of it, of so many, and anywhere further off."""

Points = NDArray[np.float64]


class Match(NamedTuple):
    """How a look lies on what it was compared with.

    Attributes:
        x_m, y_m: by how much it is to be moved.
        turn_rad: by how much it is to be turned, about where it was made.
        share: of its walls that lie on walls then, from 0 to 1.
        better_by: as much less of them does `ROUND_M` beside, or further off within the reach: 0 along a smooth drift.
        beside_rad: the side to which it agrees best `ROUND_M` beside: along that drift.
    """

    x_m: float
    y_m: float
    turn_rad: float
    share: float
    better_by: float
    beside_rad: float

    def across(self) -> Match:
        """The same without what it is moved along the drift, of which its walls say nothing."""
        along_x, along_y = math.cos(self.beside_rad), math.sin(self.beside_rad)
        along_m = self.x_m * along_x + self.y_m * along_y
        return self._replace(x_m=self.x_m - along_m * along_x, y_m=self.y_m - along_m * along_y)


def match(look_m: Points, at_m: tuple[float, float], known_m: Points, reach_m: float, reach_rad: float) -> Match:
    """Where walls lie best on known ones.

    Args:
        look_m: (n, 2) walls of the look, n > 0.
        at_m: where it was made, by its own account.
        known_m: (m, 2) walls that are known, m > 0.
        reach_m: as far as it may be off.
        reach_rad: as far as its heading may be off.
    """
    low = np.minimum(look_m.min(axis=0), known_m.min(axis=0)) - reach_m - 1.0
    high = np.maximum(look_m.max(axis=0), known_m.max(axis=0)) + reach_m + 1.0
    columns, rows = (int(size) for size in np.ceil((high - low) / CELL_M))
    likeness = _likeness(known_m - low, rows, columns)
    about, centre = look_m - np.asarray(at_m), np.asarray(at_m) - low
    per_m = FAR_SHARE / reach_m
    some = np.ascontiguousarray(about[:: max(1, len(about) // COARSE_POINTS)])
    rough = _best(likeness, some, centre, (0.0, 0.0, 0.0), (reach_m, COARSE_M), (reach_rad, COARSE_RAD), per_m)
    x_m, y_m, turn_rad, share = _best(
        likeness, about, centre, rough[:3], (COARSE_M, FINE_M), (COARSE_RAD, FINE_RAD), per_m
    )
    beside, beside_rad = _beside(likeness, about, centre, (x_m, y_m, turn_rad), reach_m)
    return Match(*(float(value) for value in (x_m, y_m, turn_rad, share, share - beside, beside_rad)))


@compiled
def _likeness(known_m: Points, rows: int, columns: int) -> NDArray[np.uint8]:
    """(rows, columns) from 0 to `NEAR_CELLS` + 1: how near a wall is."""
    likeness = np.zeros((rows, columns), np.uint8)
    for k in range(known_m.shape[0]):
        row, column = int(known_m[k, 1] / CELL_M), int(known_m[k, 0] / CELL_M)
        for r in range(max(row - NEAR_CELLS, 0), min(row + NEAR_CELLS + 1, rows)):
            for c in range(max(column - NEAR_CELLS, 0), min(column + NEAR_CELLS + 1, columns)):
                near = np.uint8(NEAR_CELLS + 1 - max(abs(r - row), abs(c - column)))
                likeness[r, c] = max(likeness[r, c], near)
    return likeness


@compiled
def _share(likeness: NDArray[np.uint8], x: NDArray[np.float64], y: NDArray[np.float64]) -> float:
    """How well points in cells lie on walls, from 0 to 1."""
    rows, columns = likeness.shape
    total = 0
    for n in range(x.size):
        row, column = int(y[n]), int(x[n])
        if 0 <= row < rows and 0 <= column < columns:
            total += likeness[row, column]
    return total / ((NEAR_CELLS + 1.0) * x.size)


@compiled
def _beside(
    likeness: NDArray[np.uint8],
    about_m: Points,
    centre_m: NDArray[np.float64],
    at: tuple[float, float, float],
    reach_m: float,
) -> tuple[float, float]:
    """The best share beside a place, of `ROUND` sides, and to which side it is the best `ROUND_M` beside.

    Further off in steps of `ROUND_M`, within the reach: what is moved far in a smooth drift agrees a little better than
    close by for no reason but noise, and somewhere else as well as there.
    """
    cos, sin = np.cos(at[2]), np.sin(at[2])
    x = (centre_m[0] + at[0] + cos * about_m[:, 0] - sin * about_m[:, 1]) / CELL_M
    y = (centre_m[1] + at[1] + sin * about_m[:, 0] + cos * about_m[:, 1]) / CELL_M
    best, nearest, side_rad = -1.0, -1.0, 0.0
    for ring in range(1, int(2.0 * reach_m / ROUND_M) + 2):
        for k in range(ROUND):
            angle_rad = 2.0 * np.pi * k / ROUND
            x_m, y_m = ring * ROUND_M * np.cos(angle_rad), ring * ROUND_M * np.sin(angle_rad)
            if ring > 1 and np.hypot(at[0] + x_m, at[1] + y_m) > reach_m:
                continue
            share = _share(likeness, x + x_m / CELL_M, y + y_m / CELL_M)
            best = max(best, share)
            if ring == 1 and share > nearest:
                nearest, side_rad = share, angle_rad
    return best, side_rad


@compiled
def _best(
    likeness: NDArray[np.uint8],
    about_m: Points,
    centre_m: NDArray[np.float64],
    first: tuple[float, float, float],
    shift: tuple[float, float],
    turn: tuple[float, float],
    per_m: float,
) -> tuple[float, float, float, float]:
    """Shift (x, y) and turn of the best likeness, and that: of all within a reach, in steps, (reach, step) each."""
    shifts, turns = int(np.ceil(shift[0] / shift[1])), int(np.ceil(turn[0] / turn[1]))
    best, best_share = -np.inf, 0.0
    found = (first[0], first[1], first[2])
    for k in range(-turns, turns + 1):
        turn_rad = first[2] + k * turn[1]
        cos, sin = np.cos(turn_rad), np.sin(turn_rad)
        x = (centre_m[0] + cos * about_m[:, 0] - sin * about_m[:, 1]) / CELL_M
        y = (centre_m[1] + sin * about_m[:, 0] + cos * about_m[:, 1]) / CELL_M
        for i in range(-shifts, shifts + 1):
            for j in range(-shifts, shifts + 1):
                x_m, y_m = first[0] + i * shift[1], first[1] + j * shift[1]
                if x_m * x_m + y_m * y_m > (shift[0] + np.hypot(first[0], first[1])) ** 2:
                    continue
                share = _share(likeness, x + x_m / CELL_M, y + y_m / CELL_M)
                worth = share - per_m * np.hypot(x_m, y_m) - PER_RAD * abs(turn_rad)
                if worth > best:
                    best, best_share, found = worth, share, (x_m, y_m, turn_rad)
    return found[0], found[1], found[2], best_share
