"""The application: its process, and the one socket over which it is heard and told.

The socket is one end of a pair that is made here, and whose other end only the child has. MAVLink and the words of
`companion.gate.protocol` come over it in the order in which they were sent, and nobody else can send there.
"""

from __future__ import annotations

import contextlib
import os
import signal
import socket
from collections.abc import Sequence

from companion.gate.protocol import GATE_FD, PACKET_BYTES, Notice, is_mavlink
from companion.gate.runtime.framing import FrameReader
from companion.gate.runtime.processes import spawn
from companion.gate.runtime.systemd import VARIABLES
from companion.mavlink.codec import Frame

MOST_PACKETS = 32
"""Taken in one call; others have their turn before the next."""
BUFFER_BYTES = 32768
"""Asked of the kernel for what the application sends, which makes about 80 small messages that can wait: in a flood the
newest are lost instead of all being late, and they are read in 10 ms."""


class Child:
    """One process of the application, started when this is made.

    Args:
        command: program and arguments.
        inherit: file descriptors besides the standard ones and its socket to the gate.
        nice: its niceness.

    Attributes:
        pid: of the process, which is a child, or a zombie, until `companion.gate.runtime.processes.deaths`.
        silent: whether the child has closed its end.
        reader: counts what came and was no message.
        unsent: packets that it did not take.

    Raises:
        OSError: it cannot be started.
    """

    def __init__(self, command: Sequence[str], inherit: Sequence[int], nice: int) -> None:
        self.silent = False
        self.unsent = 0
        self.reader = FrameReader(None, datagram=True)
        with contextlib.ExitStack() as undo:
            self._socket, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
            with theirs:
                undo.callback(self._socket.close)
                self._socket.setblocking(False)
                theirs.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, BUFFER_BYTES)
                for fd in inherit:
                    # What was read by the one before is read again from its beginning.
                    with contextlib.suppress(OSError):
                        os.lseek(fd, 0, os.SEEK_SET)
                environment = {name: value for name, value in os.environ.items() if name not in VARIABLES}
                environment[GATE_FD] = str(theirs.fileno())
                self.pid = spawn(command, environment, (theirs.fileno(), *inherit), nice)
            undo.pop_all()

    def fileno(self) -> int | None:
        """Where what it sends arrives; None: it has closed its end."""
        return None if self.silent else self._socket.fileno()

    def receive(self) -> list[Frame | bytes]:
        """What it has sent, in its order: MAVLink as frames, words as they came; a bounded number of packets."""
        found: list[Frame | bytes] = []
        for _ in range(MOST_PACKETS):
            if self.silent:
                break
            try:
                data = self._socket.recv(PACKET_BYTES)
            except BlockingIOError:
                break
            except OSError:
                data = b""
            if is_mavlink(data):
                found += self.reader.frames(data)
            elif data:
                found.append(data)
            self.silent = not data
        return found

    def send(self, raw: bytes) -> None:
        """Whole messages to the application; what it does not take now is lost."""
        try:
            self._socket.send(raw)
        except OSError:
            self.unsent += 1

    def notify(self, notice: Notice) -> None:
        """Tell it what the gate does; lost when it does not listen."""
        self.send(notice.packed())

    def signal(self, number: signal.Signals) -> None:
        """Send it a signal."""
        with contextlib.suppress(OSError):
            os.kill(self.pid, number)

    def close(self) -> None:
        """Hear nothing more of it."""
        self._socket.close()
