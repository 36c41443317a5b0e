"""The plan at flight height that is drawn through a map: where the vehicle could be, and what it knows there.

A cell of the plan is a square of about 10 cm, and each place on it a node. Nodes over one cell that are further apart
in height than a level are different places, as in a spiral ramp. Nodes are kept in sheets: a sheet is a tile of 16 x 16
cells with room for one node on each, and a tile with several levels has several sheets. `Shape` has the numbers of a
plan, which follow from the size of the voxels and from what the vehicle can do.

Heights are whole millimetres, so that the same node has the same height however it was come by.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from companion.compiled import inner
from companion.mapping.frontiers.frontier import Reach
from companion.mapping.frontiers.state_grid import Grid, brick_words, has, row_of
from companion.mapping.voxels.chunks import MASK, SHIFT, Integer, chunk_key, place_of, row_of_key, slot_of
from companion.mapping.voxels.lookup import FREE, OCCUPIED, UNKNOWN

CELL_M = 0.1
"""Edge of a cell of the plan, or the edge of a voxel where that is more."""

_SURFACE_SHARE = 0.75
"""Floor and roof count where the camera can see them from this share of its range."""

_GAP_M = 0.2
"""So much of which the looks did not decide may lie before a floor or a roof."""

_DROP_M = 1.0
"""How far below where it should be the ground is still looked for."""


class Shape(NamedTuple):
    """The numbers of a plan. Those without a unit are voxels.

    Attributes:
        voxel_mm: edge of a voxel.
        stride: voxels along one edge of a cell.
        height_mm: H.
        most_mm: so much higher or lower than the node before it a node is at most.
        level_mm: nodes of one cell within this height are the same.
        half: what is this much above or below the centre of the vehicle is in its way.
        gap: so many unknown voxels may lie before a floor or a roof.
        below: voxels of a column that are read below the vehicle.
        above: and above it.
        up: the roof counts up to so far above the slab.
        down: the floor counts down to so far below it.
    """

    voxel_mm: float
    stride: int
    height_mm: int
    most_mm: int
    level_mm: int
    half: int
    gap: int
    below: int
    above: int
    up: int
    down: int


def shape_of(voxel_m: float, reach: Reach) -> Shape:
    """The numbers of a plan over voxels with edges of ``voxel_m``, for a vehicle that can do this."""
    stride = max(1, round(CELL_M / voxel_m))
    half = max(1, round(reach.half_slab_m / voxel_m))
    gap = max(1, round(_GAP_M / voxel_m))
    up_m = max(_SURFACE_SHARE * reach.look_m * math.tan(reach.up_rad), 0.0)
    down_m = max(_SURFACE_SHARE * reach.look_m * math.tan(reach.down_rad), 0.0)
    return Shape(
        voxel_mm=1000.0 * voxel_m,
        stride=stride,
        height_mm=round(1000.0 * reach.height_m),
        most_mm=round(1000.0 * reach.max_slope * stride * voxel_m),
        level_mm=round(500.0 * reach.height_m),
        half=half,
        gap=gap,
        below=math.ceil((max(reach.height_m + _DROP_M, down_m) + reach.half_slab_m) / voxel_m),
        above=math.ceil((up_m + reach.half_slab_m) / voxel_m) + gap + 1,
        up=math.floor(up_m / voxel_m) - half + gap,
        down=math.floor(down_m / voxel_m) - half + gap,
    )


TILE = 16
"""Cells along one edge of a tile."""

CELLS = TILE * TILE
"""Cells of a tile."""

MOST_SHEETS = 2**16
"""So many sheets are kept at most, for 25 km of drifts 4 m wide. They take memory only when they are used."""

OPEN, MISSING, SEEN = np.uint8(0), np.uint8(1), np.uint8(2)
"""What is known of the floor or of the roof over a cell: too far off to say, should have been seen, was seen."""

NONE, PROBE = np.uint16(0), np.uint16(65535)
"""Instead of the step of a node: there is no node; an obstacle that was found behind unknown cells."""

FLOWN, KEPT, BLOCKED, AT_WALL, FRONTIER, MARKED = (np.uint8(1 << n) for n in range(6))
"""Flags of a node: the vehicle was here; it was so near that this must be free; an obstacle is nearer than d_s; it may
be the undecided surface of a wall; it belongs to a frontier; the search that is running was here."""


class Plan(NamedTuple):
    """The nodes. Number n is on sheet n // 256, and there on cell n % 256.

    Attributes:
        keys: (2^k,) int64, hash table of the tiles, -1 where empty.
        firsts: (2^k,) int32, the first sheet of the tile beside it.
        others: (MOST_SHEETS,) int32, the next sheet of the same tile, or -1.
        corners: (MOST_SHEETS, 2) int32, coordinates of the sheet's first cell.
        heights_mm: (nodes,) int32, height of the vehicle there.
        rises_mm: (nodes,) int16, how much higher that is than where the node was entered from.
        steps: (nodes,) uint16, one more than the cells between it and where the vehicle was, `NONE` or `PROBE`.
        ranks: (nodes,) uint16, from where it was entered: earlier ones win.
        kinds: (nodes,) uint8, `FREE`, `OCCUPIED` or `UNKNOWN`, with the roof in the next two bits, then the floor.
        flags: (nodes,) uint8.
        parts: (nodes,) uint8, which part of the sheet that hangs together it belongs to, from 1; 0 for none.
        used: (2,) int64: sheets in use; 1 when there was no room for more.
    """

    keys: NDArray[np.int64]
    firsts: NDArray[np.int32]
    others: NDArray[np.int32]
    corners: NDArray[np.int32]
    heights_mm: NDArray[np.int32]
    rises_mm: NDArray[np.int16]
    steps: NDArray[np.uint16]
    ranks: NDArray[np.uint16]
    kinds: NDArray[np.uint8]
    flags: NDArray[np.uint8]
    parts: NDArray[np.uint8]
    used: NDArray[np.int64]


def empty_plan() -> Plan:
    """A plan without nodes. Zeroed memory costs nothing until it is used."""
    nodes = MOST_SHEETS * CELLS
    return Plan(
        keys=np.full(4 * MOST_SHEETS, -1, np.int64),
        firsts=np.zeros(4 * MOST_SHEETS, np.int32),
        others=np.zeros(MOST_SHEETS, np.int32),
        corners=np.zeros((MOST_SHEETS, 2), np.int32),
        heights_mm=np.zeros(nodes, np.int32),
        rises_mm=np.zeros(nodes, np.int16),
        steps=np.zeros(nodes, np.uint16),
        ranks=np.zeros(nodes, np.uint16),
        kinds=np.zeros(nodes, np.uint8),
        flags=np.zeros(nodes, np.uint8),
        parts=np.zeros(nodes, np.uint8),
        used=np.zeros(2, np.int64),
    )


SIDES = np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
"""From a cell to the four beside it."""


def cells_within(radius_cells: float) -> NDArray[np.int64]:
    """(n, 2) cells in a circle around one, near ones first."""
    rim = math.floor(radius_cells)
    cells = [(a * a + b * b, a, b) for a in range(-rim, rim + 1) for b in range(-rim, rim + 1)]
    inside = [cell[1:] for cell in sorted(cells) if cell[0] <= radius_cells * radius_cells]
    return np.array(inside, np.int64).reshape(-1, 2)


@inner
def kind_of(plan: Plan, node: Integer) -> int:
    """`FREE`, `OCCUPIED` or `UNKNOWN`."""
    return int(plan.kinds[node]) & 3


@inner
def first_sheet(plan: Plan, i: Integer, j: Integer) -> int:
    """The first sheet of the tile of cell (i, j), or -1."""
    return row_of_key(plan.keys, plan.firsts, chunk_key(i >> 4, j >> 4, 0))


@inner
def on_tile(i: Integer, j: Integer) -> int:
    """The number of cell (i, j) on its tile."""
    return int((i & 15) << 4 | (j & 15))


@inner
def cell_of(plan: Plan, node: Integer) -> tuple[Integer, Integer]:
    """The cell (i, j) that a node is on."""
    sheet, place = node // CELLS, node % CELLS
    return plan.corners[sheet, 0] + (place >> 4), plan.corners[sheet, 1] + (place & 15)


@inner
def is_node(plan: Plan, node: Integer) -> bool:
    """Whether there is a node that was entered, not only an obstacle behind unknown ones."""
    return bool(plan.steps[node] != NONE and plan.steps[node] != PROBE)


@inner
def nearest_node(plan: Plan, i: Integer, j: Integer, height_mm: Integer, level_mm: Integer) -> int:
    """The node on cell (i, j) nearest to a height, the lower of two, or -1 where none is on that level."""
    found, least = -1, level_mm
    sheet = first_sheet(plan, i, j)
    place = on_tile(i, j)
    while sheet >= 0:
        node = sheet * CELLS + place
        if is_node(plan, node):
            apart = abs(plan.heights_mm[node] - height_mm)
            if apart < least or (apart == least and found >= 0 and plan.heights_mm[node] < plan.heights_mm[found]):
                found, least = node, apart
        sheet = int(plan.others[sheet])
    return found


@inner
def room_for(plan: Plan, i: Integer, j: Integer) -> int:
    """The number of a new node on cell (i, j), or -1 when no sheet is left. An obstacle behind unknown cells yields."""
    key = chunk_key(i >> 4, j >> 4, 0)
    slot = slot_of(plan.keys, key)
    place = on_tile(i, j)
    last = -1
    if plan.keys[slot] == key:
        sheet = int(plan.firsts[slot])
        while sheet >= 0:
            if not is_node(plan, sheet * CELLS + place):
                return sheet * CELLS + place
            last = sheet
            sheet = int(plan.others[sheet])
    new = int(plan.used[0])
    if new == plan.others.shape[0]:
        plan.used[1] = 1
        return -1
    plan.used[0] += 1
    if last >= 0:
        plan.others[last] = new
    else:
        plan.keys[slot], plan.firsts[slot] = key, new
    plan.others[new] = -1
    plan.corners[new, 0], plan.corners[new, 1] = (i >> 4) << 4, (j >> 4) << 4
    return new * CELLS + place


_LEVELS = np.array([int(place_of.py_func(0, 0, z)) for z in range(4)])
"""(4,) the part of a voxel's bit in its brick that follows from its height there."""


