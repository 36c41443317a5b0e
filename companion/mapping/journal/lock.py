"""One writer at a time."""

from __future__ import annotations

import errno
import fcntl
import os
from pathlib import Path

from companion.mapping.journal.header import JournalError

LOCK_NAME = "lock"


def lock(folder: Path) -> int:
    """Be the only writer of a folder until the returned descriptor is closed, or the process ends however it does.

    Raises:
        JournalError: another process is.
        OSError: the file cannot be made or locked.
    """
    path = folder / LOCK_NAME
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        owner = os.pread(descriptor, 20, 0).decode("ascii", "replace").strip()
        os.close(descriptor)
        if error.errno in (errno.EWOULDBLOCK, errno.EACCES):
            raise JournalError(
                f"{folder}: process {owner or '?'} is writing it; end that one, or give another folder"
            ) from None
        raise
    try:
        os.ftruncate(descriptor, 0)
        os.pwrite(descriptor, f"{os.getpid()}\n".encode(), 0)
    except OSError:
        # The number is only for the message above: a full disk must not keep anyone from the map.
        return descriptor
    return descriptor
