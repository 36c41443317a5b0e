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
    min_depth_m: float,
    max_depth_m: float,
    margin_m: float,
    noise_per_m: float,
) -> ClearDepth:
    """Depth up to which each pixel of ``depth_m`` has seen free space.

    A pixel counts with the least depth of its 3 x 3 neighbours: on a surface seen at a slant, the ray through a voxel
    just above it meets the surface far behind, and only the pixel beside it tells how near the surface is.
    """
    height, width = depth_m.shape
    tile_px = max(4, width // 40)
    rows, columns = (height + tile_px - 1) // tile_px, (width + tile_px - 1) // tile_px
    clear = np.empty((height, width), np.float32)
    tile_min = np.full((rows, columns), np.inf, np.float32)
    tile_max = np.zeros((rows, columns), np.float32)
    lowest = np.float32(min_depth_m)
    limit = np.float32(max_depth_m)
    margin = np.float32(margin_m)
    noise = np.float32(noise_per_m)
    far = np.float32(np.inf)
    nothing = np.float32(0.0)
    # Least depth over three rows, with one column of "far" on either side so that the second pass has no borders.
    least = np.full(width + 2, far, np.float32)
    for v in range(height):
        above, below = max(v - 1, 0), min(v + 1, height - 1)
        for u in range(width):
            d0, d1, d2 = depth_m[above, u], depth_m[v, u], depth_m[below, u]
            # A comparison with NaN is false: such a pixel counts as far, which is to say not at all.
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
            lo, hi = tile_min[row, column], tile_max[row, column]
            for u in range(column * tile_px, min((column + 1) * tile_px, width)):
                lo = min(lo, clear[v, u])
                hi = max(hi, clear[v, u])
            tile_min[row, column] = lo
            tile_max[row, column] = hi
    return ClearDepth(clear.ravel(), tile_min, tile_max, tile_px)
