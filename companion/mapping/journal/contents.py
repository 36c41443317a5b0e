"""Where the newest record of each chunk is, in a compact table: a few whole numbers for each, found by its key."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled
from companion.mapping.journal.segment import Segment
from companion.mapping.voxels.chunks import EMPTY, row_of_key, slot_of

_FIRST_ROWS = 256

_PLACE, _SIZE = 0, 1
_OFFSET_BITS = 32
_OFFSET = (1 << _OFFSET_BITS) - 1

_WASTE = 1.75
"""Files may be this many times as large as what is needed of them."""

_WORTH_COPYING = 0.75
"""A file of which a larger share is needed is left alone."""


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


class Contents:
    """The segments of a journal, and where the newest record of each chunk is in them.

    A place is the number of a segment and an offset in it, in one number; 0 is nowhere. Later records have larger ones.

    Attributes:
        segments: by number, oldest first.
    """

    def __init__(self) -> None:
        self.segments: dict[int, Segment] = {}
        self._rows = ChunkRows(2)

    @property
    def memory_bytes(self) -> int:
        """Size of the arrays."""
        return self._rows.memory_bytes

    @property
    def live_bytes(self) -> int:
        """Size of the newest records."""
        return sum(segment.live_bytes for segment in self.segments.values())

    def keys(self) -> NDArray[np.int64]:
        """(n,) keys of all chunks, in the order of their places."""
        places = self._rows.column(_PLACE)
        order = np.argsort(places)
        return self._rows.keys[order[np.count_nonzero(places == 0) :]]

    def keys_in(self, segment: Segment, begin: int = 0) -> NDArray[np.int64]:
        """(n,) keys of the chunks whose newest record is in a segment, from offset ``begin`` on, in order."""
        places = self._rows.column(_PLACE)
        first = place_of_record(segment, begin)
        inside = np.flatnonzero((places >= first) & (places <= place_of_record(segment, _OFFSET)))
        return self._rows.keys[inside[np.argsort(places[inside])]]

    def find(self, keys: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        """Those of ``keys`` that there are, their places, and the sizes of their records; in the order of places."""
        rows = self._rows.find(keys)
        rows = rows[rows >= 0]
        places = self._rows.column(_PLACE)[rows]
        rows = rows[np.argsort(places)][np.count_nonzero(places == 0) :]
        return self._rows.keys[rows], self._rows.column(_PLACE)[rows], self._rows.column(_SIZE)[rows]

    def segment_of(self, place: int) -> tuple[Segment, int]:
        """The segment and the offset that a place means."""
        return self.segments[place >> _OFFSET_BITS], place & _OFFSET

    def most_wasteful(self, segment_bytes: int) -> Segment | None:
        """The segment, not the newest, with the least that is still needed; None when copying that is not worth it.

        Args:
            segment_bytes: size of a file; half of one may be wasted in any case.
        """
        segments = [one for one in self.segments.values() if one.live_bytes > 0 and not one.damaged]
        if sum(one.end for one in segments) <= _WASTE * self.live_bytes + segment_bytes / 2:
            return None
        newest = max(self.segments)
        worst = min((one for one in segments if one.number != newest), key=_live_share, default=None)
        return worst if worst is not None and _live_share(worst) < _WORTH_COPYING else None

    def point(self, keys: NDArray[np.int64], places: NDArray[np.int64], sizes: NDArray[np.int64]) -> None:
        """These records are the newest of their chunks now."""
        rows = self._rows.add(keys)
        gone, gone_sizes = _replace(self._rows.column(_PLACE), self._rows.column(_SIZE), rows, places, sizes)
        self._count(gone, -gone_sizes)
        self._count(places, sizes)

    def forget(self, key: int) -> None:
        """There is no record of this chunk any more."""
        row = self._rows.find(np.array([key], np.int64))
        places, sizes = self._rows.column(_PLACE), self._rows.column(_SIZE)
        self._count(places[row], -sizes[row])
        places[row] = sizes[row] = 0

    def _count(self, places: NDArray[np.int64], sizes: NDArray[np.int64]) -> None:
        numbers = places >> _OFFSET_BITS
        for number in np.unique(numbers[numbers > 0]).tolist():
            self.segments[number].live_bytes += int(sizes[numbers == number].sum())


def _live_share(segment: Segment) -> float:
    return segment.live_bytes / segment.end


def place_of_record(segment: Segment, offset: int) -> int:
    """Segment and offset in one number."""
    return (segment.number << _OFFSET_BITS) | offset


@compiled
def _replace(
    places: NDArray[np.int64],
    sizes: NDArray[np.int64],
    rows: NDArray[np.int64],
    new_places: NDArray[np.int64],
    new_sizes: NDArray[np.int64],
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Set the numbers of rows one after the other, for a row may occur twice; what each had before."""
    old_places, old_sizes = np.empty_like(new_places), np.empty_like(new_sizes)
    for n in range(rows.shape[0]):
        row = rows[n]
        old_places[n], old_sizes[n] = places[row], sizes[row]
        places[row], sizes[row] = new_places[n], new_sizes[n]
    return old_places, old_sizes
