"""Where voxels are kept: each chunk is 64 bricks, and a brick whose voxels are all alike needs no memory of its own.

Space that was flown through soon is free with all certainty that a voxel can have, and what was never seen is unknown
throughout; so what needs memory is the surface, and a long tunnel costs what its walls cost.

A chunk has a code for each of its bricks: the number of the brick in the pool, or, below zero, the value that all of
its voxels share.
"""

from __future__ import annotations

from typing import NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled
from companion.mapping.voxels.chunks import (
    BRICK,
    EMPTY,
    NOTHING,
    WORDS,
    Integer,
    chunk_key,
    forget_key,
    row_of_key,
    slot_of,
)
from companion.mapping.voxels.growing_array import GrowingArray

CHUNKS, BRICKS, SPARE = 0, 1, 2
"""Places in `Table.used`."""

_PLACES = 4
"""Places in the hash table for each row: it is a quarter full at most."""

_ALIKE = -32769
"""Code and shared value add up to this: `NOTHING` becomes -1, the largest value -65536."""


class Table(NamedTuple):
    """The arrays of a store, as the compiled functions take them.

    Attributes:
        keys: (2^k,) int64, the hash table: packed chunk coordinates, `EMPTY` where there is none.
        rows: (2^k,) int32, the row that belongs to the key beside it.
        coords: (n, 3) int32, chunk coordinates of each row.
        codes: (n, 64) int32, where the voxels of its bricks are.
        revisions: (n,) int64, the map's revision when the row last changed.
        voxels: (m, 64) int16, the pool of bricks, each in Morton order.
        spare: (m,) int32, a stack of bricks that were given back.
        used: (3,) int64, rows in use, bricks taken from the pool so far, bricks on the stack.
    """

    keys: NDArray[np.int64]
    rows: NDArray[np.int32]
    coords: NDArray[np.int32]
    codes: NDArray[np.int32]
    revisions: NDArray[np.int64]
    voxels: NDArray[np.int16]
    spare: NDArray[np.int32]
    used: NDArray[np.int64]


@compiled
def code_of(value: Integer) -> int:
    """The code of a brick whose voxels all have this value."""
    return _ALIKE - int(value)


@compiled
def shared_value(code: Integer) -> int:
    """The value that all voxels of a brick have; its code is below zero."""
    return _ALIKE - int(code)


@compiled
def find_row(table: Table, x: Integer, y: Integer, z: Integer) -> int:
    """The row of a chunk, or -1 when the map has none there."""
    return row_of_key(table.keys, table.rows, chunk_key(x, y, z))


@compiled
def has_room(table: Table) -> bool:
    """Whether one more chunk fits, whatever it holds: `Store.grow` makes room."""
    left = table.voxels.shape[0] - table.used[BRICKS] + table.used[SPARE]
    return bool(table.used[CHUNKS] < table.coords.shape[0] and left >= WORDS)


@compiled
def next_row(table: Table, x: Integer, y: Integer, z: Integer) -> int:
    """A row for a chunk that has none, wholly unknown, not yet in the table: `keep_row` puts it there."""
    row = int(table.used[CHUNKS])
    table.coords[row, 0] = x
    table.coords[row, 1] = y
    table.coords[row, 2] = z
    table.codes[row, :] = code_of(NOTHING)
    table.revisions[row] = 0
    return row


@compiled
def keep_row(table: Table) -> None:
    """Put the row of the last `next_row` into the table."""
    row = int(table.used[CHUNKS])
    key = chunk_key(table.coords[row, 0], table.coords[row, 1], table.coords[row, 2])
    slot = slot_of(table.keys, key)
    table.keys[slot] = key
    table.rows[slot] = row
    table.used[CHUNKS] = row + 1


@compiled
def take_brick(spare: NDArray[np.int32], used: NDArray[np.int64]) -> int:
    """A brick of the pool; its voxels are whatever they were."""
    if used[SPARE]:
        used[SPARE] -= 1
        return int(spare[used[SPARE]])
    used[BRICKS] += 1
    return int(used[BRICKS] - 1)


