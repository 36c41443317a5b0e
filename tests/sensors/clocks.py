"""Clocks for the tests of drivers."""

from __future__ import annotations

import asyncio
import time


class HandClock:
    """Stands still until it is set."""

    def __init__(self, now_s: float = 100.0) -> None:
        self.now = now_s

    def now_s(self) -> float:
        return self.now

    async def sleep(self, time_s: float) -> None:
        self.now += time_s
        await asyncio.sleep(0)


class AheadClock:
    """The clock of another computer: ours, set differently."""

    def __init__(self, ahead_s: float) -> None:
        self._ahead_s = ahead_s

    def now_s(self) -> float:
        return time.monotonic() + self._ahead_s

    async def sleep(self, time_s: float) -> None:
        await asyncio.sleep(time_s)
