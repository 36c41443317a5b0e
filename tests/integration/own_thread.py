"""What goes on beside a test: in a thread of its own, while a block lasts."""

from __future__ import annotations

import socket
import threading
from abc import ABC, abstractmethod
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
