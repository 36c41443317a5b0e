"""Lines for whoever reads them after a crash. A reader that does not read, such as a full pipe, delays nothing."""

from __future__ import annotations

import contextlib
import os
import queue
import threading
import time
from collections.abc import Callable

WAITING_LINES = 256
STDERR = 2


class Log:
    """Writes lines to a file descriptor, in a thread of its own, which ends with the process.

    Args:
        fd: where to; stderr by default.
        wall_clock: time of day in s since 1970.

    Attributes:
        lost: lines that came faster than they could be written.
    """

    def __init__(self, fd: int = STDERR, wall_clock: Callable[[], float] = time.time) -> None:
        self.lost = 0
        self._fd = fd
        self._wall_clock = wall_clock
        self._lines: queue.Queue[bytes | None] = queue.Queue(WAITING_LINES)
        self._thread = threading.Thread(target=self._write, name="log", daemon=True)
        self._thread.start()

    def say(self, line: str) -> None:
        """Write a line; never waits."""
        t_s = self._wall_clock()
        stamp = time.strftime("%H:%M:%S", time.localtime(t_s))
        try:
            self._lines.put_nowait(f"{stamp}.{int(t_s * 1000.0) % 1000:03d} gate: {line}\n".encode(errors="replace"))
        except queue.Full:
            self.lost += 1

    def close(self, timeout_s: float) -> None:
        """Write what is left, for so long at most."""
        until_s = time.monotonic() + timeout_s
        if self.lost:
            self._put(f"{self.lost} lines of the gate were lost\n".encode(), timeout_s)
        self._put(None, max(0.0, until_s - time.monotonic()))
        self._thread.join(max(0.0, until_s - time.monotonic()))

    def _put(self, line: bytes | None, timeout_s: float) -> None:
        with contextlib.suppress(queue.Full):
            self._lines.put(line, timeout=timeout_s)

    def _write(self) -> None:
        while (line := self._lines.get()) is not None:
            # A terminal that is gone takes nothing any more. The flight goes on.
            with contextlib.suppress(OSError):
                while line:
                    line = line[os.write(self._fd, line) :]
