"""What is counted of each tile. A survey adds up the tiles, and only those that changed are counted again."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled
from companion.mapping.frontiers.plan import CELLS, MISSING, SEEN, Plan, is_node, kind_of
from companion.mapping.voxels.lookup import FREE, UNKNOWN

COUNTS = 6
"""Of a tile so much is counted, in this order."""

FREE_CELLS, SURFACES_SEEN, SURFACES_MISSING, UNKNOWN_CELLS, FRONTIER_CELLS, REACHED_CELLS = range(COUNTS)
"""Cells that are free; roofs and floors over and below them that were seen, and that were not though they could be;
cells unknown; of these, cells of frontiers; cells that can be got to. `count_tiles` counts the first four."""


@compiled
def count_tiles(plan: Plan, tiles: NDArray[np.bool_], counts: NDArray[np.int32]) -> None:
    """Count the first four for some tiles, given by their first sheets."""
    for first in range(plan.used[0]):
        if not tiles[first]:
            continue
        counts[first, :FRONTIER_CELLS] = 0
        sheet = first
        while sheet >= 0:
            for node in range(sheet * CELLS, (sheet + 1) * CELLS):
                if not is_node(plan, node):
                    continue
                if kind_of(plan, node) == FREE:
                    roof, floor = plan.kinds[node] >> 2 & 3, plan.kinds[node] >> 4 & 3
                    counts[first, FREE_CELLS] += 1
                    counts[first, SURFACES_SEEN] += (roof == SEEN) + (floor == SEEN)
                    counts[first, SURFACES_MISSING] += (roof == MISSING) + (floor == MISSING)
                elif kind_of(plan, node) == UNKNOWN:
                    counts[first, UNKNOWN_CELLS] += 1
            sheet = int(plan.others[sheet])
