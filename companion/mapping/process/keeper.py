"""Puts what changed on the disk, in a thread: however long the disk takes, images do not wait for it."""

from __future__ import annotations

import errno
import threading
from collections.abc import Callable

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


class Keeper:
    """Does one thing at a time in a thread of its own.

    Args:
        keep: puts it on the disk; an `OSError` is what the disk had against it. Anything else is an error of ours,
            raised where the result is asked for.
    """

    def __init__(self, keep: Callable[[], None]) -> None:
        self._keep = keep
        self._wanted = threading.Event()
        self._idle = threading.Event()
        self._idle.set()
        self._error: Exception | None = None
        threading.Thread(target=self._run, name="journal", daemon=True).start()

    @property
    def busy(self) -> bool:
        """Whether the last one is not over yet."""
        return not self._idle.is_set()

    def begin(self) -> None:
        """Begin the next one; the last one is over."""
        self._idle.clear()
        self._wanted.set()

    def wait(self) -> None:
        """Wait until it is over."""
        self._idle.wait()

    def result(self) -> OSError | None:
        """What the disk had against the last one that is over."""
        if self._error is None or isinstance(self._error, OSError):
            return self._error
        raise self._error

    def _run(self) -> None:
        while True:
            self._wanted.wait()
            self._wanted.clear()
            try:
                self._keep()
            except Exception as error:  # noqa: BLE001 - whoever asks for the result gets it
                self._error = error
            else:
                self._error = None
            self._idle.set()


def told(error: OSError) -> str:
    """What the disk has against the map, and what to do; the first 50 letters go to the pilot."""
    if error.errno in _FULL:
        return f"disk full, in memory only: make room ({error.strerror})"
    return f"disk fails, in memory only: check it ({error.strerror})"
