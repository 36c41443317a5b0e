"""Where another computer's clock stands: from round trips, from stamps alone, and after it was set anew."""

from __future__ import annotations

import math
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.clock import ClockAlignment, MonotonicClock
from companion.clock.one_way import JUMP_COUNT
from companion.clock.rates import GRAIN_S

OFFSET_S = 2534.0
"""As seen between a companion's monotonic clock and an autopilot's time since boot."""


def trip(alignment: ClockAlignment, at_s: float, out_s: float, back_s: float, offset_s: float = OFFSET_S) -> None:
    """A question that took ``out_s`` and an answer that took ``back_s``."""
    alignment.add(at_s, at_s + out_s - offset_s, at_s + out_s + back_s)


def offset_s(alignment: ClockAlignment, remote_s: float) -> float:
    """Where the other clock is said to stand when it shows ``remote_s``."""
    local_s = alignment.to_local_s(remote_s)
    assert local_s is not None
    return local_s - remote_s


def test_the_monotonic_clock_is_that_of_the_computer() -> None:
    """Protects the one time base of the application."""
    before_s = time.monotonic()
    assert before_s <= MonotonicClock().now_s() <= time.monotonic()


def test_nothing_is_known_before_anything_was_heard() -> None:
    """Protects against stamping with a guess."""
    alignment = ClockAlignment()
    assert alignment.residual_s(5.0) is None
    assert alignment.to_local_s(5.0) is None
    assert alignment.rate is None
    assert alignment.round_trip_s is None


def test_the_quick_round_trips_are_believed() -> None:
    """Protects the alignment on a link where most answers wait in a queue."""
    alignment = ClockAlignment()
    for i in range(20):
        trip(alignment, 10.0 + i, 0.001, 0.08 if i % 4 else 0.001)
    assert offset_s(alignment, 29.0 - OFFSET_S) == pytest.approx(OFFSET_S, abs=1e-3)
    residual_s = alignment.residual_s(29.002)
    assert residual_s is not None
    assert residual_s < 0.001 + GRAIN_S + 0.002
    assert alignment.round_trip_s == pytest.approx(0.002)
    assert alignment.rate == 1.0


def test_crystals_that_drift_apart_are_followed() -> None:
    """Protects long flights: two crystals drift 6 ms a minute apart, and nobody takes that for a simulation."""
    alignment = ClockAlignment()
    for i in range(400):
        at_s = 5.0 * i
        trip(alignment, at_s, 0.002, 0.002, OFFSET_S + 100e-6 * at_s)
    now_s = 5.0 * 399
    assert offset_s(alignment, now_s - OFFSET_S) == pytest.approx(OFFSET_S + 100e-6 * now_s, abs=0.004)
    assert alignment.rate == pytest.approx(1.0, abs=150e-6)


def test_a_jump_seen_by_round_trips_restarts_the_alignment_at_the_second() -> None:
    """Protects the stamps after the autopilot was started again, and from one wrong answer, whose doubt is told."""
    alignment = ClockAlignment()
    for i in range(10):
        trip(alignment, 10.0 + i, 0.002, 0.002)
    trip(alignment, 21.0, 0.002, 0.002, OFFSET_S + 1000.0)
    assert offset_s(alignment, 21.0 - OFFSET_S) == pytest.approx(OFFSET_S)
    residual_s = alignment.residual_s(21.0)
    assert residual_s is not None
    assert 1000.0 < residual_s < 1002.0
    trip(alignment, 22.0, 0.002, 0.002, OFFSET_S + 1000.0)
    assert offset_s(alignment, 22.0 - OFFSET_S - 1000.0) == pytest.approx(OFFSET_S + 1000.0)
    residual_s = alignment.residual_s(22.0)
    assert residual_s is not None
    assert residual_s < 0.01


