"""Where another computer's clock stands: from round trips, from stamps alone, and after it was set anew."""

from __future__ import annotations

import math
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.clock import BUCKET_S, BUCKETS, JUMP_COUNT, ROUND_TRIPS, ClockAlignment, MonotonicClock

OFFSET_S = 2534.0
"""As seen between a companion's monotonic clock and an autopilot's time since boot."""


def trip(alignment: ClockAlignment, at_s: float, out_s: float, back_s: float, offset_s: float = OFFSET_S) -> None:
    """A question that took ``out_s`` and an answer that took ``back_s``."""
    alignment.add(at_s, at_s + out_s - offset_s, at_s + out_s + back_s)


def test_the_monotonic_clock_is_that_of_the_computer() -> None:
    """Protects the one time base of the application."""
    before_s = time.monotonic()
    assert before_s <= MonotonicClock().now_s() <= time.monotonic()


def test_nothing_is_known_before_anything_was_heard() -> None:
    """Protects against stamping with a guess."""
    alignment = ClockAlignment()
    assert alignment.offset_s is None
    assert alignment.residual_s is None
    assert alignment.to_local_s(5.0) is None


delays = st.floats(0.0, 0.2)


@given(st.lists(st.tuples(delays, delays), min_size=1, max_size=60))
def test_the_residual_bounds_the_error_whatever_the_delays(trips: list[tuple[float, float]]) -> None:
    """Protects the number that is reported as the bound of the clock's error."""
    alignment = ClockAlignment()
    for i, (out_s, back_s) in enumerate(trips):
        trip(alignment, 10.0 + i, out_s, back_s)
    assert alignment.offset_s is not None
    assert alignment.residual_s is not None
    assert abs(alignment.offset_s - OFFSET_S) <= alignment.residual_s + 1e-9
    quickest_s = min(out_s + back_s for out_s, back_s in trips[-ROUND_TRIPS:])
    assert alignment.residual_s >= 0.5 * quickest_s - 1e-9


def test_the_quick_round_trips_are_believed() -> None:
    """Protects the alignment on a link where most answers wait in a queue."""
    alignment = ClockAlignment()
    for i in range(20):
        trip(alignment, 10.0 + i, 0.001, 0.08 if i % 4 else 0.001)
    assert alignment.offset_s == pytest.approx(OFFSET_S, abs=1e-6)
    assert alignment.residual_s == pytest.approx(0.001, abs=1e-6)
    assert alignment.to_local_s(7.0) == pytest.approx(OFFSET_S + 7.0)


def test_a_clock_that_drifts_is_followed() -> None:
    """Protects long flights: two crystals drift 3 ms a minute apart."""
    alignment = ClockAlignment()
    for i in range(400):
        at_s = 5.0 * i
        trip(alignment, at_s, 0.002, 0.002, OFFSET_S + 50e-6 * at_s)
    assert alignment.offset_s == pytest.approx(OFFSET_S + 50e-6 * 5.0 * 399, abs=0.004)


def test_a_jump_seen_by_a_round_trip_restarts_the_alignment_at_once() -> None:
    """Protects the stamps after the autopilot was started again in flight preparation."""
    alignment = ClockAlignment()
    for i in range(10):
        trip(alignment, 10.0 + i, 0.002, 0.002)
    trip(alignment, 21.0, 0.002, 0.002, OFFSET_S + 1000.0)
    assert alignment.offset_s == pytest.approx(OFFSET_S + 1000.0)


def test_stamps_alone_give_the_least_delay() -> None:
    """Protects sensors that cannot be asked: the delay that is seen least is the nearest to the truth."""
    alignment = ClockAlignment()
    for i in range(100):
        alignment.add_one_way(0.02 * i, OFFSET_S + 0.02 * i + 0.004 + 0.03 * (i % 5))
        if i < 40:
            assert alignment.residual_s is None, "one second says nothing about the next"
    assert alignment.offset_s == pytest.approx(OFFSET_S + 0.004)
    assert alignment.residual_s is not None


def test_a_least_delay_is_forgotten_after_its_window() -> None:
    """Protects against a clock that runs slower than ours, as a simulation that does not keep up."""
    alignment = ClockAlignment()
    for i in range(3000):
        received_s = 0.02 * i
        alignment.add_one_way(0.95 * received_s, received_s)
    assert alignment.offset_s is not None
    assert 0.05 * 60.0 - alignment.offset_s <= 0.05 * (BUCKET_S * BUCKETS + BUCKET_S)


@pytest.mark.parametrize("away_s", [-50.0, 50.0])
def test_one_stray_stamp_is_ignored_and_several_in_a_row_are_a_new_clock(away_s: float) -> None:
    """Protects against a replayed or corrupt packet, and still notices an autopilot that was started again."""
    alignment = ClockAlignment()
    for i in range(200):
        alignment.add_one_way(100.0 + 0.02 * i, 500.0 + 0.02 * i)
    trip(alignment, 504.0, 0.001, 0.001, 400.0)
    for stray in range(JUMP_COUNT - 1):
        alignment.add_one_way(104.0 + away_s + 0.02 * stray, 504.0 + 0.02 * stray)
    assert alignment.offset_s == pytest.approx(400.0)
    alignment.add_one_way(104.1, 504.1)
    assert alignment.restarts == 0
    for i in range(JUMP_COUNT):
        alignment.add_one_way(104.2 + away_s + 0.02 * i, 504.2 + 0.02 * i)
    assert alignment.restarts == 1
    assert alignment.offset_s == pytest.approx(400.0 - away_s)


def test_answers_about_another_clock_are_not_believed() -> None:
    """Protects against a time service whose clock is not that of the stamps: off by half an hour after a minute."""
    alignment = ClockAlignment()
    for i in range(10):
        alignment.add_one_way(1.0 + i, 501.0 + i + 0.01)
        trip(alignment, 501.0 + i, 0.001, 0.001, -2534.0)
    assert alignment.offset_s == pytest.approx(500.01)


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
    assert alignment.residual_s is None or alignment.residual_s >= 0.0


def test_what_cannot_be_is_counted() -> None:
    """Protects the count that shows a peer which answers before it is asked."""
    alignment = ClockAlignment()
    alignment.add(2.0, 1.0, 1.0)
    alignment.add(1.0, math.inf, 2.0)
    alignment.add(1.7e308, 1.0, 1.7e308)
    alignment.add_one_way(math.nan, 2.0)
    assert alignment.refused == 4
    assert alignment.offset_s is None


async def test_the_clock_of_this_computer_waits_for_real() -> None:
    clock = MonotonicClock()
    began_s = clock.now_s()
    await clock.sleep(0.02)
    assert clock.now_s() - began_s >= 0.02
