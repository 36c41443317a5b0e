"""Where voxels are kept: chunks of 16 x 16 x 16, found through a hash of their coordinates.

A voxel's value is its log-odds of being occupied in thousandths, or `NOTHING` where nothing was ever seen.

The chunk of a voxel is its integer coordinate shifted by four bits, its place there the four bits left, which is right
for negative coordinates too. Inside a chunk voxels are in Morton order: the bits of x, y and z take turns, z highest.
So the voxels of an aligned cube of 4 lie side by side and are one 64-bit word of a bit set, and those of a cube of 8
are eight words. It is OctoMap's order of children as well.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

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

WORDS = VOLUME // 64
"""64-bit words that hold one bit for each voxel of a chunk."""

NOTHING = np.int16(-32768)
"""Value of a voxel about which nothing is known."""

CHUNK_LIMIT = 2**20
"""Chunk coordinates stay in [-CHUNK_LIMIT, CHUNK_LIMIT): three of them fit into one int64 key."""

_EMPTY = -1
_GOLDEN = -7046029254386353131
"""2^64 divided by the golden ratio, as int64: spreads neighbouring keys over the table."""


class ChunkTable(NamedTuple):
    """The arrays of a chunk store, as the compiled functions take them.

    Attributes:
        keys: (2^k,) int64, the hash table: packed chunk coordinates, -1 where empty.
        rows: (2^k,) int32, the row that belongs to the key beside it.
        coords: (capacity, 3) int32, chunk coordinates of each row.
        values: (capacity, 4096) int16, voxels of each row, in Morton order.
        revisions: (capacity,) int64, the map's revision when the row last changed.
        size: (1,) int64, how many rows are in use.
    """

    keys: NDArray[np.int64]
    rows: NDArray[np.int32]
    coords: NDArray[np.int32]
    values: NDArray[np.int16]
    revisions: NDArray[np.int64]
    size: NDArray[np.int64]


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
def chunk_key(x: Integer, y: Integer, z: Integer) -> Integer:
    """One int64 for three chunk coordinates."""
    return ((x + CHUNK_LIMIT) << 42) | ((y + CHUNK_LIMIT) << 21) | (z + CHUNK_LIMIT)


@njit(cache=True, nogil=True)
def _slot(keys: NDArray[np.int64], key: Integer) -> int:
    """Where ``key`` is in the table, or the empty place where it belongs."""
    mask = keys.shape[0] - 1
    # Twice, because x is in the highest bits of the key, and one product carries bits only upwards.
    mixed = key * _GOLDEN
    mixed = (mixed ^ (mixed >> 32)) * _GOLDEN
    slot = int((mixed ^ (mixed >> 32)) & mask)
    while keys[slot] != key and keys[slot] != _EMPTY:
        slot = (slot + 1) & mask
    return slot


@njit(cache=True, nogil=True)
def row_of_key(keys: NDArray[np.int64], rows: NDArray[np.int32], key: Integer) -> int:
    """The row of the chunk with this key, or -1 when the map has none there."""
    slot = _slot(keys, key)
    return int(rows[slot]) if keys[slot] == key else -1


@njit(cache=True, nogil=True)
def find_row(table: ChunkTable, x: Integer, y: Integer, z: Integer) -> int:
    """The row of a chunk, or -1 when the map has none there."""
    return row_of_key(table.keys, table.rows, chunk_key(x, y, z))


@njit(cache=True, nogil=True)
def is_full(table: ChunkTable) -> bool:
    """Whether there is no room for another row: `doubled` makes it."""
    return bool(table.size[0] == table.coords.shape[0])


@njit(cache=True, nogil=True)
def add_row(table: ChunkTable, x: Integer, y: Integer, z: Integer) -> int:
    """A new row, wholly unknown, for a chunk that has none yet. The caller has made sure that there is room."""
    row = int(table.size[0])
    key = chunk_key(x, y, z)
    slot = _slot(table.keys, key)
    table.keys[slot] = key
    table.rows[slot] = row
    table.coords[row, 0] = x
    table.coords[row, 1] = y
    table.coords[row, 2] = z
    table.values[row, :] = NOTHING
    table.size[0] = row + 1
    return row


@njit(cache=True, nogil=True)
def _index_rows(table: ChunkTable) -> None:
    """Fill an empty hash table from the rows in use."""
    for row in range(table.size[0]):
        key = chunk_key(table.coords[row, 0], table.coords[row, 1], table.coords[row, 2])
        slot = _slot(table.keys, key)
        table.keys[slot] = key
        table.rows[slot] = row


def empty_table(capacity: int) -> ChunkTable:
    """A table with room for ``capacity`` chunks, a power of two. The hash table is at most a quarter full."""
    return ChunkTable(
        keys=np.full(4 * capacity, _EMPTY, np.int64),
        rows=np.zeros(4 * capacity, np.int32),
        coords=np.zeros((capacity, 3), np.int32),
        values=np.empty((capacity, VOLUME), np.int16),
        revisions=np.zeros(capacity, np.int64),
        size=np.zeros(1, np.int64),
    )


def doubled(table: ChunkTable) -> ChunkTable:
    """The same chunks in a table with twice the room."""
    size = int(table.size[0])
    bigger = empty_table(2 * table.coords.shape[0])
    bigger.coords[:size] = table.coords[:size]
    bigger.values[:size] = table.values[:size]
    bigger.revisions[:size] = table.revisions[:size]
    bigger.size[0] = size
    _index_rows(bigger)
    return bigger
