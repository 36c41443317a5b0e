"""Bytes that come and go over any wire: messages that may be believed, and whole messages or none."""

from __future__ import annotations

import array
import fcntl
import math
import os
import termios
from collections.abc import Callable, Iterable

from companion.mavlink.codec import Frame, Framer

RETRY_S = 1.0
DATAGRAM_BYTES = 1400
"""Most that is put into one datagram: it passes any network in one piece."""

Accept = Callable[[Frame], Frame | None]
"""Gives the message as it is passed on; None refuses it."""


class FrameReader:
    """What came in, as messages.

    Args:
        accept: looks at each; None: all are welcome.
        datagram: see `Framer`.

    Attributes:
        refused: messages that ``accept`` did not want.
    """

    def __init__(self, accept: Accept | None, *, datagram: bool) -> None:
        self.refused = 0
        self._accept = accept
        self._datagram = datagram
        self._bad_before = 0
        self._framer = Framer(datagram=datagram)

    @property
    def bad(self) -> int:
        """Stretches of bytes that were no message."""
        return self._bad_before + self._framer.bad

    def restart(self) -> None:
        """Another stream begins: the rest of the one before is nobody's beginning."""
        self._bad_before = self.bad
        self._framer = Framer(datagram=self._datagram)

    def frames(self, data: bytes) -> list[Frame]:
        """The messages in what came in."""
        found = self._framer.frames(data)
        if self._accept is None:
            return found
        accepted = [welcome for frame in found if (welcome := self._accept(frame)) is not None]
        self.refused += len(found) - len(accepted)
        return accepted


class FrameWriter:
    """Whole messages into a stream that may take a part of what it is given.

    A stream keeps what it cannot send yet, and sends it later: a setpoint would arrive when it is no longer true. So
    nothing more is given to a stream in which ``most_waiting`` bytes wait already.

    Args:
        most_waiting: bytes.
    """

    def __init__(self, most_waiting: int) -> None:
        self._most_waiting = most_waiting
        self._waiting = array.array("i", [0])
        self._rest = b""

    def restart(self) -> None:
        """Another stream begins."""
        self._rest = b""

    def flush(self, fd: int) -> bool:
        """Send the rest of a message that was begun; whether none is left.

        Raises:
            OSError: the stream takes nothing, now or never.
        """
        if self._rest:
            self._rest = self._rest[os.write(fd, self._rest) :]
        return not self._rest

    def put(self, fd: int, raw: bytes) -> bool:
        """Send, without waiting; whether it was taken."""
        try:
            if not self.flush(fd):
                return False
            fcntl.ioctl(fd, termios.TIOCOUTQ, self._waiting)
            if self._waiting[0] > self._most_waiting:
                return False
            self._rest = raw[os.write(fd, raw) :]
        except OSError:
            return False
        return True


class Reconnect:
    """When to try again: at once, and then once a second."""

    def __init__(self) -> None:
        self._due_s = -math.inf

    def due(self, now_s: float) -> bool:
        """Whether to try now."""
        return now_s >= self._due_s

    def failed(self, now_s: float) -> None:
        """It did not work, or does no longer."""
        self._due_s = now_s + RETRY_S


def batches(frames: Iterable[Frame]) -> list[bytes]:
    """Messages joined to as few datagrams as possible, none of them cut."""
    found: list[bytes] = []
    joined: list[bytes] = []
    size = 0
    for frame in frames:
        if size + len(frame.raw) > DATAGRAM_BYTES:
            found.append(b"".join(joined))
            joined, size = [], 0
        joined.append(frame.raw)
        size += len(frame.raw)
    if joined:
        found.append(b"".join(joined))
    return found