@inner
def _read_column(grid: Grid, x: Integer, y: Integer, z: Integer, column: NDArray[np.uint8]) -> None:
    """The states of the voxels from (x, y, z) upwards."""
    base = place_of(x & 3, y & 3, 0)
    part = place_of(x & 12, y & 12, 0)
    row = -1
    occupied, free = np.uint64(0), np.uint64(0)
    for n in range(column.shape[0]):
        at = z + n
        if n == 0 or at & MASK == 0:
            row = row_of(grid, x >> SHIFT, y >> SHIFT, at >> SHIFT)
        if n == 0 or at & 3 == 0:
            if row >= 0:
                occupied, free = brick_words(grid, row, (part | place_of(0, 0, at & 12)) >> 6)
            else:
                occupied, free = np.uint64(0), np.uint64(0)
        bit = base | _LEVELS[at & 3]
        column[n] = OCCUPIED if has(occupied, bit) else FREE if has(free, bit) else UNKNOWN


@inner
def _surface(column: NDArray[np.uint8], start: int, step: int, limit: int, gap: int) -> np.uint8:
    """What is known of the first surface from ``start`` on, up to ``limit`` voxels away.

    A few voxels of which the looks did not decide may lie before it.
    """
    unknown, at = 0, start
    for _ in range(limit):
        if at < 0 or at >= column.shape[0]:
            return OPEN
        if column[at] == OCCUPIED:
            return SEEN
        unknown += column[at] == UNKNOWN
        if unknown > gap:
            return MISSING
        at += step
    return OPEN


