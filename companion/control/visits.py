"""Where the vehicle has been and when: what makes the choice at a tangent better than a fixed coin.

The theorem of the paper needs that both outcomes of every draw stay possible, not that the coin is fixed: whatever
chooses must keep each probability within [p_min, 1 - p_min]. Preferring the way that was flown longest ago, or never,
visits every part of a network of drifts far sooner than a random walk on it.
"""

from __future__ import annotations

import math
from collections import OrderedDict

CELL_M = 1.5
"""Size of a cell: a drift is two or three cells wide, so both of its walls have cells of their own."""

MOST_CELLS = 40_000
"""Cells remembered at most, the oldest forgotten first: 30 km of flight in fresh ground."""


class Visits:
    """Time of the last visit by cell of the horizontal plane."""

    def __init__(self) -> None:
        self._last_s: OrderedDict[tuple[int, int], float] = OrderedDict()

    def visit(self, x_m: float, y_m: float, t_s: float) -> None:
        """The vehicle is here now."""
        cell = (math.floor(x_m / CELL_M), math.floor(y_m / CELL_M))
        self._last_s[cell] = t_s
        self._last_s.move_to_end(cell)
        if len(self._last_s) > MOST_CELLS:
            self._last_s.popitem(last=False)

    def last_s(self, x_m: float, y_m: float) -> float:
        """When this place was last visited: the newest of the cell and its eight neighbours, -inf when never."""
        column, row = math.floor(x_m / CELL_M), math.floor(y_m / CELL_M)
        return max(
            self._last_s.get((column + i, row + j), -math.inf) for i in (-1, 0, 1) for j in (-1, 0, 1)
        )
