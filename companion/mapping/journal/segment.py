"""One file of a journal."""

from __future__ import annotations

import contextlib
import errno
import os
from pathlib import Path

from companion.mapping.journal.log import Loss

SUFFIX = ".segment"
_READ_BYTES = 1 << 20
_PAGE_BYTES = 4096


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

    def read(self, offset: int, size_bytes: int) -> bytes:
        """Some bytes, fewer at the end of the file; nothing where the disk cannot be read."""
        try:
            return os.pread(self._descriptor, size_bytes, offset)
        except OSError:
            return b""

    def read_all(self) -> bytes:
        """The whole file, with zeros where the disk cannot be read."""
        size = os.fstat(self._descriptor).st_size
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
