"""What the plan says: where the vehicle can get to, what it sees from there, and what belongs together.

Everything here is of one tile and what is around it, and is found anew for tiles that something changed only. The one
look at everything, `reach`, goes from part to part of the sheets and not from cell to cell.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from companion.mapping.chunks import Integer
from companion.mapping.lookup import FREE, OCCUPIED, UNKNOWN
from companion.mapping.queries.compiled import inner
from companion.mapping.queries.plan import (
    AT_WALL,
    BLOCKED,
    CELLS,
    FLOWN,
    FRONTIER,
    MARKED,
    MISSING,
    NONE,
    PROBE,
    SEEN,
    SIDES,
    TILE,
    Plan,
    Shape,
    first_sheet,
    is_node,
    kind_of,
    measure,
    nearest_node,
    on_tile,
    room_for,
)
from companion.mapping.queries.state_grid import Grid, has
from companion.model import FloatArray

_BEARINGS = 64
"""Directions in which a frontier looks for a place from which it can be seen."""

_JOIN_CELLS = 2
"""Frontier cells this far apart still belong together: noise interrupts a line."""

COUNTS = 6
"""Of a tile: cells free, roofs and floors seen and missing, cells unknown, cells of frontiers, cells reached."""


@njit(cache=True, nogil=True)
def around(plan: Plan, touched: NDArray[np.bool_], rim: int) -> NDArray[np.bool_]:
    """The tiles that are touched and those up to ``rim`` tiles from one, each by its first sheet."""
    wide = touched.copy()
    for sheet in range(plan.used[0]):
        if touched[sheet]:
            i, j = plan.corners[sheet, 0], plan.corners[sheet, 1]
            for a in range(-rim, rim + 1):
                for b in range(-rim, rim + 1):
                    other = first_sheet(plan, i + a * TILE, j + b * TILE)
                    if other >= 0:
                        wide[other] = True
    return wide


@njit(cache=True, nogil=True)
def probe(
    grid: Grid, plan: Plan, s: Shape, tiles: NDArray[np.bool_], circle: NDArray[np.int64], unknown: NDArray[np.int32]
) -> None:
    """Look behind unknown cells for the wall to which they may belong.

    Args:
        grid: the map.
        plan: gets an obstacle where there is one and no node.
        s: its numbers.
        tiles: (MOST_SHEETS,) for which tiles, by their first sheets.
        circle: (n, 2) the cells around one, near ones first.
        unknown: (MOST_SHEETS,) how many nodes of each tile are unknown.
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


