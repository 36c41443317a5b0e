"""Waiting for what arrives, from descriptors that come and go."""

from __future__ import annotations

import selectors
from collections.abc import Callable

Serve = Callable[[float], None]


class Selector:
    """What is waited for, and who is called when something is there: the lowest rank first."""

    def __init__(self) -> None:
        self._selector = selectors.DefaultSelector()
        self._known: dict[int, int] = {}

    def follow(self, rank: int, fd: int | None, serve: Serve) -> None:
        """From now on the door of this rank is ``fd``, or none. A change has to be told before the number is reused."""
        before = self._known.get(rank)
        if before == fd:
            return
        if before is not None:
            self._selector.unregister(before)
            del self._known[rank]
        if fd is not None:
            self._selector.register(fd, selectors.EVENT_READ, (rank, serve))
            self._known[rank] = fd

    def wait(self, timeout_s: float) -> list[Serve]:
        """Whom to call, in order; empty when the time is over, which may be 1 ms late."""
        ready = self._selector.select(max(0.0, timeout_s))
        if len(ready) > 1:
            ready.sort(key=lambda found: found[0].data[0])
        return [found.data[1] for found, _ in ready]

    def close(self) -> None:
        """Wait for nothing more."""
        self._selector.close()
