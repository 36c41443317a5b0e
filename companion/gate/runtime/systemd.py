"""Tells the service manager how it goes, by systemd's protocol (sd_notify)."""

from __future__ import annotations

import contextlib
import math
import os
import socket
from collections.abc import Mapping

VARIABLES = ("NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID")
"""Of the environment; for this process, not for its children."""

FEEDS = 4
"""In the time after which the service manager would give us up."""


class ServiceManager:
    """Says nothing where nobody listens.

    Args:
        environment: of this process.
    """

    def __init__(self, environment: Mapping[str, str]) -> None:
        self._address = environment.get("NOTIFY_SOCKET", "").replace("@", "\0", 1)
        self._socket: socket.socket | None = None
        self._period_s = _period_s(environment)
        self._due_s = -math.inf if self._period_s < math.inf else math.inf
        if self._address:
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
            self._socket.setblocking(False)

    def ready(self) -> None:
        """The link is open, and the application was started."""
        self._tell("READY=1")

    def status(self, words: str) -> None:
        """One line for people."""
        self._tell(f"STATUS={words}")

    def cycle(self, now_s: float) -> None:
        """A cycle was completed: the watchdog is fed, when it is time."""
        if now_s >= self._due_s:
            self._due_s = now_s + self._period_s
            self._tell("WATCHDOG=1")

    def stopping(self) -> None:
        """The end has begun."""
        self._tell("STOPPING=1")

    def close(self) -> None:
        """Say nothing more."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _tell(self, words: str) -> None:
        if self._socket is not None:
            # A service manager that does not listen is its own affair.
            with contextlib.suppress(OSError):
                self._socket.sendto(words.encode(), self._address)


def _period_s(environment: Mapping[str, str]) -> float:
    """Time between two feeds; infinite: there is no watchdog, or not for this process."""
    try:
        limit_s = int(environment.get("WATCHDOG_USEC", "")) / 1e6
        owner = int(environment.get("WATCHDOG_PID", str(os.getpid())))
    except ValueError:
        return math.inf
    return limit_s / FEEDS if owner == os.getpid() and limit_s > 0.0 else math.inf
