"""What the map has seen the beginning of and the vehicle cannot look into: too narrow, too low, out of range.

Narrow places are frontiers, which a survey reports. What is too low is none: at flight height the roof is rock like a
wall. It is found at the foot of these walls, where free space goes on below. What is out of range is found over free
cells under which, or above which, the camera met nothing as far as it sees.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled, inner
from companion.control.left_out import LeftOut, Why, pieces
from companion.mapping.frontiers.frontier import Access, Frontier
from companion.mapping.frontiers.plan import (
    CELLS,
    OPEN,
    SIDES,
    Plan,
    Shape,
    cell_of,
    is_node,
    kind_of,
    nearest_node,
)
from companion.mapping.frontiers.reachable import is_reached
from companion.mapping.frontiers.state_grid import Grid, state_at
from companion.mapping.voxels.chunks import Integer
from companion.mapping.voxels.lookup import FREE, OCCUPIED
from companion.model import FloatArray

LOW_M, DEEP_M = 0.4, 1.0
"""A passage below a roof has at least this height, and is free for at least this length: less is a hanging wall."""

LEAST_M = 1.0
"""A smaller place is not told of."""

_JOIN_M, _LEVEL_M = 0.5, 1.0


def left_out(
    grid: Grid, plan: Plan, shape: Shape, reached: NDArray[np.uint64], frontiers: tuple[Frontier, ...]
) -> Iterator[LeftOut]:
    """The places, from what a survey has found.

    Args:
        grid: the states of all voxels.
        plan: at flight height.
        shape: its numbers.
        reached: (MOST_SHEETS, 4) from `count_reached`.
        frontiers: of the survey.
    """
    cell_m = shape.stride * shape.voxel_mm / 1000.0
    for found in frontiers:
        extent_m = max(found.high_m[0] - found.low_m[0], found.high_m[1] - found.low_m[1])
        why = Why.TOO_NARROW if found.access is Access.TOO_NARROW else Why.NOT_REACHED
        yield LeftOut(found.x_m, found.y_m, found.z_m, extent_m, why)
    low, far = _low_nodes(grid, plan, shape), _far_nodes(plan, reached)
    for nodes, why in ((low, Why.TOO_LOW), (far, Why.OUT_OF_RANGE)):
        points_m = _points_m(plan, nodes, cell_m)
        for piece in pieces(points_m, _JOIN_M, _LEVEL_M):
            place = LeftOut.over(points_m[piece], cell_m, why)
            if place.extent_m >= LEAST_M:
                yield place


def _points_m(plan: Plan, nodes: NDArray[np.int64], cell_m: float) -> FloatArray:
    """(n, 3) middles of nodes."""
    place = nodes % CELLS
    x_m = (plan.corners[nodes // CELLS, 0] + (place >> 4) + 0.5) * cell_m
    y_m = (plan.corners[nodes // CELLS, 1] + (place & 15) + 0.5) * cell_m
    return np.stack([x_m, y_m, plan.heights_mm[nodes] / 1000.0], axis=1)


@compiled
def _far_nodes(plan: Plan, reached: NDArray[np.uint64]) -> NDArray[np.int64]:
    """Nodes that the vehicle gets to, above or below which nothing was met as far as the camera sees."""
    nodes = np.empty(plan.used[0] * CELLS, np.int64)
    count = 0
    for node in range(plan.used[0] * CELLS):
        kind = plan.kinds[node]
        is_far = (kind >> 2) & 3 == OPEN or (kind >> 4) & 3 == OPEN
        if is_node(plan, node) and kind_of(plan, node) == FREE and is_far and is_reached(plan, reached, node):
            nodes[count] = node
            count += 1
    return nodes[:count]


@inner
def _goes_on_below(grid: Grid, plan: Plan, s: Shape, node: Integer) -> bool:
    """Whether there is a passage too low for the vehicle, away from a free node beside."""
    i, j = cell_of(plan, node)
    height_mm = plan.heights_mm[node]
    centre = int(np.floor(height_mm / s.voxel_mm))
    needs = int(np.ceil(1000.0 * LOW_M / s.voxel_mm))
    # The roof is the lowest rock in the slab; below it everything down to the ground, or half of it, must be free.
    x, y = i * s.stride, j * s.stride
    top = centre - s.half
    while top <= centre + s.half and state_at(grid, x, y, top) != OCCUPIED:
        top += 1
    bottom = top
    while top - bottom < 2 * needs and state_at(grid, x, y, bottom - 1) == FREE:
        bottom -= 1
    if top > centre + s.half or top - bottom < needs:
        return False
    level = (top + bottom) // 2
    deep = int(np.ceil(1000.0 * DEEP_M / s.voxel_mm))
    for side in range(4):
        a, b = SIDES[side]
        before = nearest_node(plan, i - a, j - b, height_mm, s.level_mm)
        if before < 0 or kind_of(plan, before) != FREE:
            continue
        along = 0
        while along <= deep and state_at(grid, x + along * a, y + along * b, level) == FREE:
            along += 1
        if along > deep:
            return True
    return False


@compiled
def _low_nodes(grid: Grid, plan: Plan, s: Shape) -> NDArray[np.int64]:
    """Nodes with rock in the way of the vehicle, beside free ones, under which free space goes on."""
    nodes = np.empty(plan.used[0] * CELLS, np.int64)
    count = 0
    for node in range(plan.used[0] * CELLS):
        if is_node(plan, node) and kind_of(plan, node) == OCCUPIED and _goes_on_below(grid, plan, s, node):
            nodes[count] = node
            count += 1
    return nodes[:count]
