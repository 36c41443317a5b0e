"""One file of a journal, and the records in it: how they are framed, and found again behind a place that is damaged."""

from __future__ import annotations

import contextlib
import errno
import os
import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from companion.mapping.journal.coding import MOST_BYTES, encode
from companion.mapping.voxels.chunks import CHUNK_LIMIT, plain

_MARK = 0xA7D15EC3
_MARK_BYTES = struct.pack("<I", _MARK)
_FRONT = struct.Struct("<IIIiii")
"""Mark, a CRC of all that comes behind it, bytes of the chunk that follow, chunk coordinates."""

FRONT_BYTES = _FRONT.size
MOST_RECORD_BYTES = FRONT_BYTES + MOST_BYTES
_SUMMED_FROM = 8

SUFFIX = ".segment"
_READ_BYTES = 1 << 20
_PAGE_BYTES = 4096


@dataclass(frozen=True, slots=True)
class Loss:
    """Bytes of a journal that cannot be read.

    Attributes:
        path: the file.
        offset: where it begins.
        size_bytes: how much.
        torn: it is the unfinished end of a file, as a crash leaves it: nothing that was committed.
    """

    path: Path
    offset: int
    size_bytes: int
    torn: bool


class Record(NamedTuple):
    """A record that is whole: which chunk, where it begins, and its size with the front."""

    chunk: tuple[int, int, int]
    offset: int
    size_bytes: int


def packed(chunks: NDArray[np.int32], values: NDArray[np.int16]) -> tuple[bytes, NDArray[np.int64]]:
    """Records of ``chunks`` (n, 3) with their ``values`` (n, 4096), one behind the other; and the size of each."""
    out = np.empty(len(chunks) * MOST_RECORD_BYTES, np.uint8)
    sizes = encode(plain(values, np.int16), out, FRONT_BYTES)
    data = memoryview(out.data)
    at = 0
    for (x, y, z), size in zip(chunks.tolist(), sizes.tolist(), strict=True):
        _FRONT.pack_into(data, at, _MARK, 0, size, x, y, z)
        end = at + FRONT_BYTES + size
        struct.pack_into("<I", data, at + 4, zlib.crc32(data[at + _SUMMED_FROM : end]))
        at = end
    return data[:at].tobytes(), sizes + FRONT_BYTES


def record_at(data: bytes | memoryview, at: int) -> Record | None:
    """The record that begins at ``at``, None when there is none that is whole."""
    if len(data) - at < FRONT_BYTES:
        return None
    mark, crc, size, x, y, z = _FRONT.unpack_from(data, at)
    end = at + FRONT_BYTES + size
    if mark != _MARK or size > MOST_BYTES or end > len(data) or crc != zlib.crc32(data[at + _SUMMED_FROM : end]):
        return None
    if min(x, y, z) < -CHUNK_LIMIT or max(x, y, z) >= CHUNK_LIMIT:
        return None
    return Record((x, y, z), at, FRONT_BYTES + size)


def records(data: bytes, begin: int, path: Path, lose: Callable[[Loss], None]) -> Iterator[Record]:
    """The whole records of a segment from ``begin`` on; what lies between them is given to ``lose``."""
    view = memoryview(data)
    at = begin
    while at < len(data):
        record = record_at(view, at)
        if record is None:
            after = _next_record(data, view, at + 1)
            lose(Loss(path, at, after - at, torn=after == len(data) and _is_torn(view, at)))
            at = after
        else:
            yield record
            at += record.size_bytes


def _next_record(data: bytes, view: memoryview, at: int) -> int:
    """Where the next whole record begins, or the end."""
    while True:
        at = data.find(_MARK_BYTES, at)
        if at < 0:
            return len(data)
        if record_at(view, at) is not None:
            return at
        at += 1


def _is_torn(view: memoryview, at: int) -> bool:
    """Whether the rest looks as a crash leaves it: the beginning of a record, maybe filled up with zeros."""
    rest = view[at:].tobytes().rstrip(b"\0")
    mark, _, size, *_ = _FRONT.unpack(rest[:FRONT_BYTES].ljust(FRONT_BYTES, b"\0"))
    begins = mark == _MARK or _MARK_BYTES.startswith(rest)
    return bool(begins and len(rest) < FRONT_BYTES + size)


