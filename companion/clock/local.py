"""Where time comes from: the clock of this computer, or one on which no real time passes."""

from __future__ import annotations

import asyncio
import time
from typing import Protocol


class Clock(Protocol):
    """Where time comes from, and who waits for it; tests hand in one on which no real time passes."""

    def now_s(self) -> float:
        """Seconds since some fixed moment; never goes back."""
        ...

    async def sleep(self, time_s: float) -> None:
        """Return when ``time_s`` has passed on this clock; others run meanwhile, also when it is 0 or less."""
        ...


class MonotonicClock:
    """The clock of this computer that no one can set."""

    def now_s(self) -> float:
        """Seconds of `time.monotonic`."""
        return time.monotonic()

    async def sleep(self, time_s: float) -> None:
        """Real time passes."""
        await asyncio.sleep(time_s)
