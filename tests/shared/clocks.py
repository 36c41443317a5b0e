"""Clocks that tests hand in."""

from __future__ import annotations

import asyncio
import bisect
import time
from collections.abc import Callable

IDLE_ROUNDS = 8
"""Rounds of the event loop after which nobody has anything left to do at this time."""


class HandClock:
    """A clock that stands still until it is moved; when everybody sleeps, it goes on to whoever wakes first."""

    def __init__(self, now_s: float = 1000.0) -> None:
        self.time_s = now_s
        self.pass_by: Callable[[float], None] = self.advance
        """Lets time pass while everybody sleeps; a simulation puts its steps in its place."""
        self._wakings: list[float] = []

    def now_s(self) -> float:
        return self.time_s

    def advance(self, by_s: float) -> None:
        self.time_s += by_s

    async def sleep(self, time_s: float) -> None:
        """Virtual time passes."""
        waking_s = self.time_s + time_s
        bisect.insort(self._wakings, waking_s)
        try:
            rounds = 0
            await asyncio.sleep(0)
            while self.time_s < waking_s:
                rounds = rounds + 1 if self._wakings[0] == waking_s else 0
                if rounds > IDLE_ROUNDS:
                    self.pass_by(waking_s - self.time_s)
                    self.time_s = max(self.time_s, waking_s)
                await asyncio.sleep(0)
        finally:
            self._wakings.remove(waking_s)


class AheadClock:
    """The clock of another computer: ours, set differently."""

    def __init__(self, ahead_s: float) -> None:
        self._ahead_s = ahead_s

    def now_s(self) -> float:
        return time.monotonic() + self._ahead_s

    async def sleep(self, time_s: float) -> None:
        await asyncio.sleep(time_s)