@compiled
def give_back(spare: NDArray[np.int32], used: NDArray[np.int64], brick: Integer) -> None:
    """A brick is not needed any more."""
    spare[used[SPARE]] = brick
    used[SPARE] += 1


@compiled
def is_alike(values: NDArray[np.int16]) -> bool:
    """Whether all voxels of a brick have one value."""
    other = np.int16(0)
    for n in range(BRICK):
        other |= values[n] ^ values[0]
    return bool(other == 0)


@compiled
def store_brick(
    codes: NDArray[np.int32],
    voxels: NDArray[np.int16],
    spare: NDArray[np.int32],
    used: NDArray[np.int64],
    row: int,
    word: int,
    values: NDArray[np.int16],
) -> None:
    """Make ``values`` (64,) those of a brick; one whose voxels are all alike takes no memory.

    This and `load_brick` take the arrays of a `Table` one by one: handing over a tuple costs numba a count of
    references for each array in it, which is more than all the rest of a brick's update.
    """
    code = codes[row, word]
    # Seldom are the first and the last alike and those between them not.
    if values[0] == values[BRICK - 1] and is_alike(values):
        if code >= 0:
            give_back(spare, used, code)
        codes[row, word] = code_of(values[0])
        return
    if code < 0:
        code = take_brick(spare, used)
        codes[row, word] = code
    # An index without a sign: numba would look for negative ones with every voxel.
    brick = np.uint32(code)
    for n in range(BRICK):
        voxels[brick, n] = values[n]


@compiled
def load_brick(voxels: NDArray[np.int16], code: Integer, values: NDArray[np.int16]) -> None:
    """Fill in ``values`` (64,) with the voxels of a brick."""
    if code >= 0:
        brick = np.uint32(code)
        for n in range(BRICK):
            values[n] = voxels[brick, n]
    else:
        value = np.int16(shared_value(code))
        for n in range(BRICK):
            values[n] = value


@compiled
def load_rows(table: Table, rows: NDArray[np.int64]) -> NDArray[np.int16]:
    """(n, 4096) the voxels of the chunks in ``rows`` (n,), in Morton order; unknown for row -1."""
    values = np.full((rows.shape[0], WORDS * BRICK), NOTHING)
    codes, voxels = table.codes, table.voxels
    for number in range(rows.shape[0]):
        for word in range(WORDS if rows[number] >= 0 else 0):
            load_brick(voxels, codes[rows[number], word], values[number, BRICK * word : BRICK * word + BRICK])
    return values


@compiled
def find_rows(table: Table, chunks: NDArray[np.int32]) -> NDArray[np.int64]:
    """(n,) the row of each of ``chunks`` (n, 3), -1 where the map has none."""
    rows = np.empty(chunks.shape[0], np.int64)
    for number in range(chunks.shape[0]):
        rows[number] = find_row(table, chunks[number, 0], chunks[number, 1], chunks[number, 2])
    return rows


@compiled
def store_rows(table: Table, chunks: NDArray[np.int32], values: NDArray[np.int16], start: int, revision: int) -> int:
    """Make chunks what ``values`` (n, 4096) say from number ``start`` on, as far as there is room.

    Returns:
        The number of the chunk that did not find room, or n.
    """
    codes, voxels, spare, used = table.codes, table.voxels, table.spare, table.used
    for number in range(start, chunks.shape[0]):
        if not has_room(table):
            return number
        x, y, z = chunks[number, 0], chunks[number, 1], chunks[number, 2]
        row = find_row(table, x, y, z)
        if row < 0:
            row = next_row(table, x, y, z)
            keep_row(table)
        for word in range(WORDS):
            store_brick(codes, voxels, spare, used, row, word, values[number, BRICK * word : BRICK * word + BRICK])
        table.revisions[row] = revision
    return int(chunks.shape[0])


