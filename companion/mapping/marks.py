"""First pass over a frame: which voxels hold the end of a ray.

End points are marked from the pixels and not from the voxel centres: on a surface seen at a slant the centres of a
third of the voxels that it passes through project to pixels which measured something else.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from companion.mapping.chunks import MASK, SHIFT, WORDS, place_of
from companion.mapping.view import Box, Rays


class Marks(NamedTuple):
    """The voxels hit in one frame.

    Attributes:
        slots: (chunks of the box,) int32 in (x, y, z) C order, row of each in ``bits``, -1 where nothing was hit.
        bits: (n, 64) uint64, one bit for each voxel of a chunk.
        pixels: (3,) int64, how many pixels hit something, saw only free space, said nothing.
    """

    slots: NDArray[np.int32]
    bits: NDArray[np.uint64]
    pixels: NDArray[np.int64]


@njit(cache=True, nogil=True, error_model="numpy")
def mark_hits(
    depth_m: NDArray[np.float32], rays: Rays, box: Box, chunks: NDArray[np.int32], places: NDArray[np.int32]
) -> Marks:
    """The voxels that hold the end point of some pixel of a depth image.

    Args:
        depth_m: (height, width).
        rays: from pixels to voxels.
        box: the chunks around what the camera could see.
        chunks: (height, width) room to work in.
        places: the same.
    """
    height, width = depth_m.shape
    clear = _end_points(depth_m, rays, box, chunks, places)
    slots = np.full(box.size_x * box.size_y * box.size_z, -1, np.int32)
    used, hit = _give_slots(chunks, slots)
    bits = np.zeros((used, WORDS), np.uint64)
    _set_bits(chunks, places, slots, bits)
    return Marks(slots, bits, np.array([hit, clear, height * width - hit - clear], np.int64))


@njit(cache=True, nogil=True, error_model="numpy")
def _end_points(
    depth_m: NDArray[np.float32], rays: Rays, box: Box, chunks: NDArray[np.int32], places: NDArray[np.int32]
) -> int:
    """Fill in the chunk of each pixel's end point, -1 where it has none, and the place in the chunk.

    There is no branch in here, so it runs on the processor's vector unit.

    Returns:
        How many pixels saw free space up to the limit.
    """
    height, width = depth_m.shape
    lowest, limit = np.float32(rays.lowest_m), np.float32(rays.limit_m)
    clear = 0
    for v in range(height):
        i_v, j_v, k_v = rays.i_d + v * rays.i_v, rays.j_d + v * rays.j_v, rays.k_d + v * rays.k_v
        for u in range(width):
            depth = depth_m[v, u]
            ends = (depth >= lowest) & (depth < limit)
            metres = depth if ends else np.float32(0.0)
            i = np.int32(rays.i_0 + metres * (i_v + u * rays.i_u))
            j = np.int32(rays.j_0 + metres * (j_v + u * rays.j_u))
            k = np.int32(rays.k_0 + metres * (k_v + u * rays.k_u))
            chunk = ((i >> SHIFT) * box.size_y + (j >> SHIFT)) * box.size_z + (k >> SHIFT)
            chunks[v, u] = chunk if ends else -1
            places[v, u] = place_of(i & MASK, j & MASK, k & MASK)
            clear += depth >= limit
    return clear


@njit(cache=True, nogil=True)
def _give_slots(chunks: NDArray[np.int32], slots: NDArray[np.int32]) -> tuple[int, int]:
    """Number the chunks that were hit; how many these are, and how many pixels hit something."""
    used, hit = 0, 0
    for chunk in chunks.flat:
        if chunk >= 0:
            hit += 1
            if slots[chunk] < 0:
                slots[chunk] = used
                used += 1
    return used, hit


@njit(cache=True, nogil=True)
def _set_bits(
    chunks: NDArray[np.int32], places: NDArray[np.int32], slots: NDArray[np.int32], bits: NDArray[np.uint64]
) -> None:
    for v in range(chunks.shape[0]):
        for u in range(chunks.shape[1]):
            chunk, place = chunks[v, u], places[v, u]
            if chunk >= 0:
                bits[slots[chunk], place >> 6] |= np.uint64(1) << np.uint64(place & 63)
