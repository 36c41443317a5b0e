"""The ground's copy of a vehicle's map: a journal of its own, record for record what the vehicle's holds."""

from __future__ import annotations

import struct
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from companion.link.coarse import CoarseChunks
from companion.link.map_wire import BUCKETS
from companion.link.numbering import ChunkNumbers
from companion.link.wire import WireError
from companion.mapping.journal import JOURNAL_NAME, Header, Journal, JournalError, JournalFollower
from companion.mapping.journal.following import News
from companion.mapping.journal.segment import record_at
from companion.mapping.voxels.chunks import chunks_of
from companion.mapping.voxels.lookup import states_of
from companion.mapping.voxels.piece import MOST_CHUNKS, MapPiece, MapSnapshot

MOST_EARLIER = 9
"""Copies that turned out not to be of the vehicle's map any more and are kept beside it."""

COMPACT_S = 0.01

_CRC = struct.Struct("<4xI")
_EVERYTHING = np.zeros(BUCKETS, np.bool_)


class MapCopy:
    """One copy; every member may be used from any thread. A `MapSource`.

    Args:
        folder: that holds the journal; made when it is missing.
        header: of the vehicle's map; None: a copy must be there.

    Raises:
        JournalError: the journal cannot be opened, or is of a map with other settings.
    """

    def __init__(self, folder: Path, header: Header | None = None) -> None:
        self.folder = folder
        self._lock = threading.Lock()
        self._journal = Journal.open(folder / JOURNAL_NAME, header)
        self._numbers = ChunkNumbers()
        self._coarse: dict[int, tuple[int, NDArray[np.uint8]]] = {}
        """By key, of chunks of which there is nothing better: the revision, and the states of the bricks' voxels."""
        follower = JournalFollower(folder / JOURNAL_NAME)
        try:
            while len((news := follower.poll()).keys):
                self._numbers.take(news, 0.0)
        finally:
            follower.close()

    @classmethod
    def anew(cls, folder: Path, header: Header) -> Self:
        """An empty copy; the one that was there is kept beside it, for as many times as `MOST_EARLIER`."""
        was = folder / JOURNAL_NAME
        if was.exists():
            names = [folder / f"earlier-{number}-{JOURNAL_NAME}" for number in range(1, MOST_EARLIER + 1)]
            free = next((name for name in names if not name.exists()), None)
            if free is None:
                raise JournalError(f"{folder}: {MOST_EARLIER} earlier copies of this map are here: move them away")
            was.rename(free)
        return cls(folder, header)

    @property
    def voxel_m(self) -> float:
        """Edge of a voxel."""
        return self._journal.voxel_m

    @property
    def threshold(self) -> int:
        """A voxel is occupied from this value on."""
        return self._journal.threshold

    @property
    def header(self) -> Header:
        """Of the map."""
        return self._journal.header

    @property
    def sums(self) -> NDArray[np.uint64]:
        """(`BUCKETS`,) to be compared with the vehicle's."""
        with self._lock:
            return self._numbers.sums.copy()

    @property
    def sum(self) -> str:
        """Over all chunks: equal to the vehicle's where the maps are equal."""
        with self._lock:
            return self._numbers.sum

    @property
    def chunk_count(self) -> int:
        """How many chunks it has."""
        with self._lock:
            return len(self._numbers)

    def close(self) -> None:
        """Keep everything, and let go of the journal.

        Raises:
            OSError: the disk refuses.
        """
        with self._lock:
            self._journal.close()

    def take(self, body: bytes) -> int:
        """Put in the records that came; how many there were.

        Raises:
            WireError: they are none.
            OSError: the disk is full or broken; nothing was taken.
        """
        records, found = [], {}
        at, view = 0, memoryview(body)
        while at < len(body):
            record = record_at(view, at)
            if record is None:
                raise WireError("what came of the map is damaged")
            records.append(body[at : at + record.size_bytes])
            at += record.size_bytes
        with self._lock:
            keys = self._journal.append_records(records)
            for key, data in zip(keys.tolist(), records, strict=True):
                found[key] = (_CRC.unpack_from(data)[0], len(data))
                self._coarse.pop(key, None)
            columns = np.array([(key, *rest) for key, rest in found.items()], np.int64).reshape(-1, 3)
            news = News(columns[:, 0].copy(), columns[:, 1].astype(np.uint32), columns[:, 2].copy())
            self._numbers.take(news, time.monotonic())
        return len(records)

    def take_coarse(self, coarse: CoarseChunks) -> None:
        """Put in a coarse picture, of the chunks of which there is nothing better."""
        with self._lock:
            unknown = ~self._numbers.has(coarse.keys)
            self._numbers.head += 1
            keys, occupied, free = coarse
            states = CoarseChunks(keys[unknown], occupied[unknown], free[unknown]).states()
            for key, row in zip(keys[unknown].tolist(), states, strict=True):
                self._coarse[key] = (self._numbers.head, row)

    def keep(self) -> None:
        """Have what came survive a power cut, in a thread of the journal's.

        Raises:
            OSError: the disk refuses.
        """
        with self._lock:
            if self._journal.is_syncing:
                return
            # What the thread has given to the disk is safe: files of which nothing is needed any more can go.
            self._journal.commit()
            self._journal.compact_step(COMPACT_S)
            self._journal.begin_commit()

    def changed(self, revision: int) -> MapSnapshot:
        """The states of the chunks that changed after a revision of this copy; 0: of all."""
        with self._lock:
            keys = self._numbers.after(revision, 0, _EVERYTHING).keys
            piece = self._journal.read(chunks_of(keys))
            coarse = {key: states for key, (since, states) in self._coarse.items() if since > revision}
            head = self._numbers.head
        states = np.asarray(states_of(piece.values, self.threshold))
        if coarse:
            chunks = chunks_of(np.array(list(coarse), np.int64))
            return MapSnapshot(
                self.voxel_m,
                head,
                np.concatenate([piece.chunks, chunks]),
                np.concatenate([states, np.stack(list(coarse.values()))]),
            )
        return MapSnapshot(self.voxel_m, head, piece.chunks, states)

    def pieces(self, most_chunks: int = MOST_CHUNKS) -> Iterator[MapPiece]:
        """Every chunk once, as it is when it is its turn."""
        with self._lock:
            everything = self._journal.chunks
        for first in range(0, len(everything), most_chunks):
            with self._lock:
                piece = self._journal.read(everything[first : first + most_chunks])
            yield piece
