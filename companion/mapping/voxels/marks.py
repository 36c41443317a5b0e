"""First pass over a frame: which voxels hold the end of a ray.

End points are marked from the pixels and not from the voxel centres: on a surface seen at a slant the centres of a
third of the voxels that it passes through project to pixels which measured something else.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled, compiled_unchecked
from companion.mapping.voxels.chunks import EDGE, MASK, SHIFT, VOLUME, WORDS, place_of
from companion.mapping.voxels.view import Box, Rays

_PLACE_BITS = 3 * SHIFT


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


class Room(NamedTuple):
    """Room for two rows of pixels.

    Attributes:
        i: (2, width) int32, voxel of each end point along x of the box, -1 where there is none.
        j: (2, width) int32, along y.
        k: (2, width) int32, along z.
        alone: (width,) int8, 1 where the voxel is another than that of the pixels to the left and above.
        picked: (width + 1,) int32, the pixels that are alone.
    """

    i: NDArray[np.int32]
    j: NDArray[np.int32]
    k: NDArray[np.int32]
    alone: NDArray[np.int8]
    picked: NDArray[np.int32]


class Places(NamedTuple):
    """Of each voxel coordinate in the box, its part in the sum 4096 chunk + place; that of the chunk is its number.

    Attributes:
        x: (voxels along x,) int64.
        y: (voxels along y,) int64.
        z: (voxels along z,) int64.
    """

    x: NDArray[np.int64]
    y: NDArray[np.int64]
    z: NDArray[np.int64]


@compiled_unchecked
def mark_hits(depth_m: NDArray[np.float32], rays: Rays, box: Box) -> Marks:
    """The voxels that hold the end point of some pixel of a depth image.

    Args:
        depth_m: (height, width).
        rays: from pixels to voxels.
        box: the chunks around what the camera could see.
    """
    height, width = depth_m.shape
    slots = np.full(box.size_x * box.size_y * box.size_z, -1, np.int32)
    bits = np.zeros((width, WORDS), np.uint64)
    voxels = np.full((3, 2, width), -1, np.int32)
    room = Room(voxels[0], voxels[1], voxels[2], np.zeros(width, np.int8), np.empty(width + 1, np.int32))
    places = _places(box)
    used, hit, clear = 0, 0, 0
    for v in range(height):
        row_hit, row_clear = _end_points(depth_m[v], v, rays, room)
        hit += row_hit
        clear += row_clear
        if row_hit:
            if bits.shape[0] < used + min(row_hit, slots.shape[0] - used):
                bits = doubled(bits)
            used = _set_bits(room, v, _pick(room, v), places, slots, bits, used)
    return Marks(slots, bits, np.array([hit, clear, height * width - hit - clear], np.int64))


@compiled
def doubled(bits: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """The same bits (n, 64) with room for as many again, all zero."""
    more = np.zeros((2 * bits.shape[0], WORDS), np.uint64)
    more[: bits.shape[0]] = bits
    return more


@compiled
def _places(box: Box) -> Places:
    x, y, z = np.arange(EDGE * box.size_x), np.arange(EDGE * box.size_y), np.arange(EDGE * box.size_z)
    for i in range(x.shape[0]):
        x[i] = (i >> SHIFT) * box.size_y * box.size_z * VOLUME + place_of(i & MASK, 0, 0)
    for j in range(y.shape[0]):
        y[j] = (j >> SHIFT) * box.size_z * VOLUME + place_of(0, j & MASK, 0)
    for k in range(z.shape[0]):
        z[k] = (k >> SHIFT) * VOLUME + place_of(0, 0, k & MASK)
    return Places(x, y, z)


@compiled_unchecked
def _end_points(depths_m: NDArray[np.float32], v: int, rays: Rays, room: Room) -> tuple[int, int]:
    """Fill in the voxels of the end points of a row of pixels.

    There is no branch in here and all is of 32 bits, so it runs on the processor's vector unit. A depth has no more
    bits either.

    Returns:
        How many pixels hit something, and how many saw free space up to the limit.
    """
    lowest, limit = np.float32(rays.lowest_m), np.float32(rays.limit_m)
    i_0, j_0, k_0 = np.float32(rays.i_0), np.float32(rays.j_0), np.float32(rays.k_0)
    i_u, j_u, k_u = np.float32(rays.i_u), np.float32(rays.j_u), np.float32(rays.k_u)
    i_v, j_v, k_v = (
        np.float32(rays.i_d + v * rays.i_v),
        np.float32(rays.j_d + v * rays.j_v),
        np.float32(rays.k_d + v * rays.k_v),
    )
    is_, js, ks = room.i[v & 1], room.j[v & 1], room.k[v & 1]
    hit, clear = 0, 0
    for u in range(depths_m.shape[0]):
        depth, column = depths_m[u], np.float32(np.int32(u))
        ends = (depth >= lowest) & (depth < limit)
        metres = depth if ends else np.float32(0.0)
        is_[u] = np.int32(i_0 + metres * (i_v + column * i_u)) if ends else np.int32(-1)
        js[u] = np.int32(j_0 + metres * (j_v + column * j_u))
        ks[u] = np.int32(k_0 + metres * (k_v + column * k_u))
    for u in range(depths_m.shape[0]):
        hit += is_[u] >= 0
        clear += depths_m[u] >= limit
    return hit, clear


@compiled
def _pick(room: Room, v: int) -> int:
    """Fill in the pixels with an end point in another voxel than those to the left and above; how many these are.

    Most end in the same. There is no branch in here: with noise the processor could not foresee it.
    """
    is_, js, ks, alone, picked = room
    here, above = v & 1, ~v & 1
    width = alone.shape[0]
    for u in range(width):
        ends, i, j, k = is_[here, u] >= 0, is_[here, u], js[here, u], ks[here, u]
        alone[u] = np.int8(ends & ((i != is_[above, u]) | (j != js[above, u]) | (k != ks[above, u])))
    for u in range(1, width):
        i, j, k = is_[here, u], js[here, u], ks[here, u]
        alone[u] &= np.int8((i != is_[here, u - 1]) | (j != js[here, u - 1]) | (k != ks[here, u - 1]))
    count = 0
    for u in range(width):
        picked[count] = u
        count += alone[u]
    return count


@compiled
def _set_bits(
    room: Room, v: int, count: int, places: Places, slots: NDArray[np.int32], bits: NDArray[np.uint64], used: int
) -> int:
    """Mark the voxels of the picked pixels; how many slots are in use then."""
    is_, js, ks, picked = room.i[v & 1], room.j[v & 1], room.k[v & 1], room.picked
    of_x, of_y, of_z = places
    for n in range(count):
        u = np.uint32(picked[n])
        code = of_x[np.uint32(is_[u])] + of_y[np.uint32(js[u])] + of_z[np.uint32(ks[u])]
        chunk = np.uint64(code >> _PLACE_BITS)
        slot = slots[chunk]
        if slot < 0:
            slot, used = np.int32(used), used + 1
            slots[chunk] = slot
        bits[np.uint32(slot), np.uint64(code >> 6 & (WORDS - 1))] |= np.uint64(1) << np.uint64(code & 63)
    return used