class Segment:
    """An open segment. What is written becomes visible whole or not at all.

    Args:
        path: its file.
        descriptor: of the open file, which is closed with the segment.
        begin: where the records begin.
        end: where the next one goes.

    Attributes:
        live_bytes: size of those of its records that are the newest of their chunk.
        safe_end: what lies before it has been given to the disk.
        full: nothing more is written to it.
        damaged: something in it cannot be read. It is kept: somebody may still make sense of it.
        in_doubt: a sync failed; nobody knows which part of what comes behind ``safe_end`` the disk has.
    """

    def __init__(self, path: Path, descriptor: int, begin: int, end: int) -> None:
        self.path = path
        self.number = int(path.stem)
        self.begin = begin
        self.end = end
        self.live_bytes = 0
        self.safe_end = 0
        self.full = False
        self.damaged = False
        self.in_doubt = False
        self._descriptor = descriptor

    @classmethod
    def create(cls, folder: Path, number: int, front: bytes) -> Segment:
        """A new file with this front. When that fails there is none.

        Raises:
            OSError: no room, or the like.
        """
        path = folder / f"{number:08d}{SUFFIX}"
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
        segment = cls(path, descriptor, 0, 0)
        try:
            segment.write(front)
        except OSError:
            segment.remove()
            raise
        segment.begin = segment.end
        return segment

    def write(self, data: bytes) -> None:
        """Append and give it to the operating system; on an error nothing of it counts.

        Raises:
            OSError: no room, or the like.
        """
        at = 0
        try:
            while at < len(data):
                written = os.pwrite(self._descriptor, data[at:], self.end + at)
                if written == 0:
                    raise OSError(errno.EIO, os.strerror(errno.EIO), str(self.path))
                at += written
        except OSError:
            try:
                os.ftruncate(self._descriptor, self.end)
            except OSError:
                # What was half written stays. Nothing may come behind it, or it could be taken for newer.
                self.full = True
            raise
        self.end += len(data)

    def sync(self) -> None:
        """Give everything written to the disk; also in a thread, while more is written.

        Raises:
            OSError: the segment is in doubt now, and full.
        """
        end = self.end
        if self.safe_end == end:
            return
        try:
            os.fsync(self._descriptor)
        except OSError:
            self.full = self.in_doubt = True
            raise
        self.safe_end = end

    @property
    def size_bytes(self) -> int:
        """Of the file now; another process may be writing it."""
        return os.fstat(self._descriptor).st_size

    def read(self, offset: int, size_bytes: int) -> bytes:
        """Some bytes, fewer at the end of the file; nothing where the disk cannot be read."""
        try:
            return os.pread(self._descriptor, size_bytes, offset)
        except OSError:
            return b""

    def read_all(self) -> bytes:
        """The whole file, with zeros where the disk cannot be read."""
        size = self.size_bytes
        data = bytearray(size)
        for at in range(0, size, _READ_BYTES):
            end = min(at + _READ_BYTES, size)
            block = self.read(at, end - at)
            data[at : at + len(block)] = block
            # An unreadable page costs itself, not the whole block.
            for page in range(at + len(block), end, _PAGE_BYTES):
                part = self.read(page, min(_PAGE_BYTES, end - page))
                data[page : page + len(part)] = part
        return bytes(data)

    def cut(self, loss: Loss) -> None:
        """Take a torn end off."""
        with contextlib.suppress(OSError):
            os.ftruncate(self._descriptor, loss.offset)

    def remove(self) -> None:
        """Delete the file and close it. Whoever has it open keeps it."""
        with contextlib.suppress(FileNotFoundError):
            self.path.unlink()
        self.close()

    def close(self) -> None:
        """Close the file. Once is enough."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
        self._descriptor = -1


def sync_folder(folder: Path) -> None:
    """Give the names of new files to the disk: without them a power cut takes the files away.

    Raises:
        OSError: the disk refuses.
    """
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
