"""The gate's end of what the application has of it: what was said is kept, what is to be heard is handed in."""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import sys
import threading
from collections.abc import Sequence
from typing import IO

from companion.flight.gate_socket import GateSocket
from companion.gate.faults import Stage
from companion.gate.protocol import GATE_FD, Beat, Goodbye, Notice, is_mavlink, unpacked

MARK = b"\xfd"
"""No message, but passed on as if it were one: what was sent before it has been read by then."""


def end(link: GateSocket) -> None:
    """Close the application's end, as the end of its process does."""
    with contextlib.suppress(OSError):
        link._end.shutdown(socket.SHUT_RDWR)
    link._reader.join()
    link._end.close()


class FakeGate:
    """One end of a pair of sockets; the other is the application's.

    Attributes:
        link: the application's end, for tests in one process.
    """

    def __init__(self) -> None:
        self._ours, self._its = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._ours.setblocking(False)
        self.link = GateSocket(self._its)
        self._read = threading.Event()
        self.link.open(lambda frames: self._read.set() if frames == MARK else None)

    def __enter__(self) -> FakeGate:
        return self

    def __exit__(self, *_: object) -> None:
        self.die()
        end(self.link)

    def say(self, *texts: str) -> None:
        """Give notices that only tell something, and return when they have been read."""
        self.notify(*(Notice(Stage.PASS, None, text) for text in texts))

    def notify(self, *notices: Notice) -> None:
        """Give notices, and return when they have been read."""
        for notice in notices:
            self._ours.send(notice.packed())
        self._read.clear()
        self._ours.send(MARK)
        assert self._read.wait(10.0), "the application reads nothing"

    def die(self) -> None:
        """As if it had been killed; returns when that has been noticed."""
        self._ours.close()
        self.link._reader.join(10.0)

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
            if is_mavlink(data):
                continue
            said = unpacked(data)
            assert said is not None, f"the gate cannot read {data!r}"
            found.append(said)

    def beats(self) -> list[Beat]:
        """The beats since the last call."""
        return [said for said in self.heard() if isinstance(said, Beat)]

    def run(
        self,
        *words: str,
        inherit: Sequence[int] = (),
        timeout_s: float = 90.0,
        program: Sequence[str] = ("-m", "companion.flight"),
        stdout: IO[bytes] | int = subprocess.PIPE,
    ) -> subprocess.CompletedProcess[str]:
        """The application as the gate starts it, until it has ended."""
        self._its.set_inheritable(True)
        number = self._its.fileno()
        return subprocess.run(
            [sys.executable, *program, *words],
            env={**os.environ, GATE_FD: str(number)},
            pass_fds=(number, *inherit),
            stdin=subprocess.DEVNULL,
            stdout=stdout,
            stderr=subprocess.PIPE,
            text=True,
            timeout=timeout_s,
            check=False,
        )
