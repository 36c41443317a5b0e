"""What is left on known ground: whether a way leads to something unseen, and what was left out and why. Pure."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from companion.control.ground_grid import GIVEN_UP, LEVEL_DM, UNSEEN
from companion.control.informed import frontier_cells, ways_within
from companion.control.known_ground import SEARCH_CELLS, KnownGround, Place, Window
from companion.control.left_out import LeftOut, Why, pieces
from companion.model import FloatArray

MOST_SEARCHED_CELLS = 1024
"""Side of known ground, 512 m, that is searched as a whole, once near ways have run out: hundredths of a second."""

MOST_PIECES = 64
"""So many frontiers are asked for the way to them, the largest first: one or two searches each."""

_LEVEL_M = LEVEL_DM / 10.0


def is_way_left(ground: KnownGround, place: Place) -> bool | None:
    """Whether a way leads from a place to something unseen; None where that is not known.

    It is searched about the place, as the law does, and then in all that is known. A chink is nothing that is left:
    those that the law looks into at the end held 0.1 to 0.5 % of a mine, and took it half a minute or two. Neither is
    what was given up or blocked: `left_out` tells of it.
    """
    near = ground.window(place.x_m, place.y_m)
    if near is None:
        return None
    if _leads(near, place, frontier_cells(near)):
        return True
    whole = ground.whole()
    if whole is None or max(whole.grid.cells.shape) <= SEARCH_CELLS:
        return False
    if max(whole.grid.cells.shape) > MOST_SEARCHED_CELLS:
        return None
    return _leads(whole, place, frontier_cells(whole))


def left_out(ground: KnownGround, place: Place) -> Iterator[LeftOut]:
    """What the vehicle has seen the beginning of and not looked into, for a vehicle that is at a place.

    A frontier that a way leads to was not reached; one that it would lead to, had the scan confirmed its straights, is
    blocked; for any other there is no room. What was given up is told as that where free ground is beside it.
    """
    window = ground.whole()
    if window is None or max(window.grid.cells.shape) > MOST_SEARCHED_CELLS:
        return
    unblocked = replace(window, blocked=window.blocked[:0])
    frontier = frontier_cells(window)
    for cells in _pieces(window, frontier):
        goals = np.zeros_like(frontier)
        goals[tuple(cells.T)] = True
        if _leads(window, place, goals):
            why = Why.NOT_REACHED
        else:
            why = Why.BLOCKED if _leads(unblocked, place, goals) else Why.TOO_NARROW
        yield LeftOut.over(_points_m(window, cells), window.cell_m, why)
    for cells in _pieces(window, frontier_cells(_taken_up_again(window)) & ~frontier):
        yield LeftOut.over(_points_m(window, cells), window.cell_m, Why.GIVEN_UP)


def _leads(window: Window, place: Place, goals: NDArray[np.bool_]) -> bool:
    return ways_within(window, place, goals).way(place, 0.0, 0.0) is not None


def _taken_up_again(window: Window) -> Window:
    cells = window.grid.cells
    return replace(window, grid=window.grid._replace(cells=np.where(cells == GIVEN_UP, UNSEEN, cells)))


def _pieces(window: Window, chosen: NDArray[np.bool_]) -> list[NDArray[np.int64]]:
    """Levels, rows and columns of the chosen cells, those that belong together in one (n, 3); the largest first."""
    cells = np.argwhere(chosen)
    parts = pieces(_points_m(window, cells), window.cell_m, _LEVEL_M)
    return sorted((cells[part] for part in parts), key=len, reverse=True)[:MOST_PIECES]


def _points_m(window: Window, cells: NDArray[np.int64]) -> FloatArray:
    """(n, 3) middles of cells, at the height of their ground."""
    levels, rows, columns = cells.T
    x_m, y_m = window.x_m + (columns + 0.5) * window.cell_m, window.y_m + (rows + 0.5) * window.cell_m
    return np.stack([x_m, y_m, window.grid.ground_dm[levels, rows, columns] / 10.0], axis=1)
