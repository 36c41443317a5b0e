"""Which of two nodes on a cell comes first: the one that the flood would have reached first.

A node knows how it was entered: with how many steps, with which rank and from which height. Of the same number of steps
the lower rank wins. A place flown has rank 0; what must be free because it is near to one has the place, from 1, of its
cell in the circle around it; what lies beside a free node has `RANK_OF_SIDES` and the number of the side.
"""

from __future__ import annotations

from companion.compiled import inner
from companion.mapping.frontiers.plan import CELLS, Plan, first_sheet, is_node, on_tile
from companion.mapping.frontiers.plan_shape import Shape
from companion.mapping.voxels.chunks import Integer

RANK_OF_SIDES = 60_000
"""Who was so near that it must be free comes before who is beside a free node."""


@inner
def entered_from_mm(plan: Plan, node: Integer) -> int:
    """The height of the node from which one was entered."""
    return int(plan.heights_mm[node]) - int(plan.rises_mm[node])


@inner
def is_before(plan: Plan, node: Integer, steps: Integer, rank: Integer, from_mm: Integer) -> bool:
    """Whether a node comes before one that would be entered like this, or is that one."""
    if plan.steps[node] != steps:
        return bool(plan.steps[node] < steps)
    if plan.ranks[node] != rank:
        return bool(plan.ranks[node] < rank)
    return bool(entered_from_mm(plan, node) <= from_mm)


@inner
def is_taken(plan: Plan, s: Shape, i: Integer, j: Integer, steps: Integer, rank: Integer, from_mm: Integer) -> bool:
    """Whether cell (i, j) has a node on this level that comes before one that would be entered like this."""
    sheet = first_sheet(plan, i, j)
    place = on_tile(i, j)
    while sheet >= 0:
        node = sheet * CELLS + place
        if (
            is_node(plan, node)
            and abs(plan.heights_mm[node] - from_mm) < s.level_mm
            and is_before(plan, node, steps, rank, from_mm)
        ):
            return True
        sheet = int(plan.others[sheet])
    return False
