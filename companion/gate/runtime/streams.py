"""Links that are streams of bytes: whatever is opened, and TCP."""

from __future__ import annotations

import contextlib
import errno
import os
import socket
from typing import Protocol

from companion.gate.runtime.framing import Accept, FrameReader, FrameWriter, Reconnect
from companion.mavlink.codec import Frame

READ_BYTES = 4096
SILENT_MS = 5000
"""A TCP connection in which nothing was acknowledged for this long is over."""
SYN_RETRIES = 2
"""A connection that is not answered is given up after 7 s, and asked for anew."""
CLOSED = "closed by the other end"


class Line(Protocol):
    """A stream that is open."""

    def fileno(self) -> int:
        """Its descriptor, which never blocks."""
        ...

    def close(self) -> None:
        """End it."""
        ...


class Opener(Protocol):
    """Opens one stream after the other."""

    most_waiting: int
    """Bytes that may wait in a stream before nothing more is given to it."""
    lost: str
    """What it means when a stream has ended, in words."""

    def fileno(self) -> int | None:
        """What becomes readable when somebody may be let in; None: nobody comes."""
        ...

    def open(self) -> Line | None:
        """A new stream; None: not yet.

        Raises:
            OSError: try again in a while.
        """
        ...

    def close(self) -> None:
        """End it."""
        ...


class StreamTransport:
    """A stream, opened anew whenever it was lost.

    Args:
        opener: opens it.
        accept: see `FrameReader`.
    """

    def __init__(self, opener: Opener, accept: Accept | None) -> None:
        self.unsent = self.strangers = 0
        self.problem = ""
        self.reader = FrameReader(accept, datagram=False)
        self._writer = FrameWriter(opener.most_waiting)
        self._opener = opener
        self._line: Line | None = None
        self._reconnect = Reconnect()

    def fileno(self) -> int | None:
        """See `Transport`."""
        return self._opener.fileno() if self._line is None else self._line.fileno()

    def receive(self, now_s: float) -> list[Frame]:
        """See `Transport`."""
        if self._line is None:
            self._open(now_s)
            return []
        try:
            data = os.read(self._line.fileno(), READ_BYTES)
        except BlockingIOError:
            return []
        except OSError:
            data = b""
        if not data:
            # A descriptor of the same number must not be taken for this one: the next is opened later.
            self._line.close()
            self._line = None
            self.problem = self._opener.lost
            self._reconnect.failed(now_s)
        return self.reader.frames(data)

    def send(self, raw: bytes) -> None:
        """See `Transport`."""
        if self._line is None or not self._writer.put(self._line.fileno(), raw):
            self.unsent += 1

    def tick(self, now_s: float) -> None:
        """See `Transport`."""
        if self._line is not None:
            # What is wrong with it shows when it is read.
            with contextlib.suppress(OSError):
                self._writer.flush(self._line.fileno())
        elif self._reconnect.due(now_s):
            self._open(now_s)

    def close(self) -> None:
        """See `Transport`."""
        if self._line is not None:
            self._line.close()
            self._line = None
        self._opener.close()

    def _open(self, now_s: float) -> None:
        try:
            self._line = self._opener.open()
        except OSError as error:
            self.problem = str(error)
            self._reconnect.failed(now_s)
            return
        if self._line is not None:
            self.problem = ""
            self.reader.restart()
            self._writer.restart()


class TcpIn:
    """Lets one client in at a time; the next waits at the door until it is gone.

    Args:
        local: host and port.
        most_waiting: see `Opener`.

    Raises:
        OSError: the port is taken, or is not ours to take.
    """

    def __init__(self, local: tuple[str, int], most_waiting: int) -> None:
        self.most_waiting = most_waiting
        self.lost = CLOSED
        self._listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        try:
            self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self._listener.setblocking(False)
            self._listener.bind(local)
            self._listener.listen(1)
        except OSError:
            self._listener.close()
            raise

    def fileno(self) -> int | None:
        """See `Opener`."""
        return self._listener.fileno()

    def open(self) -> Line | None:
        """See `Opener`."""
        try:
            client, _ = self._listener.accept()
        except BlockingIOError:
            return None
        return _prepared(client)

    def close(self) -> None:
        """See `Opener`."""
        self._listener.close()


class TcpOut:
    """Connects to an address.

    Args:
        remote: host and port.
        most_waiting: see `Opener`.
    """

    def __init__(self, remote: tuple[str, int], most_waiting: int) -> None:
        self.most_waiting = most_waiting
        self.lost = CLOSED
        self._remote = remote
        self._pending: socket.socket | None = None

    def fileno(self) -> int | None:
        """See `Opener`."""
        return None

    def open(self) -> Line | None:
        """See `Opener`."""
        if self._pending is None:
            self._pending = _prepared(socket.socket(socket.AF_INET, socket.SOCK_STREAM))
            self._pending.setsockopt(socket.IPPROTO_TCP, socket.TCP_SYNCNT, SYN_RETRIES)
        result = self._pending.connect_ex(self._remote)
        if result in (errno.EINPROGRESS, errno.EALREADY):
            return None
        made, self._pending = self._pending, None
        if result not in (0, errno.EISCONN):
            made.close()
            raise OSError(result, os.strerror(result))
        return made

    def close(self) -> None:
        """See `Opener`."""
        if self._pending is not None:
            self._pending.close()
            self._pending = None


def _prepared(stream: socket.socket) -> socket.socket:
    stream.setblocking(False)
    stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, SILENT_MS)
    return stream
