"""Where a voxel is: chunks of 16 x 16 x 16 voxels, bricks of 4 x 4 x 4, and a hash of the chunks' coordinates.

A voxel's value is its log-odds of being occupied in thousandths, or `NOTHING` where nothing was ever seen.

The chunk of a voxel is its integer coordinate shifted by four bits, its place there the four bits left, which is right
for negative coordinates too. Inside a chunk voxels are in Morton order: the bits of x, y and z take turns, z highest.
So the voxels of an aligned cube of 4, a brick, lie side by side and are one 64-bit word of a bit set, and those of a
cube of 8 are eight bricks. It is OctoMap's order of children as well.
"""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled, inner

Number = TypeVar("Number", bound=np.generic)
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


PLACES = np.asarray(place_of.py_func(*np.indices((EDGE, EDGE, EDGE))), np.int16)
"""(16, 16, 16) the place in its chunk of the voxel with these coordinates there: `place_of` as a table."""

OFFSETS = np.stack(np.unravel_index(np.argsort(PLACES, axis=None), PLACES.shape), axis=1).astype(np.int16)
"""(4096, 3) coordinates in its chunk of the voxel at each place: the inverse of `place_of`."""


@compiled
def chunk_key(x: Integer, y: Integer, z: Integer) -> Integer:
    """One int64 for three chunk coordinates."""
    return ((x + CHUNK_LIMIT) << 42) | ((y + CHUNK_LIMIT) << 21) | (z + CHUNK_LIMIT)


def keys_of(chunks: NDArray[np.int32]) -> NDArray[np.int64]:
    """(...) keys of ``chunks`` (..., 3)."""
    return np.asarray(chunk_key.py_func(*np.moveaxis(chunks.astype(np.int64), -1, 0)))


def chunks_of(keys: NDArray[np.int64]) -> NDArray[np.int32]:
    """(n, 3) the chunks of these ``keys`` (n,): the inverse of `keys_of`."""
    part = 2 * CHUNK_LIMIT - 1
    return (np.stack([keys >> 42, keys >> 21 & part, keys & part], axis=-1) - CHUNK_LIMIT).astype(np.int32)


def plain(array: NDArray[Any], dtype: type[Number]) -> NDArray[Number]:
    """The same numbers as compiled functions know them: for any other layout they would be compiled anew, in flight."""
    return np.require(array, dtype, ["C", "A", "W"])


@inner
def bits_in(word: np.uint64) -> int:
    """How many bits of ``word`` are set."""
    word = word - (word >> np.uint64(1) & np.uint64(0x5555555555555555))
    word = (word & np.uint64(0x3333333333333333)) + (word >> np.uint64(2) & np.uint64(0x3333333333333333))
    word = (word + (word >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return np.int64(word * np.uint64(0x0101010101010101) >> np.uint64(56))  # type: ignore[return-value]


@compiled
def home_of(mask: int, key: Integer) -> int:
    """Where in the hash table, whose size is a power of two and ``mask`` + 1, the search for a key begins."""
    # Twice, because x is in the highest bits of the key, and one product carries bits only upwards.
    mixed = key * _GOLDEN
    mixed = (mixed ^ (mixed >> 32)) * _GOLDEN
    return int((mixed ^ (mixed >> 32)) & mask)


@compiled
def slot_of(keys: NDArray[np.int64], key: Integer) -> int:
    """Where ``key`` is in the table, or the empty place where it belongs."""
    mask = keys.shape[0] - 1
    slot = home_of(mask, key)
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
        home = home_of(mask, keys[slot])
        if (slot - home) & mask >= (slot - gap) & mask:
            keys[gap], rows[gap] = keys[slot], rows[slot]
            gap = slot
        slot = (slot + 1) & mask
    keys[gap] = EMPTY
