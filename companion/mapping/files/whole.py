"""Files that are either whole or not there."""

from __future__ import annotations

import fcntl
import glob
import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO


@contextmanager
def whole_file(path: Path) -> Iterator[BinaryIO]:
    """A file to write to, which takes the place of ``path`` when the block ends without an error.

    It is written beside its place under a name of its own, so several may write the same file: the last to end wins.
    What a writer left there when it was killed goes away with the next one.

    Raises:
        OSError: it cannot be written; what was there before still is.
    """
    _sweep(path)
    part, file = _locked_part(path)
    try:
        with file:
            yield file
            file.flush()
            # Renamed before it is on the disk, it could be an empty file after the battery is pulled.
            os.fsync(file.fileno())
            part.replace(path)
        _keep_name(path.parent)
    except BaseException:
        part.unlink(missing_ok=True)
        raise


def _locked_part(path: Path) -> tuple[Path, BinaryIO]:
    """A new file beside ``path``. The lock on it ends with its writer, by which others know that this one lives."""
    while True:
        part = path.with_name(f".{path.name}.{secrets.token_hex(4)}.part")
        file = part.open("xb")
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


def _keep_name(folder: Path) -> None:
    """Bring the new name to the disk too."""
    opened = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(opened)
    finally:
        os.close(opened)
