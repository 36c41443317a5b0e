"""The numbers of the map's changes: which chunks have changed after some number, and what equals what."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from companion.link.map_wire import BUCKETS, bucket_of, sums_of, total
from companion.mapping.journal.contents import ChunkRows
from companion.mapping.journal.following import News

_CRC, _NUMBER, _SIZE, _BUCKET = range(4)

MOST_MARKS = 4096
"""Times of changes that are remembered; of more than these every other is forgotten."""


class Changed(NamedTuple):
    """Chunks that changed, oldest change first: (n,) keys, numbers and sizes of their records in bytes."""

    keys: NDArray[np.int64]
    numbers: NDArray[np.int64]
    sizes: NDArray[np.int64]


class ChunkNumbers:
    """The number of the last change of each chunk. A record that says what the chunk was already changes nothing.

    Attributes:
        head: number of the newest change; 0 before the first.
        sums: (`BUCKETS`,) as `sums_of` all chunks.
    """

    def __init__(self) -> None:
        self.head = 0
        self.sums = np.zeros(BUCKETS, np.uint64)
        self._rows = ChunkRows(4)
        self._marks: deque[tuple[int, float]] = deque()
        """(number, time): all changes up to the number were found by then."""

    def __len__(self) -> int:
        """How many chunks there are."""
        return len(self._rows)

    @property
    def sum(self) -> str:
        """Over all chunks."""
        return total(self.sums)

    def has(self, keys: NDArray[np.int64]) -> NDArray[np.bool_]:
        """(n,) whether there is such a chunk."""
        return self._rows.find(keys) >= 0

    def take(self, news: News, now_s: float) -> None:
        """Number what has changed."""
        before = len(self._rows)
        rows = self._rows.add(news.keys)
        crcs, new = self._rows.column(_CRC), rows >= before
        changed = new | (crcs[rows] != news.crcs)
        if not changed.any():
            return
        rows, keys, gone = rows[changed], news.keys[changed], changed & ~new
        self.sums -= sums_of(news.keys[gone], crcs[rows[~new[changed]]].astype(np.uint32))
        self.sums += sums_of(keys, news.crcs[changed])
        crcs[rows] = news.crcs[changed]
        self._rows.column(_SIZE)[rows] = news.sizes[changed]
        self._rows.column(_BUCKET)[rows] = bucket_of(keys)
        self._rows.column(_NUMBER)[rows] = self.head + 1 + np.arange(len(rows))
        self.head += len(rows)
        self._marks.append((self.head, now_s))
        if len(self._marks) > MOST_MARKS:
            # The later of each pair stays: what is said of an age is rather too much.
            self._marks = deque(list(self._marks)[::2])

    def after(self, number: int, until: int, wanted: NDArray[np.bool_]) -> Changed:
        """Chunks that changed after ``number``; up to ``until`` only those in ``wanted`` (`BUCKETS`,) buckets."""
        numbers = self._rows.column(_NUMBER)
        is_due = (numbers > number) & ((numbers > until) | wanted[self._rows.column(_BUCKET)])
        rows = np.flatnonzero(is_due)
        rows = rows[np.argsort(numbers[rows])]
        return Changed(self._rows.keys[rows], numbers[rows], self._rows.column(_SIZE)[rows])

    def oldest_s(self, number: int) -> float | None:
        """When the first change after ``number`` was found, or a little before; None where there is none."""
        return next((t_s for upto, t_s in self._marks if upto > number), None)