@compiled
def forget_rows(table: Table, chunks: NDArray[np.int32]) -> None:
    """Take those of ``chunks`` (n, 3) that the map has out of it. The last row moves to where a gap came to be."""
    for number in range(chunks.shape[0]):
        key = chunk_key(chunks[number, 0], chunks[number, 1], chunks[number, 2])
        row = row_of_key(table.keys, table.rows, key)
        if row < 0:
            continue
        for word in range(WORDS):
            if table.codes[row, word] >= 0:
                give_back(table.spare, table.used, table.codes[row, word])
        forget_key(table.keys, table.rows, key)
        last = int(table.used[CHUNKS]) - 1
        if row != last:
            table.coords[row] = table.coords[last]
            table.codes[row] = table.codes[last]
            table.revisions[row] = table.revisions[last]
            moved = chunk_key(table.coords[row, 0], table.coords[row, 1], table.coords[row, 2])
            table.rows[slot_of(table.keys, moved)] = row
        table.used[CHUNKS] = last


@compiled
def _index_rows(table: Table) -> None:
    """Fill an empty hash table from the rows in use."""
    for row in range(table.used[CHUNKS]):
        key = chunk_key(table.coords[row, 0], table.coords[row, 1], table.coords[row, 2])
        slot = slot_of(table.keys, key)
        table.keys[slot] = key
        table.rows[slot] = row


class Store:
    """A table that grows.

    Args:
        chunks: room for so many at first, a power of two.

    Attributes:
        table: for the compiled functions. Nobody else may keep it: `grow` makes a new one.
    """

    def __init__(self, chunks: int) -> None:
        self._coords = GrowingArray(chunks, (3,), np.int32)
        self._codes = GrowingArray(chunks, (WORDS,), np.int32)
        self._revisions = GrowingArray(chunks, (), np.int64)
        bricks = max(chunks * WORDS // 8, WORDS)
        self._voxels = GrowingArray(bricks, (BRICK,), np.int16)
        self._spare = GrowingArray(bricks, (), np.int32)
        self._used = np.zeros(3, np.int64)
        self.table = self._made()

    @property
    def chunks(self) -> int:
        """How many chunks there are."""
        return int(self._used[CHUNKS])

    @property
    def memory_bytes(self) -> int:
        """What has been written to: room that was never used costs nothing."""
        table = self.table
        chunk_bytes = sum(array[:1].nbytes for array in (table.coords, table.codes, table.revisions))
        brick_bytes = sum(array[:1].nbytes for array in (table.voxels, table.spare))
        hash_bytes = table.keys.nbytes + table.rows.nbytes
        return int(hash_bytes + chunk_bytes * self._used[CHUNKS] + brick_bytes * self._used[BRICKS])

    def grow(self) -> None:
        """Make room: at least for one chunk, whatever it holds.

        Raises:
            OSError: there is not so much memory.
        """
        grows_chunks = self.chunks == self._coords.rows
        grows_bricks = self._voxels.rows - self._used[BRICKS] + self._used[SPARE] < WORDS
        keys, rows = self.table.keys, self.table.rows
        del self.table
        try:
            # Those by whose length `has_room` judges come last: when memory ends halfway, nothing has changed for it.
            for array in (self._codes, self._revisions, self._coords) if grows_chunks else ():
                array.grow(2 * self.chunks)
            for array in (self._spare, self._voxels) if grows_bricks else ():
                array.grow(2 * self._voxels.rows)
        finally:
            self.table = self._made(keys, rows) if len(keys) == _PLACES * self._coords.rows else self._made()

    def _made(self, keys: NDArray[np.int64] | None = None, rows: NDArray[np.int32] | None = None) -> Table:
        places = _PLACES * self._coords.rows
        table = Table(
            keys=np.full(places, EMPTY, np.int64) if keys is None else keys,
            rows=np.zeros(places, np.int32) if rows is None else rows,
            coords=cast("NDArray[np.int32]", self._coords.array),
            codes=cast("NDArray[np.int32]", self._codes.array),
            revisions=cast("NDArray[np.int64]", self._revisions.array),
            voxels=cast("NDArray[np.int16]", self._voxels.array),
            spare=cast("NDArray[np.int32]", self._spare.array),
            used=self._used,
        )
        if keys is None:
            _index_rows(table)
        return table
