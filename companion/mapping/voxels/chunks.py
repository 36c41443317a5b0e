"""Where a voxel is: chunks of 16 x 16 x 16 voxels, bricks of 4 x 4 x 4, and a hash of the chunks' coordinates.

A voxel's value is its log-odds of being occupied in thousandths, or `NOTHING` where nothing was ever seen.

The chunk of a voxel is its integer coordinate shifted by four bits, its place there the four bits left, which is right
for negative coordinates too. Inside a chunk voxels are in Morton order: the bits of x, y and z take turns, z highest.
So the voxels of an aligned cube of 4, a brick, lie side by side and are one 64-bit word of a bit set, and those of a
cube of 8 are eight bricks. It is OctoMap's order of children as well.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled

Integer = int | np.integer[Any]
"""What compiled functions take as an integer, whoever calls them."""

EDGE = 16
"""Voxels along one edge of a chunk."""

SHIFT = 4
"""A voxel coordinate shifted right by this is its chunk's coordinate."""

MASK = EDGE - 1
"""The bits of a voxel coordinate that are its place in the chunk."""

VOLUME = EDGE**3
"""Voxels of a chunk."""

BRICK = 64
"""Voxels of a brick."""

WORDS = VOLUME // BRICK
"""Bricks of a chunk, and 64-bit words that hold one bit for each of its voxels."""

NOTHING = np.int16(-32768)
"""Value of a voxel about which nothing is known."""

CHUNK_LIMIT = 2**20
"""Chunk coordinates stay in [-CHUNK_LIMIT, CHUNK_LIMIT): three of them fit into one int64 key."""

EMPTY = -1
"""Key of an empty place in the hash."""

_GOLDEN = -7046029254386353131
"""2^64 divided by the golden ratio, as int64: spreads neighbouring keys over the table."""


@compiled
def place_of(x: Integer, y: Integer, z: Integer) -> Integer:
    """Place in the chunk of the voxel whose coordinates there, each in [0, 16), are x, y, z."""
    x = (x | x << 4) & 0x0C3
    y = (y | y << 4) & 0x0C3
    z = (z | z << 4) & 0x0C3
    x = (x | x << 2) & 0x249
    y = (y | y << 2) & 0x249
    z = (z | z << 2) & 0x249
    return x | y << 1 | z << 2


def _offsets() -> NDArray[np.int16]:
    offsets = np.empty((VOLUME, 3), np.int16)
    for x, y, z in np.ndindex(EDGE, EDGE, EDGE):
        offsets[place_of.py_func(x, y, z)] = x, y, z
    return offsets


OFFSETS = _offsets()
"""(4096, 3) coordinates in its chunk of the voxel at each place: the inverse of `place_of`."""


@compiled
def chunk_key(x: Integer, y: Integer, z: Integer) -> Integer:
    """One int64 for three chunk coordinates."""
    return ((x + CHUNK_LIMIT) << 42) | ((y + CHUNK_LIMIT) << 21) | (z + CHUNK_LIMIT)


@compiled
def home_of(keys: NDArray[np.int64], key: Integer) -> int:
    """Where in the hash table, whose size is a power of two, the search for a key begins."""
    # Twice, because x is in the highest bits of the key, and one product carries bits only upwards.
    mixed = key * _GOLDEN
    mixed = (mixed ^ (mixed >> 32)) * _GOLDEN
    return int((mixed ^ (mixed >> 32)) & (keys.shape[0] - 1))


@compiled
def slot_of(keys: NDArray[np.int64], key: Integer) -> int:
    """Where ``key`` is in the table, or the empty place where it belongs."""
    mask = keys.shape[0] - 1
    slot = home_of(keys, key)
    while keys[slot] != key and keys[slot] != EMPTY:
        slot = (slot + 1) & mask
    return slot


@compiled
def row_of_key(keys: NDArray[np.int64], rows: NDArray[np.int32], key: Integer) -> int:
    """The row of the chunk with this key, or -1 when the map has none there."""
    slot = slot_of(keys, key)
    return int(rows[slot]) if keys[slot] == key else -1


@compiled
def forget_key(keys: NDArray[np.int64], rows: NDArray[np.int32], key: Integer) -> None:
    """Take a key that is there out of the table, and close the gap: those behind it move up to where they belong."""
    mask = keys.shape[0] - 1
    gap = slot_of(keys, key)
    slot = (gap + 1) & mask
    while keys[slot] != EMPTY:
        home = home_of(keys, keys[slot])
        if (slot - home) & mask >= (slot - gap) & mask:
            keys[gap], rows[gap] = keys[slot], rows[slot]
            gap = slot
        slot = (slot + 1) & mask
    keys[gap] = EMPTY