def test_stamps_alone_give_the_least_delay() -> None:
    """Protects sensors that cannot be asked: the delay that is seen least is the nearest to the truth."""
    alignment = ClockAlignment()
    for i in range(150):
        received_s = OFFSET_S + 0.02 * i + 0.004 + 0.03 * (i % 5)
        alignment.add_one_way(0.02 * i, received_s)
        if i < 40:
            assert alignment.residual_s(received_s) is None, "one second says nothing about the next"
    assert offset_s(alignment, 3.0) == pytest.approx(OFFSET_S + 0.004)
    assert alignment.residual_s(received_s) == pytest.approx(0.0, abs=1e-3)
    assert alignment.round_trip_s is None


@pytest.mark.parametrize("away_s", [-50.0, 50.0])
def test_one_stray_stamp_is_ignored_and_several_in_a_row_are_a_new_clock(away_s: float) -> None:
    """Protects against a replayed or corrupt packet, and still notices an autopilot that was started again."""
    alignment = ClockAlignment()
    for i in range(200):
        alignment.add_one_way(100.0 + 0.02 * i, 500.0 + 0.02 * i)
    trip(alignment, 504.0, 0.001, 0.001, 400.0)
    for stray in range(JUMP_COUNT - 1):
        alignment.add_one_way(104.0 + away_s + 0.02 * stray, 504.0 + 0.02 * stray)
    assert offset_s(alignment, 104.0) == pytest.approx(400.0)
    alignment.add_one_way(104.1, 504.1)
    assert alignment.restarts == 0
    for i in range(JUMP_COUNT):
        alignment.add_one_way(104.2 + away_s + 0.02 * i, 504.2 + 0.02 * i)
    assert alignment.restarts == 1
    assert offset_s(alignment, 104.3 + away_s) == pytest.approx(400.0 - away_s)


def test_answers_about_another_clock_are_not_believed() -> None:
    """Protects against a time service whose clock is not that of the stamps: off by half an hour after a minute."""
    alignment = ClockAlignment()
    for i in range(10):
        alignment.add_one_way(1.0 + i, 501.0 + i + 0.01)
        trip(alignment, 501.0 + i, 0.001, 0.001, -2534.0)
    assert offset_s(alignment, 10.0) == pytest.approx(500.01)
    assert alignment.round_trip_s is None


@given(st.lists(st.tuples(st.sampled_from(["trip", "one way"]), st.floats(), st.floats(), st.floats()), max_size=40))
def test_no_number_that_comes_in_makes_nan_come_out(events: list[tuple[str, float, float, float]]) -> None:
    """Protects every stamp from one malformed message."""
    alignment = ClockAlignment()
    for kind, first_s, second_s, third_s in events:
        if kind == "trip":
            alignment.add(first_s, second_s, third_s)
        else:
            alignment.add_one_way(first_s, second_s)
    local_s = alignment.to_local_s(1.0)
    assert local_s is None or math.isfinite(local_s)
    assert alignment.to_local_s(math.nan) is None
    for now_s in (-1e12, 0.0, 1.0, 1e12):
        residual_s = alignment.residual_s(now_s)
        assert residual_s is None or (math.isfinite(residual_s) and residual_s >= 0.0)
    assert alignment.rate is None or 0.95 < alignment.rate < 1.06


def test_what_cannot_be_is_counted() -> None:
    """Protects the count that shows a peer which answers before it is asked."""
    alignment = ClockAlignment()
    alignment.add(2.0, 1.0, 1.0)
    alignment.add(1.0, math.inf, 2.0)
    alignment.add(1.7e308, 1.0, 1.7e308)
    alignment.add_one_way(math.nan, 2.0)
    assert alignment.refused == 4
    assert alignment.to_local_s(1.0) is None


async def test_the_clock_of_this_computer_waits_for_real() -> None:
    clock = MonotonicClock()
    began_s = clock.now_s()
    await clock.sleep(0.02)
    assert clock.now_s() - began_s >= 0.02
