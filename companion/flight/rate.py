"""A fixed rate without catching up."""

from __future__ import annotations

from collections.abc import AsyncIterator

from companion.clock import Clock


class Rate:
    """Gives one time a period. A tick that came too late is counted and not repeated.

    Args:
        clock: what time it is.
        period_s: the sampling period.
    """

    def __init__(self, clock: Clock, period_s: float) -> None:
        self.missed = 0
        """Periods in which no tick could begin."""
        self._clock = clock
        self._period_s = period_s

    async def ticks(self) -> AsyncIterator[float]:
        """The time of each tick, for ever."""
        next_s = self._clock.now_s()
        while True:
            now_s = self._clock.now_s()
            late_s = now_s - next_s
            if late_s >= self._period_s:
                missed = int(late_s / self._period_s)
                self.missed += missed
                next_s += missed * self._period_s
            yield now_s
            next_s += self._period_s
            await self._clock.sleep(max(0.0, next_s - self._clock.now_s()))
