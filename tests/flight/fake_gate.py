"""The gate's end of what the application has of it: what was said is kept, what is to be heard is handed in."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from collections.abc import Sequence
from types import TracebackType

from companion.flight.gate_socket import GateLink
from companion.gate.protocol import BEAT_FD, GATE_URL, Beat, Goodbye, unpacked

DEAF_PORT = 9
"""The discard port: nobody answers there."""


class FakeGate:
    """One end of a pair of sockets; the other is the application's.

    Attributes:
        link: the application's end, for tests in one process.
    """

    def __init__(self) -> None:
        self._ours, self._its = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._ours.setblocking(False)
        self.link = GateLink(self._its, f"udpout://127.0.0.1:{DEAF_PORT}")

    def __enter__(self) -> FakeGate:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.die()
        self._its.close()

    def say(self, text: str) -> None:
        """A notice."""
        self._ours.send(text.encode())

    def die(self) -> None:
        """As if it had been killed."""
        self._ours.close()

    def heard(self) -> list[Beat | Goodbye]:
        """What was said since the last call."""
        found: list[Beat | Goodbye] = []
        while True:
            try:
                data = self._ours.recv(4096)
            except BlockingIOError:
                return found
            if not data:
                return found
            said = unpacked(data)
            assert said is not None, f"the gate cannot read {data!r}"
            found.append(said)

    def beats(self) -> list[Beat]:
        """The beats since the last call."""
        return [said for said in self.heard() if isinstance(said, Beat)]

    def run(
        self, *words: str, inherit: Sequence[int] = (), timeout_s: float = 90.0
    ) -> subprocess.CompletedProcess[str]:
        """The application as the gate starts it, until it has ended."""
        self._its.set_inheritable(True)
        number = self._its.fileno()
        return subprocess.run(
            [sys.executable, "-m", "companion.flight", *words],
            env={**os.environ, BEAT_FD: str(number), GATE_URL: self.link.url},
            pass_fds=(number, *inherit),
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=timeout_s,
            check=False,
        )
