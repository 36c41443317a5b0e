"""A compact table of chunks: a few whole numbers for each, found by the chunk's key."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled
from companion.mapping.voxels.chunks import CHUNK_LIMIT, EMPTY, chunk_key, row_of_key, slot_of

Number = TypeVar("Number", bound=np.generic)

_FIRST_ROWS = 256
_PART = (1 << 21) - 1


def keys_of(chunks: NDArray[np.int32]) -> NDArray[np.int64]:
    """(n,) keys of ``chunks`` (n, 3)."""
    return np.asarray(_keys_of(plain(chunks, np.int32)))


def plain(array: NDArray[Number], dtype: type[Number]) -> NDArray[Number]:
    """The same numbers as compiled functions know them: for any other layout they would be compiled anew, in flight."""
    return np.require(array, dtype, ["C", "A", "W"])


@compiled
def _keys_of(chunks: NDArray[np.int32]) -> NDArray[np.int64]:
    keys = np.empty(chunks.shape[0], np.int64)
    for n in range(chunks.shape[0]):
        keys[n] = chunk_key(np.int64(chunks[n, 0]), np.int64(chunks[n, 1]), np.int64(chunks[n, 2]))
    return keys


def key_of(chunk: tuple[int, int, int]) -> int:
    """The key of one chunk."""
    return int(chunk_key.py_func(*chunk))


def chunks_of(keys: NDArray[np.int64]) -> NDArray[np.int32]:
    """(n, 3) the chunks of these ``keys`` (n,): the inverse of `keys_of`."""
    parts = keys >> 42, (keys >> 21) & _PART, keys & _PART
    return (np.stack(parts, axis=-1) - CHUNK_LIMIT).astype(np.int32)


class ChunkRows:
    """Numbers for each chunk of a map. Chunks are only ever added.

    Args:
        columns: how many numbers each chunk has; they are 0 at first.
    """

    def __init__(self, columns: int) -> None:
        self._size = 0
        self._keys = np.zeros(_FIRST_ROWS, np.int64)
        self._columns = np.zeros((columns, _FIRST_ROWS), np.int64)
        self._hash_again()

    def __len__(self) -> int:
        """How many chunks there are."""
        return self._size

    @property
    def keys(self) -> NDArray[np.int64]:
        """(n,) key of each row."""
        return self._keys[: self._size]

    @property
    def memory_bytes(self) -> int:
        """Size of the arrays."""
        return self._keys.nbytes + self._columns.nbytes + self._hash_keys.nbytes + self._hash_rows.nbytes

    def column(self, number: int) -> NDArray[np.int64]:
        """(n,) one number of each row; writing to it changes the table. Valid until something is added."""
        return self._columns[number, : self._size]

    def find(self, keys: NDArray[np.int64]) -> NDArray[np.int64]:
        """(n,) row of each key, -1 where there is none."""
        return np.asarray(_find(self._hash_keys, self._hash_rows, keys))

    def add(self, keys: NDArray[np.int64]) -> NDArray[np.int64]:
        """(n,) row of each key, which is made where there is none."""
        while self._size + len(keys) > len(self._keys):
            self._keys = np.concatenate([self._keys, np.zeros_like(self._keys)])
            self._columns = np.concatenate([self._columns, np.zeros_like(self._columns)], axis=1)
            self._hash_again()
        rows, self._size = _add(self._hash_keys, self._hash_rows, self._keys, self._size, keys)
        return np.asarray(rows)

    def _hash_again(self) -> None:
        self._hash_keys = np.full(2 * len(self._keys), EMPTY, np.int64)
        self._hash_rows = np.zeros(2 * len(self._keys), np.int32)
        _add(self._hash_keys, self._hash_rows, self._keys, 0, self._keys[: self._size].copy())


@compiled
def _find(hash_keys: NDArray[np.int64], hash_rows: NDArray[np.int32], keys: NDArray[np.int64]) -> NDArray[np.int64]:
    rows = np.empty(keys.shape[0], np.int64)
    for n in range(keys.shape[0]):
        rows[n] = row_of_key(hash_keys, hash_rows, keys[n])
    return rows


@compiled
def _add(
    hash_keys: NDArray[np.int64],
    hash_rows: NDArray[np.int32],
    row_keys: NDArray[np.int64],
    size: int,
    keys: NDArray[np.int64],
) -> tuple[NDArray[np.int64], int]:
    rows = np.empty(keys.shape[0], np.int64)
    for n in range(keys.shape[0]):
        slot = slot_of(hash_keys, keys[n])
        if hash_keys[slot] == EMPTY:
            hash_keys[slot] = keys[n]
            hash_rows[slot] = size
            row_keys[size] = keys[n]
            size += 1
        rows[n] = hash_rows[slot]
    return rows, size
