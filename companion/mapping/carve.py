"""Second pass over a frame: which voxels of a chunk the camera looked through.

Blocks of voxels are judged as a whole before their voxels are: a chunk, and then its eighths, which are cubes of 8. A
block behind the surface or outside the image is left alone, one that is clear everywhere needs no look at its voxels.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from companion.mapping.chunks import EDGE, OFFSETS
from companion.mapping.depth_image import ClearDepth
from companion.mapping.view import Projection

UNSEEN, CLEAR, MIXED = 0, 1, 2
"""What is known of all the voxels of a block: none is looked through; all are; neither is sure."""

_NEARLY_ZERO_M = 1e-6

_CUBE_VOLUME = 8**3

_ALL = np.uint64(0xFFFFFFFFFFFFFFFF)


@njit(cache=True, nogil=True, error_model="numpy")
def judge(clear: ClearDepth, p: Projection, i: int, j: int, k: int, edge: int) -> int:
    """Whether the voxel centres of a block are all looked through, or none is, or neither is sure.

    The block is the cube of ``edge`` voxels whose lowest voxel is (i, j, k) of the box. Its extent along each camera
    axis is exact, its outline in the image is a rectangle around it, and that is widened to whole tiles.
    """
    half = 0.5 * (edge - 1)
    x, y, z = i + half, j + half, k + half
    depth = p.depth_0 + x * p.depth_i + y * p.depth_j + z * p.depth_k
    reach = half * (abs(p.depth_i) + abs(p.depth_j) + abs(p.depth_k))
    nearest, farthest = depth - reach, depth + reach
    if farthest <= 0.0 or nearest >= p.limit_m:
        return UNSEEN
    # A voxel at or behind the camera's own plane is never seen, so only the part of the block before it counts.
    inner, outer = 1.0 / farthest, 1.0 / max(nearest, _NEARLY_ZERO_M)
    right = p.right_0 + x * p.right_i + y * p.right_j + z * p.right_k
    reach = half * (abs(p.right_i) + abs(p.right_j) + abs(p.right_k))
    low, high = right - reach, right + reach
    left_u = p.edge_u + low * (outer if low < 0.0 else inner)
    right_u = p.edge_u + high * (inner if high < 0.0 else outer)
    if right_u < 0.0 or left_u >= p.width:
        return UNSEEN
    down = p.down_0 + x * p.down_i + y * p.down_j + z * p.down_k
    reach = half * (abs(p.down_i) + abs(p.down_j) + abs(p.down_k))
    low, high = down - reach, down + reach
    upper_v = p.edge_v + low * (outer if low < 0.0 else inner)
    lower_v = p.edge_v + high * (inner if high < 0.0 else outer)
    if lower_v < 0.0 or upper_v >= p.height:
        return UNSEEN
    inside = nearest > 0.0 and left_u >= 0.0 and upper_v >= 0.0 and right_u < p.width and lower_v < p.height
    column_0, column_1 = int(max(left_u, 0.0)) // clear.tile_px, int(min(right_u, p.width - 1.0)) // clear.tile_px
    row_0, row_1 = int(max(upper_v, 0.0)) // clear.tile_px, int(min(lower_v, p.height - 1.0)) // clear.tile_px
    most, least = np.float32(0.0), np.float32(np.inf)
    for row in range(row_0, row_1 + 1):
        for column in range(column_0, column_1 + 1):
            most = max(most, clear.tile_max_m[row, column])
            least = min(least, clear.tile_min_m[row, column])
    if nearest >= most:
        return UNSEEN
    return CLEAR if inside and farthest < least else MIXED


class Cube(NamedTuple):
    """The 512 voxels of a cube of 8 in Morton order: where they are from its lowest one, and room to work in.

    Attributes:
        depth_m: (512,) float64, added to the depth of the lowest voxel.
        right: (512,) float64, the same for depth times (u - cx).
        down: (512,) float64, the same for depth times (v - cy).
        pixels: (512,) int32, the pixel that each voxel was last projected to, counted row by row.
        depths_m: (512,) float32, its depth then; infinite outside the image.
    """

    depth_m: NDArray[np.float64]
    right: NDArray[np.float64]
    down: NDArray[np.float64]
    pixels: NDArray[np.int32]
    depths_m: NDArray[np.float32]


@njit(cache=True, nogil=True)
def cube_of(p: Projection) -> Cube:
    """The cube of 8 as one camera position sees it."""
    x, y, z = OFFSETS[:_CUBE_VOLUME, 0], OFFSETS[:_CUBE_VOLUME, 1], OFFSETS[:_CUBE_VOLUME, 2]
    return Cube(
        x * p.depth_i + y * p.depth_j + z * p.depth_k,
        x * p.right_i + y * p.right_j + z * p.right_k,
        x * p.down_i + y * p.down_j + z * p.down_k,
        np.empty(_CUBE_VOLUME, np.int32),
        np.empty(_CUBE_VOLUME, np.float32),
    )


@njit(cache=True, nogil=True, error_model="numpy")
def carve_chunk(
    clear: ClearDepth, p: Projection, cube: Cube, i: int, j: int, k: int, verdict: int, seen: NDArray[np.uint64]
) -> None:
    """Fill in ``seen`` (64,): one bit for each voxel of a chunk, set where the camera looked through its centre.

    Args:
        clear: depth up to which each pixel has seen free space.
        p: from voxels to pixels.
        cube: from `cube_of`.
        i: lowest voxel of the chunk, in the box.
        j: the same along y.
        k: the same along z.
        verdict: what `judge` said of the whole chunk.
        seen: is overwritten.
    """
    seen[:] = _ALL if verdict == CLEAR else np.uint64(0)
    if verdict != MIXED:
        return
    for eighth in range(8):
        x, y, z = i + 8 * (eighth & 1), j + 4 * (eighth & 2), k + 2 * (eighth & 4)
        judged = judge(clear, p, x, y, z, EDGE // 2)
        if judged == CLEAR:
            seen[8 * eighth : 8 * eighth + 8] = _ALL
        elif judged == MIXED:
            _project(p, cube, x, y, z)
            _compare(clear, cube, seen, 8 * eighth)


@njit(cache=True, nogil=True, error_model="numpy")
def _project(p: Projection, cube: Cube, i: int, j: int, k: int) -> None:
    """Fill in the pixels and depths of the cube at (i, j, k). Has no branch, so that it runs on the vector unit."""
    depth_0 = p.depth_0 + i * p.depth_i + j * p.depth_j + k * p.depth_k
    right_0 = p.right_0 + i * p.right_i + j * p.right_j + k * p.right_k
    down_0 = p.down_0 + i * p.down_i + j * p.down_j + k * p.down_k
    offset_m, right, down, pixels, depths_m = cube
    edge_u, edge_v, width, height = p.edge_u, p.edge_v, p.width, p.height
    for n in range(_CUBE_VOLUME):
        depth = depth_0 + offset_m[n]
        scale = 1.0 / depth
        u, v = edge_u + (right_0 + right[n]) * scale, edge_v + (down_0 + down[n]) * scale
        inside = (depth > 0.0) & (u >= 0.0) & (v >= 0.0) & (u < width) & (v < height)
        pixels[n] = np.int32(v if inside else 0.0) * np.int32(width) + np.int32(u if inside else 0.0)
        depths_m[n] = np.float32(depth if inside else np.inf)


@njit(cache=True, nogil=True)
def _compare(clear: ClearDepth, cube: Cube, seen: NDArray[np.uint64], word: int) -> None:
    """Fill in the eight words of the cube from ``word`` on: whether each voxel's pixel is clear beyond it."""
    clear_m, pixels, depths_m = clear.depth_m, cube.pixels, cube.depths_m
    for part in range(8):
        bits = np.uint64(0)
        for n in range(64):
            bits |= np.uint64(depths_m[64 * part + n] < clear_m[pixels[64 * part + n]]) << np.uint64(n)
        seen[word + part] = bits
