"""The tiles of the plan: which have to be looked at again where the map has changed, and what is counted of each.

A survey adds up the tiles, and only those over and around what changed are counted again.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled
from companion.mapping.frontiers.plan import CELLS, MISSING, SEEN, TILE, Plan, first_sheet, is_node, kind_of
from companion.mapping.voxels.chunks import EDGE
from companion.mapping.voxels.lookup import FREE, UNKNOWN


@compiled
def cells_over(chunks: NDArray[np.int64], bricks: NDArray[np.uint64], stride: int) -> NDArray[np.int64]:
    """The cells of the plan over bricks that changed, both coordinates in one number, some of them twice.

    Args:
        chunks: (n, 3) coordinates.
        bricks: (n,) bit b for brick b.
        stride: voxels along one edge of a cell.
    """
    cells = np.empty(1024, np.int64)
    count = 0
    for n in range(chunks.shape[0]):
        # The bits of a brick's number are those of x, y, z, x, y, z: those of z are folded away.
        columns = bricks[n] | bricks[n] >> np.uint64(4)
        columns |= columns >> np.uint64(32)
        for brick in range(64):
            if brick & 0b100100 or not columns >> np.uint64(brick) & np.uint64(1):
                continue
            x = EDGE * chunks[n, 0] + 4 * ((brick & 1) | (brick >> 2 & 2))
            y = EDGE * chunks[n, 1] + 4 * ((brick >> 1 & 1) | (brick >> 3 & 2))
            for i in range(x // stride, (x + 3) // stride + 1):
                for j in range(y // stride, (y + 3) // stride + 1):
                    if count == cells.shape[0]:
                        cells = np.concatenate((cells, np.empty_like(cells)))
                    cells[count] = i << 32 | (j + 2**31)
                    count += 1
    return cells[:count]


@compiled
def touch_under(plan: Plan, cells: NDArray[np.int64], touched: NDArray[np.bool_]) -> None:
    """Mark the tiles of cells (n, 2)."""
    for n in range(cells.shape[0]):
        sheet = first_sheet(plan, cells[n, 0], cells[n, 1])
        if sheet >= 0:
            touched[sheet] = True


@compiled
def tiles_around(plan: Plan, touched: NDArray[np.bool_], rim: int) -> NDArray[np.bool_]:
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
