"""Second pass over a frame: what the camera looked through.

Blocks of voxels are judged as a whole before their voxels are: a chunk, its eighths, and their bricks. A block behind
the surface or outside the image is left alone, one that is clear everywhere needs no look at its voxels.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled, compiled_unchecked
from companion.mapping.voxels.chunks import BRICK, OFFSETS
from companion.mapping.voxels.depth_image import LEVELS, TILE_PX
from companion.mapping.voxels.view import Projection

UNSEEN, CLEAR, MIXED = 0, 1, 2
"""What is known of all the voxels of a block: none is looked through; all are; neither is sure."""

_NEARLY_ZERO_M = 1e-6


@compiled_unchecked
def judge(
    least_m: NDArray[np.float32], most_m: NDArray[np.float32], p: Projection, i: int, j: int, k: int, edge: int
) -> int:
    """Whether the voxel centres of a block are all looked through, or none is, or neither is sure.

    The block is the cube of ``edge`` voxels whose lowest voxel is (i, j, k) of the box. Its extent along each camera
    axis is exact, its outline in the image is a rectangle around it, and that is widened to whole tiles.

    ``least_m`` and ``most_m`` are those of `ClearDepth`: a tuple with arrays would cost more than the rest, see
    `chunk_table.store_brick`.
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
    left, right_most = int(max(left_u, 0.0)), int(min(right_u, p.width - 1.0))
    upper, lower = int(max(upper_v, 0.0)), int(min(lower_v, p.height - 1.0))
    # The level at which it covers three tiles at most along either side.
    level, tile = 0, TILE_PX
    extent = max(right_most - left, lower - upper)
    while 2 * tile < extent and level < LEVELS - 1:
        level, tile = level + 1, 2 * tile
    most, least = np.float32(0.0), np.float32(np.inf)
    for row in range(upper // tile, lower // tile + 1):
        for column in range(left // tile, right_most // tile + 1):
            # Indices without a sign: numba would look for negative ones.
            at = np.uint32(level), np.uint32(row), np.uint32(column)
            most, least = max(most, most_m[at]), min(least, least_m[at])
    if nearest >= most:
        return UNSEEN
    return CLEAR if inside and farthest < least else MIXED


@compiled
def offsets_of(p: Projection) -> NDArray[np.float32]:
    """(3, 64) what is added to depth, right and down of a brick's lowest voxel for each of its voxels."""
    x, y, z = OFFSETS[:BRICK, 0], OFFSETS[:BRICK, 1], OFFSETS[:BRICK, 2]
    offsets = np.empty((3, BRICK), np.float32)
    offsets[0] = x * p.depth_i + y * p.depth_j + z * p.depth_k
    offsets[1] = x * p.right_i + y * p.right_j + z * p.right_k
    offsets[2] = x * p.down_i + y * p.down_j + z * p.down_k
    return offsets


@compiled_unchecked
def look_through(
    clear_m: NDArray[np.float32],
    p: Projection,
    offsets: NDArray[np.float32],
    i: int,
    j: int,
    k: int,
    pixels: NDArray[np.int32],
    depths_m: NDArray[np.float32],
    seen: NDArray[np.int16],
) -> None:
    """Which voxels of the brick whose lowest voxel is (i, j, k) of the box the camera looked through, at their centres.

    Projection and comparison are loops of their own without a branch and in 32 bits, so that they run on the vector
    unit. Only the place of the brick is worked out in more.

    ``clear_m`` (height * width,) is as in `ClearDepth`, ``offsets`` from `offsets_of`. ``seen`` (64,) becomes 1 for a
    voxel that was looked through, else 0; ``pixels`` and ``depths_m`` (64,) are room to work in.
    """
    depth_0 = np.float32(p.depth_0 + i * p.depth_i + j * p.depth_j + k * p.depth_k)
    right_0 = np.float32(p.right_0 + i * p.right_i + j * p.right_j + k * p.right_k)
    down_0 = np.float32(p.down_0 + i * p.down_i + j * p.down_j + k * p.down_k)
    edge_u, edge_v, width, height = (
        np.float32(p.edge_u),
        np.float32(p.edge_v),
        np.float32(p.width),
        np.float32(p.height),
    )
    zero, one, never, row_px = np.float32(0.0), np.float32(1.0), np.float32(np.inf), np.int32(p.width)
    for n in range(BRICK):
        depth = depth_0 + offsets[0, n]
        scale = one / depth
        u, v = edge_u + (right_0 + offsets[1, n]) * scale, edge_v + (down_0 + offsets[2, n]) * scale
        inside = (depth > zero) & (u >= zero) & (v >= zero) & (u < width) & (v < height)
        pixels[n] = np.int32(v if inside else zero) * row_px + np.int32(u if inside else zero)
        depths_m[n] = depth if inside else never
    for n in range(BRICK):
        seen[n] = depths_m[n] < clear_m[np.uint32(pixels[n])]
