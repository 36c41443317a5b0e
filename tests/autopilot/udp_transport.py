"""A transport over UDP on loopback, for tests in which no gate stands between the link and the autopilot."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Callable

from tests.integration.own_thread import OwnThread

Address = tuple[str, int]


class UdpTransport(OwnThread):
    """Listens on a port of loopback and answers whoever has spoken there. Implements `Transport`.

    Args:
        port: of 127.0.0.1.
    """

    def __init__(self, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.settimeout(0.01)
        super().__init__("udp transport", self._socket)
        self._port = port
        self._peers: set[Address] = set()
        self._on_frames: Callable[[bytes], None] = _nothing

    def open(self, on_frames: Callable[[bytes], None]) -> None:
        """See `Transport.open`."""
        self._socket.bind(("127.0.0.1", self._port))
        self._on_frames = on_frames
        self.__enter__()

    def send(self, raw: bytes) -> None:
        """See `Transport.send`."""
        for peer in tuple(self._peers):
            with contextlib.suppress(OSError):
                self._socket.sendto(raw, peer)

    def close(self) -> None:
        """See `Transport.close`."""
        self._on_frames = _nothing
        self.__exit__(None, None, None)

    def _run(self) -> None:
        while not self._stop.is_set():
            try:
                data, peer = self._socket.recvfrom(65536)
            except OSError:
                continue
            self._peers.add(peer)
            self._on_frames(data)


def _nothing(_frames: bytes) -> None:
    """Nobody is there yet, or any more."""
