"""Which cells of the plan are frontiers, which of them belong together, and what is reported of each frontier.

An unknown cell belongs to a frontier unless it may be the surface of a wall. That it can be seen through free cells
from where the vehicle can be is a mark of its own: only such frontiers count.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled, inner
from companion.mapping.frontiers.frontier import LEAST_FRONTIER_M, Access, Frontier
from companion.mapping.frontiers.plan import (
    AT_WALL,
    CELLS,
    FRONTIER,
    MARKED,
    Plan,
    Shape,
    cell_of,
    first_sheet,
    is_node,
    kind_of,
    nearest_node,
    on_tile,
)
from companion.mapping.frontiers.reachable import is_reached
from companion.mapping.frontiers.tiles import FRONTIER_CELLS
from companion.mapping.voxels.chunks import Integer
from companion.mapping.voxels.lookup import FREE, UNKNOWN
from companion.model import FloatArray

_BEARINGS = 64
"""Directions in which a frontier looks for a place from which it can be seen."""

_JOIN_CELLS = 2
"""Frontier cells this far apart still belong together: noise interrupts a line."""


@compiled
def mark_frontiers(
    plan: Plan, s: Shape, tiles: NDArray[np.bool_], was: NDArray[np.uint64], look_cells: int, counts: NDArray[np.int32]
) -> None:
    """Mark the unknown nodes that can be seen through free ones from where the vehicle can be.

    It is done for ``tiles`` (MOST_SHEETS,), by their first sheets; ``was`` is from `count_reached`, and ``look_cells``
    is how far a look says something. In ``counts`` (MOST_SHEETS, COUNTS) `FRONTIER_CELLS` is filled in: cells of a
    frontier, seen or not.
    """
    for first in range(plan.used[0]):
        if not tiles[first]:
            continue
        counts[first, FRONTIER_CELLS] = 0
        sheet = first
        while sheet >= 0:
            for node in range(sheet * CELLS, (sheet + 1) * CELLS):
                plan.flags[node] &= ~FRONTIER
                if is_node(plan, node) and kind_of(plan, node) == UNKNOWN and not plan.flags[node] & AT_WALL:
                    counts[first, FRONTIER_CELLS] += 1
                    if _is_seen(plan, s, node, was, look_cells):
                        plan.flags[node] |= FRONTIER
            sheet = int(plan.others[sheet])


@inner
def _is_seen(plan: Plan, s: Shape, node: Integer, was: NDArray[np.uint64], look_cells: int) -> bool:
    i0, j0 = cell_of(plan, node)
    for bearing in range(_BEARINGS):
        angle_rad = 2.0 * math.pi * bearing / _BEARINGS
        dx, dy = math.cos(angle_rad), math.sin(angle_rad)
        height_mm = np.int64(plan.heights_mm[node])
        for step in range(1, look_cells + 1):
            i, j = np.int64(round(i0 + step * dx)), np.int64(round(j0 + step * dy))
            other = nearest_node(plan, i, j, height_mm, s.level_mm)
            if other < 0 or kind_of(plan, other) != FREE:
                break
            height_mm = np.int64(plan.heights_mm[other])
            if is_reached(plan, was, other):
                return True
    return False


@compiled
def clusters(
    plan: Plan, s: Shape, counts: NDArray[np.int32], was: NDArray[np.uint64], away_m: FloatArray
) -> tuple[NDArray[np.int64], FloatArray]:
    """The cells of all frontiers, and to which each belongs.

    Those that can be seen from where the vehicle can be and those that cannot never belong together.

    Returns:
        (n, 2) node and number of its frontier, from 0, those of a frontier beside each other; and of each (n, 4):
        which way along x and y free cells lie beside it, 1 when one of them can be got to, and the shortest way there.
    """
    cells = np.empty((256, 2), np.int64)
    about = np.empty((256, 4))
    waiting = np.empty(256, np.int64)
    end, group = 0, 0
    for first in range(plan.used[0]):
        sheet = int(first if counts[first, FRONTIER_CELLS] > 0 else -1)
        while sheet >= 0:
            for start in range(sheet * CELLS, (sheet + 1) * CELLS):
                if not _is_open(plan, start):
                    continue
                seen = plan.flags[start] & FRONTIER
                plan.flags[start] |= MARKED
                waiting[0], count = start, 1
                while count > 0:
                    count -= 1
                    node = waiting[count]
                    if end == cells.shape[0]:
                        cells = np.concatenate((cells, np.empty_like(cells)))
                        about = np.concatenate((about, np.empty_like(about)))
                    cells[end, 0], cells[end, 1] = node, group
                    _about(plan, s, was, away_m, node, about[end])
                    end += 1
                    i, j = cell_of(plan, node)
                    for a in range(-_JOIN_CELLS, _JOIN_CELLS + 1):
                        for b in range(-_JOIN_CELLS, _JOIN_CELLS + 1):
                            other = first_sheet(plan, i + a, j + b)
                            its_place = on_tile(i + a, j + b)
                            while other >= 0:
                                its = other * CELLS + its_place
                                if (
                                    _is_open(plan, its)
                                    and plan.flags[its] & FRONTIER == seen
                                    and abs(plan.heights_mm[its] - plan.heights_mm[node]) < s.level_mm
                                ):
                                    plan.flags[its] |= MARKED
                                    if count == waiting.shape[0]:
                                        waiting = np.concatenate((waiting, np.empty_like(waiting)))
                                    waiting[count] = its
                                    count += 1
                                other = int(plan.others[other])
                group += 1
            sheet = int(plan.others[sheet])
    for n in range(end):
        plan.flags[cells[n, 0]] &= ~MARKED
    return cells[:end], about[:end]


@inner
def _is_open(plan: Plan, node: Integer) -> bool:
    return bool(is_node(plan, node) and kind_of(plan, node) == UNKNOWN and not plan.flags[node] & (AT_WALL | MARKED))


@inner
def _about(plan: Plan, s: Shape, was: NDArray[np.uint64], away_m: FloatArray, node: Integer, about: FloatArray) -> None:
    about[0] = about[1] = about[2] = 0.0
    about[3] = np.inf
    i, j = cell_of(plan, node)
    for a in range(-_JOIN_CELLS, _JOIN_CELLS + 1):
        for b in range(-_JOIN_CELLS, _JOIN_CELLS + 1):
            other = nearest_node(plan, i + a, j + b, np.int64(plan.heights_mm[node]), s.level_mm)
            if other >= 0 and kind_of(plan, other) == FREE:
                about[0] += a
                about[1] += b
                if is_reached(plan, was, other):
                    about[2] = 1.0
                    about[3] = min(about[3], away_m[other // CELLS])


def frontiers_of(
    plan: Plan, edge_m: float, cells: NDArray[np.int64], about: FloatArray, here_m: tuple[float, float, float]
) -> list[Frontier]:
    """Those that are long enough: those that count first, near ones before far ones.

    ``cells`` (n, 2) and ``about`` (n, 4) are from `clusters`; a cell has the edge ``edge_m``, and the vehicle is at
    ``here_m``.
    """
    nodes, groups = cells[:, 0], cells[:, 1]
    made = []
    for part in np.split(np.arange(len(nodes)), np.flatnonzero(np.diff(groups)) + 1):
        its = nodes[part]
        length_m = len(its) * edge_m
        if length_m < LEAST_FRONTIER_M - 1e-9:
            continue
        place = its % CELLS
        x_m = (plan.corners[its // CELLS, 0] + (place >> 4) + 0.5) * edge_m
        y_m = (plan.corners[its // CELLS, 1] + (place & 15) + 0.5) * edge_m
        to_free = about[part, :2].sum(axis=0)
        reachable, in_sight = bool(about[part, 2].any()), bool(plan.flags[its[0]] & FRONTIER)
        middle = float(x_m.mean()), float(y_m.mean()), float(plan.heights_mm[its].mean()) / 1000.0
        path_m = float(about[part, 3].min())
        made.append(
            Frontier(
                access=Access.REACHABLE if reachable else Access.IN_SIGHT if in_sight else Access.TOO_NARROW,
                length_m=length_m,
                x_m=middle[0],
                y_m=middle[1],
                z_m=middle[2],
                low_m=(float(x_m.min()) - edge_m / 2.0, float(y_m.min()) - edge_m / 2.0),
                high_m=(float(x_m.max()) + edge_m / 2.0, float(y_m.max()) + edge_m / 2.0),
                bearing_rad=math.atan2(-to_free[1], -to_free[0]),
                path_m=max(path_m, math.dist(middle, here_m)),
                cells=len(its),
            )
        )
    return sorted(made, key=_order)


def _order(frontier: Frontier) -> tuple[bool, float, float, float, float]:
    narrow = frontier.access is Access.TOO_NARROW
    return narrow, frontier.path_m, -frontier.length_m, frontier.x_m, frontier.y_m
