"""The growing file: knows its size and its limit, and never raises into the writer."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

FRAMES_SHARE, FULL_SHARE = 0.8, 0.95
"""Depth images end at the first share of the limit, everything at the second: what is buffered and the index at the
end of the file still have to fit."""

KEEP_FREE_BYTES = 200_000_000
"""Left free on the disk when the flight begins: the map has to be written at its end."""


class RecordingFile:
    """A file-like object for the MCAP writer. It only appends.

    The first error of the disk ends the writing and is kept in `problem`; from then on everything is swallowed.

    Args:
        path: a new file; its folder is made.
        largest_bytes: limit of its size; less when the disk has less to give.

    Raises:
        OSError: it cannot be made.
    """

    def __init__(self, path: Path, largest_bytes: float) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        # Unbuffered: what is written is in the hands of the operating system and survives the end of this process.
        self._file = path.open("xb", buffering=0)
        self.problem: str | None = None
        self.size = 0
        self.limit = min(largest_bytes, max(shutil.disk_usage(path.parent).free - KEEP_FREE_BYTES, 0.0))

    @property
    def room_for_frames(self) -> bool:
        """Whether depth images may still be written."""
        return self.size < FRAMES_SHARE * self.limit

    @property
    def full(self) -> bool:
        """Whether the limit is reached: close the file."""
        return self.size >= FULL_SHARE * self.limit

    def write(self, data: bytes | bytearray) -> int:
        """Append; always claims success, see `problem`."""
        left = memoryview(data)
        try:
            while left and self.problem is None:
                left = left[self._file.write(left) :]
        except OSError as error:
            self.problem = _reason(error)
        self.size += len(data)
        return len(data)

    def seek(self, _offset: int, _whence: int = 0) -> int:
        """The writer only asks where it stands."""
        return self.size

    def flush(self) -> None:
        """Nothing is buffered here."""

    def sync(self) -> None:
        """Have the disk keep what was written, through a loss of power too. May take long."""
        if self.problem is None:
            try:
                os.fsync(self._file.fileno())
            except OSError as error:
                self.problem = _reason(error)

    def close(self) -> None:
        """Give the file back."""
        try:
            self._file.close()
        except OSError as error:
            self.problem = self.problem or _reason(error)


def _reason(error: OSError) -> str:
    return error.strerror or str(error)