@inner
def measure(grid: Grid, s: Shape, i: Integer, j: Integer, from_mm: Integer, flown: bool) -> tuple[int, int]:
    """What a node on cell (i, j) is that is entered at a height.

    Returns:
        Its height in mm, which follows the ground unless it was flown at, and its kind, roof and floor as in `Plan`.
    """
    bottom = math.floor(from_mm / s.voxel_mm + _ROUNDING) - s.below
    column = np.empty(s.below + s.above, np.uint8)
    middle = s.stride // 2
    _read_column(grid, i * s.stride + middle, j * s.stride + middle, bottom, column)

    height_mm = np.int64(from_mm)
    if not flown:
        for n in range(s.below - s.half, -1, -1):
            if column[n] == OCCUPIED:
                wanted_mm = np.int64(round((bottom + n + 1) * s.voxel_mm)) + s.height_mm
                height_mm += min(max(wanted_mm - from_mm, -s.most_mm), s.most_mm)
                break
    centre = math.floor(height_mm / s.voxel_mm + _ROUNDING) - bottom

    low = max(centre - s.half, 0)
    occupied, free = 0, 0
    slab = np.empty(2 * s.half + 1, np.uint8)
    for a in range(s.stride):
        for b in range(s.stride):
            _read_column(grid, i * s.stride + a, j * s.stride + b, bottom + low, slab)
            for state in slab:
                occupied += state == OCCUPIED
                free += state == FREE
    kind = OCCUPIED if occupied > 0 else FREE if 2 * free > (2 * s.half + 1) * s.stride**2 else UNKNOWN
    roof = _surface(column, centre + s.half, 1, s.up, s.gap)
    floor = _surface(column, centre - s.half, -1, s.down, s.gap)
    return height_mm, np.int64(kind) | np.int64(roof) << 2 | np.int64(floor) << 4  # type: ignore[return-value]


_ROUNDING = 1e-6
"""Voxels: a height on the border of two belongs to the upper one, whatever the division makes of it."""
