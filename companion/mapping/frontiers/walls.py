"""Walls: which nodes are too near to one, and which unknown cells may be only its undecided surface."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled, inner
from companion.mapping.frontiers.plan import (
    AT_WALL,
    BLOCKED,
    CELLS,
    NONE,
    PROBE,
    TILE,
    Plan,
    Shape,
    cell_of,
    first_sheet,
    is_node,
    kind_of,
    measure,
    on_tile,
    room_for,
)
from companion.mapping.frontiers.state_grid import Grid
from companion.mapping.voxels.chunks import Integer
from companion.mapping.voxels.lookup import OCCUPIED, UNKNOWN


@compiled
def make_room_around(plan: Plan, touched: NDArray[np.bool_], rim: int) -> None:
    """Make the tiles into which unknown nodes of marked ones look for a wall, so that it is found there."""
    for first in range(plan.used[0]):
        sheet = int(first if touched[first] else -1)
        while sheet >= 0:
            for node in range(sheet * CELLS, (sheet + 1) * CELLS):
                if not (is_node(plan, node) and kind_of(plan, node) == UNKNOWN):
                    continue
                i, j = cell_of(plan, node)
                for a in (-rim, rim):
                    for b in (-rim, rim):
                        if first_sheet(plan, i + a, j + b) < 0:
                            room_for(plan, i + a, j + b)
            sheet = int(plan.others[sheet])


@compiled
def probe(
    grid: Grid, plan: Plan, s: Shape, tiles: NDArray[np.bool_], circle: NDArray[np.int64], unknown: NDArray[np.int32]
) -> None:
    """Look behind unknown cells for the wall to which they may belong: the plan gets it where it has no node.

    It is done for ``tiles`` (MOST_SHEETS,), by their first sheets, of which ``unknown`` (MOST_SHEETS,) says how many
    nodes are unknown; ``circle`` (n, 2) is the cells around one, near ones first.
    """
    used = plan.used[0]
    for first in range(used):
        if not tiles[first]:
            continue
        sheet = first
        while sheet >= 0:
            for place in range(CELLS):
                if plan.steps[sheet * CELLS + place] == PROBE:
                    plan.steps[sheet * CELLS + place] = NONE
            sheet = int(plan.others[sheet])
        i0, j0 = np.int64(plan.corners[first, 0]), np.int64(plan.corners[first, 1])
        some = 0
        for a in (-1, 0, 1):
            for b in (-1, 0, 1):
                other = first_sheet(plan, i0 + a * TILE, j0 + b * TILE)
                some += unknown[other] if other >= 0 else 0
        if some == 0:
            continue
        for place in range(CELLS):
            i, j = i0 + (place >> 4), j0 + (place & 15)
            for n in range(circle.shape[0]):
                a, b = i + circle[n, 0], j + circle[n, 1]
                its_place = on_tile(a, b)
                other = first_sheet(plan, a, b)
                while other >= 0:
                    its = other * CELLS + its_place
                    if is_node(plan, its) and kind_of(plan, its) == UNKNOWN:
                        _probe_cell(grid, plan, s, i, j, np.int64(plan.heights_mm[its]))
                    other = int(plan.others[other])


@inner
def _probe_cell(grid: Grid, plan: Plan, s: Shape, i: Integer, j: Integer, from_mm: Integer) -> None:
    sheet = first_sheet(plan, i, j)
    place = on_tile(i, j)
    while sheet >= 0:
        node = sheet * CELLS + place
        if plan.steps[node] != NONE and abs(plan.heights_mm[node] - from_mm) < s.level_mm:
            return
        sheet = int(plan.others[sheet])
    height_mm, kind = measure(grid, s, i, j, from_mm, False)
    if kind & 3 == OCCUPIED:
        node = room_for(plan, i, j)
        if node >= 0:
            plan.steps[node], plan.heights_mm[node], plan.kinds[node], plan.flags[node] = PROBE, height_mm, OCCUPIED, 0


@compiled
def mark_near(plan: Plan, s: Shape, tiles: NDArray[np.bool_], blocked_cells: float, wall_cells: float) -> None:
    """Mark the nodes nearer to an obstacle than ``blocked_cells``: `BLOCKED`, and than ``wall_cells``: `AT_WALL`.

    It is done for ``tiles`` (MOST_SHEETS,), by their first sheets.
    """
    rim = math.ceil(max(blocked_cells, wall_cells))
    ring = (rim + TILE - 1) // TILE
    for first in range(plan.used[0]):
        if not tiles[first]:
            continue
        sheet = first
        while sheet >= 0:
            for place in range(CELLS):
                plan.flags[sheet * CELLS + place] &= ~(BLOCKED | AT_WALL)
            sheet = int(plan.others[sheet])
        i0, j0 = np.int64(plan.corners[first, 0]), np.int64(plan.corners[first, 1])
        for a in range(-ring, ring + 1):
            for b in range(-ring, ring + 1):
                other = first_sheet(plan, i0 + a * TILE, j0 + b * TILE)
                while other >= 0:
                    for place in range(CELLS):
                        node = other * CELLS + place
                        if plan.steps[node] != NONE and kind_of(plan, node) == OCCUPIED:
                            i, j = a * TILE + (place >> 4), b * TILE + (place & 15)
                            height_mm = int(plan.heights_mm[node])
                            _mark_around(plan, s, first, i, j, height_mm, rim, blocked_cells**2, wall_cells**2)
                    other = int(plan.others[other])


@inner
def _mark_around(
    plan: Plan, s: Shape, first: Integer, i: int, j: int, height_mm: int, rim: int, blocked_2: float, wall_2: float
) -> None:
    """Mark what is on one tile near to an obstacle at (i, j), counted from the tile's corner."""
    for a in range(max(i - rim, 0), min(i + rim + 1, TILE)):
        for b in range(max(j - rim, 0), min(j + rim + 1, TILE)):
            apart = (a - i) ** 2 + (b - j) ** 2
            mark = (BLOCKED if apart < blocked_2 else np.uint8(0)) | (AT_WALL if apart < wall_2 else np.uint8(0))
            if mark:
                sheet = first
                while sheet >= 0:
                    node = sheet * CELLS + a * TILE + b
                    if plan.steps[node] != NONE and abs(plan.heights_mm[node] - height_mm) < s.level_mm:
                        plan.flags[node] |= mark
                    sheet = int(plan.others[sheet])
