"""The rate of the loop, and that nothing is caught up after a hang."""

from __future__ import annotations

import pytest

from companion.flight.rate import Rate
from tests.autopilot.fake_link import HandClock


async def test_each_tick_is_a_period_after_the_last() -> None:
    """The time that a tick takes does not add to the period."""
    clock = HandClock(5.0)
    times = await ticks(Rate(clock, 0.05), clock, [0.01, 0.02, 0.0])
    assert times == pytest.approx([5.0, 5.05, 5.1, 5.15])


async def test_missed_periods_are_counted_and_not_made_up_for() -> None:
    """After a hang of 0.5 s one tick comes at once, and the next one a period later: no burst of old setpoints."""
    clock = HandClock(0.0)
    rate = Rate(clock, 0.05)
    times = await ticks(rate, clock, [0.51, 0.0, 0.0])
    assert times[1] == pytest.approx(0.51)
    assert times[2] == pytest.approx(0.55)
    assert rate.missed == 9


async def ticks(rate: Rate, clock: HandClock, work_s: list[float]) -> list[float]:
    """The times of ticks which take that long, and of the one after them."""
    times: list[float] = []
    async for now_s in rate.ticks():
        times.append(now_s)
        if len(times) > len(work_s):
            break
        clock.advance(work_s[len(times) - 1])
    return times