@njit(cache=True, nogil=True)
def mark_near(plan: Plan, s: Shape, tiles: NDArray[np.bool_], blocked_cells: float, wall_cells: float) -> None:
    """Mark the nodes near obstacles: `BLOCKED` and `AT_WALL`.

    Args:
        plan: the plan.
        s: its numbers.
        tiles: (MOST_SHEETS,) for which tiles, by their first sheets.
        blocked_cells: what is nearer than this to an obstacle is blocked.
        wall_cells: and what is nearer than this is at a wall.
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


@inner
def is_way(plan: Plan, node: Integer) -> bool:
    """Whether the vehicle can be there: it is free and nothing is nearer than d_s, or it was there."""
    flags = plan.flags[node]
    return bool(is_node(plan, node) and kind_of(plan, node) == FREE and (flags & FLOWN or not flags & BLOCKED))


@njit(cache=True, nogil=True)
def part_sheets(plan: Plan, s: Shape, tiles: NDArray[np.bool_]) -> None:
    """Number the parts of each sheet that hang together and where the vehicle can be."""
    waiting = np.empty(CELLS, np.int64)
    for first in range(plan.used[0]):
        sheet = int(first if tiles[first] else -1)
        while sheet >= 0:
            base = sheet * CELLS
            plan.parts[base : base + CELLS] = 0
            last = 0
            for start in range(CELLS):
                if plan.parts[base + start] > 0 or not is_way(plan, base + start):
                    continue
                last += 1
                plan.parts[base + start] = last
                waiting[0], count = start, 1
                while count > 0:
                    count -= 1
                    place = waiting[count]
                    for side in range(4):
                        a, b = (place >> 4) + SIDES[side, 0], (place & 15) + SIDES[side, 1]
                        if not (0 <= a < TILE and 0 <= b < TILE):
                            continue
                        other = a * TILE + b
                        apart = abs(plan.heights_mm[base + other] - plan.heights_mm[base + place])
                        new = plan.parts[base + other] == 0 and is_way(plan, base + other)
                        if new and apart < s.level_mm:
                            plan.parts[base + other] = last
                            waiting[count] = other
                            count += 1
            sheet = int(plan.others[sheet])


@njit(cache=True, nogil=True)
def count_tiles(plan: Plan, tiles: NDArray[np.bool_], counts: NDArray[np.int32]) -> None:
    """Fill in the first four of `COUNTS` for some tiles."""
    for first in range(plan.used[0]):
        if not tiles[first]:
            continue
        counts[first, :4] = 0
        sheet = first
        while sheet >= 0:
            for node in range(sheet * CELLS, (sheet + 1) * CELLS):
                if not is_node(plan, node):
                    continue
                if kind_of(plan, node) == FREE:
                    roof, floor = plan.kinds[node] >> 2 & 3, plan.kinds[node] >> 4 & 3
                    counts[first, 0] += 1
                    counts[first, 1] += (roof == SEEN) + (floor == SEEN)
                    counts[first, 2] += (roof == MISSING) + (floor == MISSING)
                elif kind_of(plan, node) == UNKNOWN:
                    counts[first, 3] += 1
            sheet = int(plan.others[sheet])


@njit(cache=True, nogil=True)
def reach(
    plan: Plan, s: Shape, start: NDArray[np.int64], flown: NDArray[np.int64], away_m: FloatArray, tile_m: float
) -> NDArray[np.bool_]:
    """(sheets, 256) which parts of each sheet can be got to from where the vehicle was.

    Args:
        plan: the plan.
        s: its numbers.
        start: (n,) nodes from which ways are measured: where the vehicle is.
        flown: (m,) nodes where it was.
        away_m: (sheets,) is filled with the shortest way to each sheet, at most as exact as a tile is wide; infinite
            where no way leads from the start.
        tile_m: edge of a tile.
    """
    used = plan.used[0]
    found = np.zeros((used, CELLS), np.bool_)
    away_m[:] = np.inf
    queue = np.empty((used * 4 + 4, 2), np.int64)
    for turn in range(2):
        # First from where the vehicle is, then from all places where it was and to which no way was found.
        begin, end = 0, 0
        for node in start if turn == 0 else flown:
            sheet, part = node // CELLS, np.int64(plan.parts[node])
            if part > 0 and not found[sheet, part]:
                found[sheet, part] = True
                away_m[sheet] = 0.0 if turn == 0 else np.inf
                if end == queue.shape[0]:
                    queue = np.concatenate((queue, np.empty_like(queue)))
                queue[end, 0], queue[end, 1] = sheet, part
                end += 1
        while begin < end:
            sheet, part = queue[begin]
            begin += 1
            i0, j0 = np.int64(plan.corners[sheet, 0]), np.int64(plan.corners[sheet, 1])
            alone = plan.others[sheet] < 0 and first_sheet(plan, i0, j0) == sheet
            for edge in range(CELLS):
                row, column = edge >> 4, edge & 15
                base = sheet * CELLS + edge
                if plan.parts[base] != part:
                    continue
                if alone and 0 < row < TILE - 1 and 0 < column < TILE - 1:
                    continue
                for side in range(4):
                    inside = 0 <= row + SIDES[side, 0] < TILE and 0 <= column + SIDES[side, 1] < TILE
                    if inside and alone:
                        continue
                    i, j = i0 + row + SIDES[side, 0], j0 + column + SIDES[side, 1]
                    place = on_tile(i, j)
                    other = first_sheet(plan, i, j)
                    while other >= 0:
                        its = other * CELLS + place
                        its_part = np.int64(plan.parts[its])
                        if (
                            its_part > 0
                            and not found[other, its_part]
                            and abs(plan.heights_mm[its] - plan.heights_mm[base]) < s.level_mm
                        ):
                            found[other, its_part] = True
                            away_m[other] = min(away_m[other], away_m[sheet] + tile_m)
                            if end == queue.shape[0]:
                                queue = np.concatenate((queue, np.empty_like(queue)))
                            queue[end, 0], queue[end, 1] = other, its_part
                            end += 1
                        other = int(plan.others[other])
    return found


@njit(cache=True, nogil=True)
def count_reached(
    plan: Plan, found: NDArray[np.bool_], was: NDArray[np.uint64], tiles: NDArray[np.bool_], counts: NDArray[np.int32]
) -> None:
    """Count the cells that can be got to.

    Args:
        plan: the plan.
        found: from `reach`.
        was: (MOST_SHEETS, 4) the same as bits, from the last time; is brought up to date.
        tiles: (MOST_SHEETS,) tiles that are different, by their first sheets; where ``found`` is different is added.
        counts: (MOST_SHEETS, COUNTS), the last is filled in for these.
    """
    used = plan.used[0]
    for first in range(used):
        if first_sheet(plan, np.int64(plan.corners[first, 0]), np.int64(plan.corners[first, 1])) != first:
            continue
        sheet = first
        while sheet >= 0:
            for word in range(4):
                bits = np.uint64(0)
                for bit in range(64):
                    bits |= np.uint64(found[sheet, 64 * word + bit]) << np.uint64(bit)
                if bits != was[sheet, word]:
                    was[sheet, word] = bits
                    tiles[first] = True
            sheet = int(plan.others[sheet])
        if not tiles[first]:
            continue
        counts[first, 5] = 0
        sheet = first
        while sheet >= 0:
            for node in range(sheet * CELLS, (sheet + 1) * CELLS):
                if plan.parts[node] > 0 and found[sheet, plan.parts[node]]:
                    counts[first, 5] += 1
            sheet = int(plan.others[sheet])


@inner
def is_reached(plan: Plan, was: NDArray[np.uint64], node: Integer) -> bool:
    """Whether the vehicle can get to a node, by what `count_reached` kept."""
    part = np.int64(plan.parts[node])
    return bool(part > 0 and has(was[node // CELLS, part >> 6], part & 63))


@njit(cache=True, nogil=True)
def mark_frontiers(
    plan: Plan, s: Shape, tiles: NDArray[np.bool_], was: NDArray[np.uint64], look_cells: int, counts: NDArray[np.int32]
) -> None:
    """Mark the unknown nodes that can be seen through free ones from where the vehicle can be.

    Args:
        plan: gets the marks.
        s: its numbers.
        tiles: (MOST_SHEETS,) for which tiles, by their first sheets.
        was: from `count_reached`.
        look_cells: so far a look says something.
        counts: (MOST_SHEETS, COUNTS), the fifth is filled in: cells of a frontier, seen or not.
    """
    for first in range(plan.used[0]):
        if not tiles[first]:
            continue
        counts[first, 4] = 0
        sheet = first
        while sheet >= 0:
            for node in range(sheet * CELLS, (sheet + 1) * CELLS):
                plan.flags[node] &= ~FRONTIER
                if is_node(plan, node) and kind_of(plan, node) == UNKNOWN and not plan.flags[node] & AT_WALL:
                    counts[first, 4] += 1
                    if _is_seen(plan, s, node, was, look_cells):
                        plan.flags[node] |= FRONTIER
            sheet = int(plan.others[sheet])


@inner
def _is_seen(plan: Plan, s: Shape, node: Integer, was: NDArray[np.uint64], look_cells: int) -> bool:
    sheet, place = node // CELLS, node % CELLS
    i0, j0 = plan.corners[sheet, 0] + (place >> 4), plan.corners[sheet, 1] + (place & 15)
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


@njit(cache=True, nogil=True)
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
        sheet = int(first if counts[first, 4] > 0 else -1)
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
                    on, place = node // CELLS, node % CELLS
                    i, j = plan.corners[on, 0] + (place >> 4), plan.corners[on, 1] + (place & 15)
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
    sheet, place = node // CELLS, node % CELLS
    i, j = plan.corners[sheet, 0] + (place >> 4), plan.corners[sheet, 1] + (place & 15)
    for a in range(-_JOIN_CELLS, _JOIN_CELLS + 1):
        for b in range(-_JOIN_CELLS, _JOIN_CELLS + 1):
            other = nearest_node(plan, i + a, j + b, np.int64(plan.heights_mm[node]), s.level_mm)
            if other >= 0 and kind_of(plan, other) == FREE:
                about[0] += a
                about[1] += b
                if is_reached(plan, was, other):
                    about[2] = 1.0
                    about[3] = min(about[3], away_m[other // CELLS])
