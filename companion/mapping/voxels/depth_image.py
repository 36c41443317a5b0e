"""What a depth image says about free space: for each pixel a depth up to which it is clear, and a pyramid of these."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled, compiled_unchecked

TILE_PX = 8
"""Edge of the smallest tile."""

LEVELS = 6
"""Tiles of 8, 16, .. 256 px."""


class ClearDepth(NamedTuple):
    """Depth up to which each pixel has seen free space.

    Attributes:
        depth_m: (height * width,) float32, row by row, 0 where the pixel says nothing.
        least_m: (levels, rows, columns) float32, least clear depth in each tile of 8 px, of 16 px and so on, of which
            there are half as many along each side; 0 when one of the tile's pixels says nothing.
        most_m: (levels, rows, columns) float32, the greatest in the same way.
    """

    depth_m: NDArray[np.float32]
    least_m: NDArray[np.float32]
    most_m: NDArray[np.float32]


_BESIDE_PX = math.sqrt(0.5**2 + 1.5**2)
"""Two points are no further apart than this, of which one is in a pixel and the other the centre of that above it."""


def hole_depth_m(voxel_m: float, focal_px: float) -> float:
    """Depth up to which a pixel that says nothing is as clear as the one above or below it.

    So near, the ray of that one still passes through the voxel whose centre lies in the pixel: the voxel is so large in
    the image. Cameras leave out a pixel here and there, and a camera that is held still leaves out the same ones.
    """
    return voxel_m / 2.0 * focal_px / _BESIDE_PX


@compiled_unchecked
def clear_depth(
    depth_m: NDArray[np.float32],
    lowest_m: float,
    limit_m: float,
    margin_m: float,
    noise_per_m: float,
    hole_m: float,
    clear: NDArray[np.float32],
) -> ClearDepth:
    """Depth up to which each pixel of a depth image has seen free space.

    A pixel counts with the least depth among its 3 x 3 neighbours: on a surface seen at a slant, the ray through a
    voxel just above it meets the surface far behind, and only the pixel beside it tells how near the surface is.
    Neighbours that say nothing are left out. A pixel that says nothing itself is clear nowhere, unless the one above or
    below says something: then as far as `hole_depth_m`.

    Args:
        depth_m: (height, width).
        lowest_m: readings below it say nothing.
        limit_m: readings at or beyond it say "free up to here".
        margin_m: free space ends this far before a surface.
        noise_per_m: and as far again as the noise there: its standard deviation over the depth squared.
        hole_m: from `hole_depth_m`.
        clear: (height, width) room for the result.
    """
    height, width = depth_m.shape
    rows, columns = (height + TILE_PX - 1) // TILE_PX, (width + TILE_PX - 1) // TILE_PX
    least = np.full((LEVELS, rows, columns), np.inf, np.float32)
    most = np.zeros((LEVELS, rows, columns), np.float32)
    lowest, limit = np.float32(lowest_m), np.float32(limit_m)
    margin, noise = np.float32(margin_m), np.float32(noise_per_m)
    far, nothing, hole = np.float32(np.inf), np.float32(0.0), np.float32(hole_m)
    # The least of three rows, with one column of "far" on either side so that the second sweep has no borders; and the
    # least and the greatest of the rows of one tile, as wide as whole tiles.
    near = np.full(width + 2, far, np.float32)
    low = np.full(TILE_PX * columns, far, np.float32)
    high = np.zeros(TILE_PX * columns, np.float32)
    for v in range(height):
        above, here, below = depth_m[max(v - 1, 0)], depth_m[v], depth_m[min(v + 1, height - 1)]
        # Written as choices and not with min(), which would have to look for NaN: so it runs on the vector unit. A
        # comparison with NaN is false, so it counts as far, which is to say not at all.
        for u in range(width):
            d0, d1, d2 = above[u], here[u], below[u]
            d0 = d0 if d0 >= lowest else far
            d1 = d1 if d1 >= lowest else far
            d2 = d2 if d2 >= lowest else far
            d0 = min(d1, d0)
            near[u + 1] = min(d2, d0)
        row = clear[v]
        for u in range(width):
            d0, d1, d2 = near[u], near[u + 1], near[u + 2]
            in_hole = hole if d1 < far else nothing
            d0 = min(d1, d0)
            d0 = min(d2, d0)
            free_m = d0 - margin - noise * d0 * d0
            free_m = max(nothing, free_m)
            free_m = free_m if d0 < limit else limit
            free_m = free_m if here[u] >= lowest else min(in_hole, free_m)
            row[u] = free_m
            low[u] = min(low[u], free_m)
            high[u] = max(high[u], free_m)
        if v % TILE_PX == TILE_PX - 1 or v == height - 1:
            _put_tiles(low, high, least[0, v // TILE_PX], most[0, v // TILE_PX])
    for level in range(1, LEVELS):
        _halve(least[level - 1], most[level - 1], least[level], most[level], level)
    return ClearDepth(clear.ravel(), least, most)


@compiled
def _put_tiles(
    low: NDArray[np.float32], high: NDArray[np.float32], least: NDArray[np.float32], most: NDArray[np.float32]
) -> None:
    """One row of the smallest tiles from the least and greatest of its columns, which are made ready for the next."""
    for column in range(least.shape[0]):
        for u in range(TILE_PX * column, TILE_PX * column + TILE_PX):
            least[column] = min(least[column], low[u])
            most[column] = max(most[column], high[u])
            low[u], high[u] = np.float32(np.inf), np.float32(0.0)


@compiled
def _halve(
    fine_least: NDArray[np.float32],
    fine_most: NDArray[np.float32],
    least: NDArray[np.float32],
    most: NDArray[np.float32],
    level: int,
) -> None:
    """Fill in one level of the pyramid from the one below it."""
    # What is beyond the border of the image is as in an empty tile, and there the arrays still are.
    rows, columns = least.shape
    for row in range((rows - 1 >> level - 1) + 1):
        for column in range((columns - 1 >> level - 1) + 1):
            low, high = fine_least[row, column], fine_most[row, column]
            r, c = row >> 1, column >> 1
            least[r, c] = min(least[r, c], low)
            most[r, c] = max(most[r, c], high)
