"""Files while they are written: such as are either whole or not there, and room on the disk that goes away again."""

from __future__ import annotations

import ctypes
import errno
import fcntl
import glob
import os
import secrets
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import BinaryIO, Self

import numpy as np
from numpy.typing import NDArray

from companion.mapping.journal.segment import sync_folder

_WORKSHOP, _ASIDE = ".unfinished", ".aside"
_HERE, _EXCHANGE = -100, 2
"""AT_FDCWD and RENAME_EXCHANGE of renameat2."""


@contextmanager
def whole_file(path: Path, mode: int = 0o666) -> Iterator[BinaryIO]:
    """A file to write to, which takes the place of ``path`` when the block ends without an error.

    It is written beside its place under a name of its own, so several may write the same file: the last to end wins.
    What a writer left there when it was killed goes away with the next one.

    Args:
        path: its place.
        mode: who may read and write it, from its first moment on, as far as the umask lets them.

    Raises:
        OSError: it cannot be written; what was there before still is.
    """
    _sweep(path)
    part, file = _locked_part(path, mode)
    try:
        with file:
            yield file
            file.flush()
            # Renamed before it is on the disk, it could be an empty file after the battery is pulled.
            os.fsync(file.fileno())
            part.replace(path)
        sync_folder(path.parent)
    except BaseException:
        part.unlink(missing_ok=True)
        raise


def _locked_part(path: Path, mode: int) -> tuple[Path, BinaryIO]:
    """A new file beside ``path``. The lock on it ends with its writer, by which others know that this one lives."""
    while True:
        part = path.with_name(f".{path.name}.{secrets.token_hex(4)}.part")
        file = open(part, "xb", opener=lambda name, flags: os.open(name, flags, mode))  # noqa: SIM115 - whoever asked closes it
        fcntl.flock(file, fcntl.LOCK_EX)
        if part.exists():
            return part, file
        # Another writer swept it away before it was locked.
        file.close()


def _sweep(path: Path) -> None:
    """Remove what dead writers of ``path`` left."""
    for left in path.parent.glob(f".{glob.escape(path.name)}.*.part"):
        with suppress(OSError), left.open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            left.unlink()


@contextmanager
def workshop(path: Path) -> Iterator[Path]:
    """A folder beside ``path`` for what is not whole yet; it goes away at the end.

    What a process left there when it was killed goes away with the next one, but for what it had taken from its place.

    Raises:
        OSError: it cannot be made.
    """
    for left in path.parent.glob(f".{glob.escape(path.name)}.*{_WORKSHOP}"):
        if not any(left.glob(f"*{_ASIDE}")):
            with suppress(OSError), _locked(left):
                shutil.rmtree(left)
    with ExitStack() as stack:
        while True:
            room = Path(tempfile.mkdtemp(prefix=f".{path.name}.", suffix=_WORKSHOP, dir=path.parent))
            stack.callback(shutil.rmtree, room, ignore_errors=True)
            with suppress(FileNotFoundError):
                # Another one may have swept it away before it was locked.
                stack.enter_context(_locked(room))
                if room.exists():
                    break
        yield room


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Hold a folder. The lock ends with the process, by which others know that it lives.

    Raises:
        OSError: somebody else holds it.
    """
    held = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    finally:
        os.close(held)


def exchange(new: Path, old: Path) -> None:
    """Let two folders or files change places, at once: whoever is killed leaves one of them or the other.

    Where the file system cannot, one goes after the other.

    Raises:
        OSError: it cannot be done; everything is where it was.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.renameat2(_HERE, os.fsencode(new), _HERE, os.fsencode(old), _EXCHANGE) == 0:
        return
    if (number := ctypes.get_errno()) not in (errno.EINVAL, errno.ENOSYS):
        raise OSError(number, os.strerror(number), str(old))
    aside = new.with_name(f"{new.name}{_ASIDE}")
    old.replace(aside)
    try:
        new.replace(old)
    except BaseException:
        aside.replace(old)
        raise
    aside.replace(new)


class Spool:
    """Blocks of bytes by number, in a file without a name: it goes away with the process, however that ends.

    Args:
        folder: where there is room: beside the file that is to be written.
    """

    def __init__(self, folder: Path) -> None:
        self._file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115 - closed by __exit__
        self._ends = [np.zeros(1, np.int64)]
        self._starts: NDArray[np.int64] | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def append(self, data: NDArray[np.uint8], ends: NDArray[np.int64]) -> None:
        """Keep blocks that lie one behind another in ``data``, the k-th up to ``ends[k]``."""
        if len(ends):
            self._ends.append(self._ends[-1][-1] + ends)
            self._file.write(data[: int(ends[-1])].tobytes())
            self._starts = None

    def block(self, number: int) -> bytes:
        """The block that was the ``number``-th to be appended, from 0."""
        if self._starts is None:
            self._starts = np.concatenate(self._ends)
            self._file.flush()
        start, end = int(self._starts[number]), int(self._starts[number + 1])
        return os.pread(self._file.fileno(), end - start, start)
