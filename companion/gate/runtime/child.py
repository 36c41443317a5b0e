"""The application: its process, and the two ways in which it is heard.

MAVLink comes over a UDP socket on 127.0.0.1, because that is what MAVSDK speaks. The kernel tells to whom its port
belongs: the first datagram that comes from the child's own socket is the last from anybody else, for the gate's socket
is then connected to that one, and the kernel drops what others send. Beats come over a pair of sockets of which the
child was given one end when it was started. There is no token that could be read, guessed or sent again.
"""

from __future__ import annotations

import contextlib
import os
import signal
import socket
from collections.abc import Sequence

from companion.gate.protocol import BEAT_FD, GATE_URL
from companion.gate.runtime.framing import Inflow
from companion.gate.runtime.processes import spawn
from companion.gate.runtime.systemd import VARIABLES
from companion.gate.runtime.udp import Address, datagram_socket
from companion.gate.runtime.udp_owner import holds
from companion.mavlink.codec import Frame

LOOPBACK = "127.0.0.1"
MOST_FRAMES = 32
"""Messages taken in one call."""
MOST_BEATS = 32
BUFFER_BYTES = 32768
"""Asked of the kernel for what the application sends, which makes about 80 small messages that can wait: in a flood the
newest are lost instead of all being late, and they are read in 10 ms."""
RECEIVE_BYTES = 2048
BEAT_BYTES = 256
NOTICE_BYTES = 240
REFUSED_S = 1.0
"""A port that was not the child's is not looked up again for this long."""
MOST_REFUSED = 64


class Child:
    """One process of the application, started when this is made.

    Args:
        command: program and arguments.
        inherit: file descriptors besides the standard ones and its socket to the gate.
        nice: its niceness.

    Attributes:
        pid: of the process, which is a child, or a zombie, until `companion.gate.runtime.processes.deaths`.
        silent: whether the child has closed its end of the beats.
        strangers: datagrams of others.
        unsent: datagrams that it did not take.

    Raises:
        OSError: it cannot be started.
    """

    def __init__(self, command: Sequence[str], inherit: Sequence[int], nice: int) -> None:
        self.silent = False
        self.strangers = self.unsent = 0
        self.inflow = Inflow(None, datagram=True)
        self._peer: Address | None = None
        self._refused: dict[int, float] = {}
        with contextlib.ExitStack() as undo:
            self._beats, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
            with theirs:
                undo.callback(self._beats.close)
                self._beats.setblocking(False)
                self._socket = datagram_socket(BUFFER_BYTES)
                undo.callback(self._socket.close)
                self._socket.bind((LOOPBACK, 0))
                self.port: int = self._socket.getsockname()[1]
                for fd in inherit:
                    # What was read by the one before is read again from its beginning.
                    with contextlib.suppress(OSError):
                        os.lseek(fd, 0, os.SEEK_SET)
                environment = {name: value for name, value in os.environ.items() if name not in VARIABLES}
                environment[BEAT_FD] = str(theirs.fileno())
                environment[GATE_URL] = f"udpout://{LOOPBACK}:{self.port}"
                self.pid = spawn(command, environment, (theirs.fileno(), *inherit), nice)
            undo.pop_all()

    def fileno(self) -> int:
        """Where its MAVLink arrives."""
        return self._socket.fileno()

    def beats_fileno(self) -> int | None:
        """Where its beats arrive; None: it has closed its end."""
        return None if self.silent else self._beats.fileno()

    def beats(self) -> list[bytes]:
        """Beats and its last word, as they came; a bounded number."""
        found: list[bytes] = []
        while len(found) < MOST_BEATS and not self.silent:
            try:
                data = self._beats.recv(BEAT_BYTES)
            except BlockingIOError:
                break
            except OSError:
                data = b""
            if data:
                found.append(data)
            self.silent = not data
        return found

    def frames(self, now_s: float) -> list[Frame]:
        """Its MAVLink messages; a bounded number."""
        found: list[Frame] = []
        for _ in range(MOST_FRAMES):
            if len(found) >= MOST_FRAMES:
                break
            try:
                data, sender = self._socket.recvfrom(RECEIVE_BYTES)
            except OSError:
                # Nothing there; or the answer to what was sent while it closed its socket.
                break
            # Also when connected: strangers' datagrams may have waited there before.
            if sender == self._peer or (self._peer is None and self._is_its_own(sender, now_s)):
                found += self.inflow.frames(data)
            else:
                self.strangers += 1
        return found

    def send(self, raw: bytes) -> None:
        """Whole messages to the application; what it does not take now is lost."""
        try:
            if self._peer is None:
                raise BlockingIOError
            self._socket.send(raw)
        except OSError:
            self.unsent += 1

    def notify(self, words: str) -> None:
        """Tell it something that its operator should read; lost when it does not listen."""
        with contextlib.suppress(OSError):
            self._beats.send(words.encode()[:NOTICE_BYTES])

    def signal(self, number: signal.Signals) -> None:
        """Send it a signal."""
        with contextlib.suppress(OSError):
            os.kill(self.pid, number)

    def close(self) -> None:
        """Hear nothing more of it."""
        self._beats.close()
        self._socket.close()

    def _is_its_own(self, sender: Address, now_s: float) -> bool:
        port = sender[1]
        refused_s = self._refused.get(port)
        if refused_s is not None and now_s < refused_s + REFUSED_S:
            return False
        if not holds(self.pid, port):
            if len(self._refused) >= MOST_REFUSED:
                self._refused.clear()
            self._refused[port] = now_s
            return False
        self._peer = sender
        # It cannot fail for an address from which something has just come.
        self._socket.connect(sender)
        return True
