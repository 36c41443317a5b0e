"""What goes on beside a test: in a thread of its own while a block lasts; and waiting until it has happened."""

from __future__ import annotations

import asyncio
import socket
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Self


class OwnThread(ABC):
    """Runs from the beginning of the block to its end, which waits for it.

    Args:
        name: of the thread.
        ends: closed when nobody reads from them any more.
    """

    def __init__(self, name: str, *ends: socket.socket) -> None:
        self._ends = ends
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name=name)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        for end in self._ends:
            end.close()

    @abstractmethod
    def _run(self) -> None:
        """Go on until `_stop` is set."""


async def until(ready: Callable[[], object], what: str = "", timeout_s: float = 60.0, period_s: float = 0.005) -> None:
    """Wait until something that others do has happened; the test fails when it does not."""
    give_up_s = time.monotonic() + timeout_s
    while not ready():
        assert time.monotonic() < give_up_s, f"not within {timeout_s:g} s: {what}"
        await asyncio.sleep(period_s)


def wait_until(ready: Callable[[], object], what: str = "", timeout_s: float = 60.0, period_s: float = 0.002) -> None:
    """The same where no event loop runs."""
    give_up_s = time.monotonic() + timeout_s
    while not ready():
        assert time.monotonic() < give_up_s, f"not within {timeout_s:g} s: {what}"
        time.sleep(period_s)
