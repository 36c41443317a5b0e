"""Reading a journal while another process writes it: what has been appended since the last look."""

from __future__ import annotations

import os
import struct
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from companion.mapping.journal.contents import Contents, place_of_record
from companion.mapping.journal.header import Header, is_unfinished, read_prologue
from companion.mapping.journal.recovery import segment_paths
from companion.mapping.journal.segment import Loss, Record, Segment, record_at, records
from companion.mapping.voxels.chunks import chunk_key, keys_of

_CRC = struct.Struct("<4xI")
"""Where `segment` puts the CRC of a record: it is that of all that the record says, the chunk's coordinates too."""

_READ_BYTES = 4 << 20
"""Of one file, looked at in one call."""


class News(NamedTuple):
    """Chunks of which a record was found, each once: (n,) keys, CRCs and sizes of their newest records."""

    keys: NDArray[np.int64]
    crcs: NDArray[np.uint32]
    sizes: NDArray[np.int64]


class JournalFollower:
    """A reader of a journal that grows. Writes nothing, waits for nobody, and holds no lock.

    Only whole records count, so the end of a file that is being written is left for the next look. Files that the
    writer has removed are kept open for as long as something in them is the newest of its chunk.

    Args:
        folder: of the journal; it need not exist yet.

    Attributes:
        header: what the map is; None before the first file.
        rewinds: how often the journal turned out to be another one than was read so far: cut by a power failure, or
            made anew. What was told before then is void, and everything is told again.
    """

    def __init__(self, folder: Path) -> None:
        self.header: Header | None = None
        self.rewinds = 0
        self._folder = folder
        self._contents = Contents()
        self._read: dict[int, int] = {}
        """By number of the segment: so far it was read."""

    def close(self) -> None:
        """Let go of the files."""
        for segment in self._contents.segments.values():
            segment.close()
        self._contents = Contents()
        self._read.clear()

    def poll(self) -> News:
        """What was appended since the last call, or a part of it: none comes only when there is nothing left.

        Raises:
            JournalError: a file is of a newer version, or no journal's.
            OSError: the folder cannot be read.
        """
        try:
            paths = {int(path.stem): path for path in segment_paths(self._folder)}
        except FileNotFoundError:
            paths = {}
        found: dict[int, tuple[int, int]] = {}
        for number in sorted(paths):
            if not self._take(number, paths[number], found):
                self.close()
                self.rewinds += 1
                return _news({})
        self._drop_removed(paths)
        return _news(found)

    def records(self, keys: NDArray[np.int64]) -> list[bytes]:
        """The newest records of those among ``keys`` (n,) that there are and can be read, as they are on the disk."""
        parts: list[bytes] = []
        found, places, sizes = self._contents.find(keys)
        for key, place, size in zip(found.tolist(), places.tolist(), sizes.tolist(), strict=True):
            segment, offset = self._contents.segment_of(place)
            data = segment.read(offset, size)
            record = record_at(data, 0)
            if record is not None and record.size_bytes == size and chunk_key.py_func(*record.chunk) == key:
                parts.append(data)
        return parts

    def _take(self, number: int, path: Path, found: dict[int, tuple[int, int]]) -> bool:
        """Read on in one file; false when it is not the file any more that was read so far."""
        segment = self._contents.segments.get(number) or self._opened(path)
        if segment is None:
            return True
        begin, size = self._read[number], segment.size_bytes
        if size < begin:
            return False
        data = segment.read(begin, min(size - begin, _READ_BYTES))
        losses: list[Loss] = []
        whole = list(records(data, 0, path, losses.append))
        if losses and losses[0].offset == 0 and not losses[0].torn and begin > segment.begin:
            return False
        self._note(segment, begin, data, whole, found)
        torn = next((loss.offset for loss in losses if loss.torn), len(data))
        self._read[number] = segment.end = begin + torn
        return True

    def _opened(self, path: Path) -> Segment | None:
        """A file that is new; None while its front is not whole."""
        try:
            descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
        except FileNotFoundError:
            return None
        segment = Segment(path, descriptor, 0, 0)
        try:
            front = segment.read(0, _READ_BYTES)
            header, segment.begin = read_prologue(front, path)
        except BaseException:
            segment.close()
            raise
        if header is None or is_unfinished(front, segment.begin):
            segment.close()
            return None
        self.header = header
        segment.end = segment.begin
        self._contents.segments[segment.number] = segment
        self._read[segment.number] = segment.begin
        return segment

    def _note(
        self, segment: Segment, begin: int, data: bytes, whole: list[Record], found: dict[int, tuple[int, int]]
    ) -> None:
        if not whole:
            return
        keys = keys_of(np.array([record.chunk for record in whole], np.int32))
        offsets = np.array([begin + record.offset for record in whole], np.int64)
        sizes = np.array([record.size_bytes for record in whole], np.int64)
        self._contents.point(keys, place_of_record(segment, 0) | offsets, sizes)
        for key, record in zip(keys.tolist(), whole, strict=True):
            found[key] = (_CRC.unpack_from(data, record.offset)[0], record.size_bytes)

    def _drop_removed(self, paths: dict[int, Path]) -> None:
        segments = self._contents.segments
        for number in [number for number, segment in segments.items() if number not in paths]:
            if segments[number].live_bytes <= 0:
                segments.pop(number).close()
                del self._read[number]


def _news(found: dict[int, tuple[int, int]]) -> News:
    columns = np.array([(key, *rest) for key, rest in found.items()], np.int64).reshape(-1, 3)
    return News(columns[:, 0].copy(), columns[:, 1].astype(np.uint32), columns[:, 2].copy())
