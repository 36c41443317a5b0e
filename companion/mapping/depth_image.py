"""What a depth image says about free space: for each pixel a depth up to which it is clear, and tiles of these."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray


class ClearDepth(NamedTuple):
    """Depth up to which each pixel has seen free space.

    Attributes:
        depth_m: (height * width,) float32, row by row, 0 where the pixel says nothing.
        tile_min_m: (rows, columns) float32, least clear depth in each tile; 0 when one of its pixels says nothing.
        tile_max_m: (rows, columns) float32, greatest clear depth in each tile.
        tile_px: edge of a tile, in px.
    """

    depth_m: NDArray[np.float32]
    tile_min_m: NDArray[np.float32]
    tile_max_m: NDArray[np.float32]
    tile_px: int


@njit(cache=True, nogil=True, error_model="numpy")
def clear_depth(
    depth_m: NDArray[np.float32],
    lowest_m: float,
    limit_m: float,
    margin_m: float,
    noise_per_m: float,
    clear: NDArray[np.float32],
) -> ClearDepth:
    """Depth up to which each pixel of a depth image has seen free space.

    A pixel counts with the least depth among its 3 x 3 neighbours: on a surface seen at a slant, the ray through a
    voxel just above it meets the surface far behind, and only the pixel beside it tells how near the surface is.
    Neighbours that say nothing are left out; a pixel that says nothing itself is clear nowhere.

    Args:
        depth_m: (height, width).
        lowest_m: readings below it say nothing.
        limit_m: readings at or beyond it say "free up to here".
        margin_m: free space ends this far before a surface.
        noise_per_m: and as far again as the noise there: its standard deviation over the depth squared.
        clear: (height, width) room for the result.
    """
    height, width = depth_m.shape
    tile_px = max(4, width // 40)
    rows, columns = (height + tile_px - 1) // tile_px, (width + tile_px - 1) // tile_px
    tile_min = np.full((rows, columns), np.inf, np.float32)
    tile_max = np.zeros((rows, columns), np.float32)
    lowest, limit = np.float32(lowest_m), np.float32(limit_m)
    margin, noise = np.float32(margin_m), np.float32(noise_per_m)
    far, nothing = np.float32(np.inf), np.float32(0.0)
    # The least of three rows, with one column of "far" on either side so that the second sweep has no borders.
    least = np.full(width + 2, far, np.float32)
    for v in range(height):
        above, below = max(v - 1, 0), min(v + 1, height - 1)
        for u in range(width):
            d0, d1, d2 = depth_m[above, u], depth_m[v, u], depth_m[below, u]
            # A comparison with NaN is false, so it counts as far, which is to say not at all.
            d0 = d0 if d0 >= lowest else far
            d1 = d1 if d1 >= lowest else far
            d2 = d2 if d2 >= lowest else far
            least[u + 1] = min(d0, min(d1, d2))
        for u in range(width):
            nearest = min(least[u], min(least[u + 1], least[u + 2]))
            free_m = nearest - margin - noise * nearest * nearest if nearest < limit else limit
            clear[v, u] = max(free_m, nothing) if depth_m[v, u] >= lowest else nothing
        row = v // tile_px
        for column in range(columns):
            low, high = tile_min[row, column], tile_max[row, column]
            for u in range(column * tile_px, min((column + 1) * tile_px, width)):
                low = min(low, clear[v, u])
                high = max(high, clear[v, u])
            tile_min[row, column] = low
            tile_max[row, column] = high
    return ClearDepth(clear.ravel(), tile_min, tile_max, tile_px)
