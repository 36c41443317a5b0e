"""A clock that runs faster or slower than ours, as a simulation's does: the error stays small and within its bound."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.clock import ClockAlignment
from companion.clock.rates import CRYSTAL_RATE, STEP_S

BEGAN_S = 1000.0
"""When the questions begin, on our clock."""
REMOTE_S = 3.0
"""What the other clock shows then."""
QUICK_S = 0.2
"""Between two questions to a clock that drifts."""
ROUNDING_S = 1e-6


@dataclass
class Remote:
    """Another clock: its rates, each for a second, the last for ever; and how it shows what it has."""

    rates: list[float]
    step_s: float = 0.0

    def true_s(self, local_s: float) -> float:
        """What a clock without steps would show at ``local_s`` of ours."""
        passed_s = local_s - BEGAN_S
        whole = max(min(int(passed_s), len(self.rates) - 1), 0)
        return REMOTE_S + sum(self.rates[:whole]) + self.rates[whole] * (passed_s - whole)

    def shown_s(self, local_s: float) -> float:
        """What it shows: the middle of its step."""
        true_s = self.true_s(local_s)
        return true_s if self.step_s == 0.0 else (math.floor(true_s / self.step_s) + 0.5) * self.step_s


@dataclass
class Errors:
    """What was seen, in s: the errors, and by how much the worst was beyond its bound."""

    seen_s: list[float]
    beyond_s: float


def ask(alignment: ClockAlignment, remote: Remote, trips: list[tuple[float, float, float]], looks: int = 4) -> Errors:
    """Ask at the times of ``trips`` (when, way out, way back), and look at the stamps of that moment ever again.

    Answers are heard in the order in which they arrive, also when they overtake each other.
    """
    heard = sorted((at_s + out_s + back_s, at_s, at_s + out_s) for at_s, out_s, back_s in trips)
    errors = Errors([], -math.inf)
    for (received_s, sent_s, answered_s), (following_s, _, _) in itertools.pairwise(
        [*heard, (heard[-1][0] + 1.0, 0, 0)]
    ):
        alignment.add(sent_s, remote.shown_s(answered_s), received_s)
        for look in range(looks + 1):
            now_s = received_s + (following_s - received_s) * look / looks
            local_s, residual_s = alignment.to_local_s(remote.true_s(now_s)), alignment.residual_s(now_s)
            assert local_s is not None
            assert residual_s is not None
            errors.seen_s.append(abs(local_s - now_s))
            errors.beyond_s = max(errors.beyond_s, errors.seen_s[-1] - residual_s)
    return errors


def every(gap_s: float, ways: list[tuple[float, float]], began_s: float = BEGAN_S) -> list[tuple[float, float, float]]:
    """Questions at even times."""
    return [(began_s + gap_s * i, out_s, back_s) for i, (out_s, back_s) in enumerate(ways)]


rates = st.floats(0.97, 1.03)
slow_rates = st.floats(0.969, 0.992)
delays = st.floats(0.0, 0.2)
quick = st.floats(0.0, 0.005)


@given(rates, st.lists(st.tuples(st.floats(0.05, 3.0), delays, delays), min_size=1, max_size=60))
def test_the_residual_bounds_the_error_whatever_rate_and_delays(
    rate: float, asked: list[tuple[float, float, float]]
) -> None:
    """Protects the number that is reported as the bound of the clock's error, between two answers too."""
    at_s = itertools.accumulate((gap_s for gap_s, _, _ in asked), initial=BEGAN_S)
    trips = [(sent_s, out_s, back_s) for sent_s, (_, out_s, back_s) in zip(at_s, asked, strict=False)]
    assert ask(ClockAlignment(), Remote([rate]), trips).beyond_s <= ROUNDING_S


@given(rates, st.lists(st.tuples(quick, quick), min_size=40, max_size=60))
def test_on_a_quick_link_the_error_is_of_milliseconds_whatever_the_rate(
    rate: float, ways: list[tuple[float, float]]
) -> None:
    """Protects poses: 0.1 s on the clock of a simulation are 0.1 s of its flight, but not of ours."""
    errors = ask(ClockAlignment(), Remote([rate]), every(QUICK_S, ways))
    settled_s = errors.seen_s[len(errors.seen_s) // 4 :]
    assert max(settled_s) < 0.01
    assert errors.beyond_s <= ROUNDING_S


@given(
    slow_rates,
    st.lists(slow_rates, min_size=1, max_size=12),
    st.lists(st.tuples(quick, quick), min_size=70, max_size=70),
    st.sampled_from([0.0, STEP_S]),
)
def test_a_rate_that_changes_every_second_is_followed(
    first: float, changing: list[float], ways: list[tuple[float, float]], step_s: float
) -> None:
    """Protects flights on a simulator whose clock loses 8 to 31 ms a second as the computer's load has it, in steps."""
    alignment, remote = ClockAlignment(), Remote([first, first, *changing], step_s)
    errors = ask(alignment, remote, every(QUICK_S, ways))
    settled_s = errors.seen_s[len(errors.seen_s) // 5 :]
    assert max(settled_s) < 0.02
    assert errors.beyond_s <= ROUNDING_S
    assert alignment.rate is not None
    assert alignment.rate < 1.0 - CRYSTAL_RATE


@given(st.lists(st.tuples(delays, delays), min_size=1, max_size=80), st.sampled_from([0.9999, 1.0, 1.0001]))
def test_jitter_alone_never_makes_a_rate(ways: list[tuple[float, float]], rate: float) -> None:
    """Protects real hardware on a radio: its crystals do not drift by what can be seen, so the delays did it."""
    alignment = ClockAlignment()
    ask(alignment, Remote([rate]), every(1.0, ways))
    assert alignment.rate == pytest.approx(1.0, abs=1e-4)


@given(rates, st.integers(2, 29), st.floats(0.3, 1e6), st.booleans(), st.lists(quick, min_size=60, max_size=60))
def test_one_stray_answer_changes_nothing(
    rate: float, stray: int, away_s: float, ahead: bool, ways: list[float]
) -> None:
    """Protects all stamps from a single corrupt answer; the doubt of that moment is in the bound."""
    trips = every(QUICK_S, list(zip(ways[::2], ways[1::2], strict=True)))
    remote, alignment = Remote([rate]), ClockAlignment()
    before = ask(alignment, remote, trips[:stray])
    at_s = trips[stray][0]
    alignment.add(at_s, remote.true_s(at_s) + (away_s if ahead else -away_s), at_s + 0.001)
    residual_s = alignment.residual_s(at_s)
    assert residual_s is not None
    assert residual_s > 0.9 * away_s
    after = ask(alignment, remote, trips[stray + 1 :] or [(at_s + QUICK_S, 0.001, 0.001)])
    assert max(before.beyond_s, after.beyond_s) <= ROUNDING_S
    assert max(after.seen_s) < 0.03


@given(rates, rates, st.floats(0.5, 1e6), st.booleans())
def test_a_clock_that_begins_anew_is_known_again_after_two_answers(
    rate: float, then: float, away_s: float, ahead: bool
) -> None:
    """Protects the stamps after a restart: from the first answer on the bound tells that nothing is sure."""
    alignment = ClockAlignment()
    ask(alignment, Remote([rate]), every(QUICK_S, [(0.001, 0.001)] * 30))
    again_s = BEGAN_S + 30 * QUICK_S

    def shown_s(local_s: float) -> float:
        old_s = Remote([rate]).true_s(again_s)
        return old_s + (away_s if ahead else -away_s) + then * (local_s - again_s)

    for at_s in (again_s + QUICK_S * i for i in range(4)):
        alignment.add(at_s, shown_s(at_s + 0.001), at_s + 0.002)
        for now_s in (at_s + 0.002, at_s + QUICK_S):
            local_s, residual_s = alignment.to_local_s(shown_s(now_s)), alignment.residual_s(now_s)
            assert local_s is not None
            assert residual_s is not None
            assert abs(local_s - now_s) <= residual_s + ROUNDING_S
    assert residual_s is not None
    assert residual_s < 0.03


def test_a_clock_that_stood_still_for_a_moment_keeps_its_rate() -> None:
    """Protects the next second on a simulator that had no processor: two answers alone would allow a rate of 1."""
    alignment, remote = ClockAlignment(), Remote([0.98])
    ask(alignment, remote, every(QUICK_S, [(0.002, 0.002)] * 30))
    for i in (30, 31):
        at_s = BEGAN_S + i * QUICK_S
        alignment.add(at_s, remote.true_s(at_s + 0.002) - 0.06, at_s + 0.004)
    assert alignment.rate == pytest.approx(0.98, abs=1e-3)
    local_s = alignment.to_local_s(remote.true_s(at_s) - 0.06)
    assert local_s == pytest.approx(at_s, abs=0.003)


def test_answers_that_overtake_each_other_or_repeat_a_time_tell_nothing_new() -> None:
    """Protects against a division by no time at all, and a rate made of the order in which answers arrive."""
    alignment = ClockAlignment()
    ask(alignment, Remote([0.99]), every(QUICK_S, [(0.001, 0.001)] * 30))
    rate, residual_s = alignment.rate, alignment.residual_s(BEGAN_S + 6.0)
    for back_s in (0.0, 1.0):
        at_s = BEGAN_S + 29 * QUICK_S - back_s
        alignment.add(at_s, Remote([0.99]).true_s(at_s + 0.001), BEGAN_S + 6.0)
    assert (alignment.rate, alignment.residual_s(BEGAN_S + 6.0)) == (rate, residual_s)


def test_the_bound_grows_while_no_answer_comes() -> None:
    """Protects against a residual of long ago: of a crystal slowly, of a simulation by what its rate can change."""
    crystal, simulation = ClockAlignment(), ClockAlignment()
    trips = every(QUICK_S, [(0.001, 0.001)] * 24)
    ask(crystal, Remote([1.0]), trips)
    ask(simulation, Remote([0.98]), trips)
    heard_s = trips[-1][0] + 0.002

    def grown_s(alignment: ClockAlignment) -> float:
        before_s, after_s = alignment.residual_s(heard_s), alignment.residual_s(heard_s + 10.0)
        assert before_s is not None
        assert after_s is not None
        return after_s - before_s

    assert 0.001 < grown_s(crystal) < 0.02
    assert 0.2 < grown_s(simulation) < 0.3


# Stamps that come unasked.


@pytest.mark.parametrize("rate", [0.97, 0.99, 1.01, 1.03])
def test_stamps_alone_follow_a_clock_that_drifts_and_see_no_jump(rate: float) -> None:
    """Protects poses of an autopilot that does not answer TIMESYNC: soon they are not old, and none is lost."""
    alignment, remote = ClockAlignment(), Remote([rate])
    for i in range(3000):
        now_s = BEGAN_S + 0.02 * i
        alignment.add_one_way(remote.true_s(now_s), now_s + 0.003 + 0.01 * (i % 7 > 0))
        local_s = alignment.to_local_s(remote.true_s(now_s))
        assert local_s is not None
        if i > 300:
            assert abs(local_s - now_s) < 0.01
    assert alignment.restarts == 0
    assert alignment.rate == pytest.approx(rate, abs=1e-3)


@pytest.mark.parametrize("rate", [0.97, 1.03])
@pytest.mark.parametrize("heard", [100, 500])
def test_a_clock_that_drifted_through_a_silence_has_not_jumped(rate: float, heard: int) -> None:
    """Protects the poses after a link that was cut for a minute: 3 % of it are 1.8 s, and no restart."""
    alignment, remote = ClockAlignment(), Remote([rate])
    for now_s in (BEGAN_S + 0.02 * i + silent_s for silent_s in (0.0, 70.0) for i in range(heard)):
        alignment.add_one_way(remote.true_s(now_s), now_s + 0.003)
        local_s = alignment.to_local_s(remote.true_s(now_s))
        assert local_s is not None
        assert local_s - now_s < 2.5
    assert alignment.restarts == 0
    local_s = alignment.to_local_s(remote.true_s(now_s))
    assert local_s is not None
    assert abs(local_s - now_s) < 0.1


@given(st.lists(st.floats(0.0, 0.08), min_size=400, max_size=400))
def test_a_queue_that_fills_is_no_drift(waits: list[float]) -> None:
    """Protects real hardware without TIMESYNC: delays come and go, and the soonest arrival counts."""
    alignment = ClockAlignment()
    for i, wait_s in enumerate(waits):
        # The link is congested for some seconds, from one moment to the next.
        congested_s = 0.15 if 120 < i < 280 else 0.0
        alignment.add_one_way(0.05 * i, BEGAN_S + 0.05 * i + 0.005 + wait_s + congested_s)
        local_s = alignment.to_local_s(0.05 * i)
        assert local_s is not None
        if i > 40:
            assert abs(local_s - (BEGAN_S + 0.05 * i)) < 0.1


def test_answers_are_not_taken_for_another_clocks_because_of_drift() -> None:
    """Protects the exact answers: the one-way delays lag behind a slow clock at first, and a long outage adds to it."""
    alignment, remote = ClockAlignment(), Remote([0.97])
    for i in range(6000):
        now_s = BEGAN_S + 0.01 * i + (60.0 if i >= 3000 else 0.0)
        alignment.add_one_way(remote.true_s(now_s), now_s + 0.04)
        if i % 20 == 0:
            alignment.add(now_s, remote.true_s(now_s + 0.04), now_s + 0.08)
        if i % 3000 > 100:
            assert alignment.round_trip_s is not None, "believed"
    local_s = alignment.to_local_s(remote.true_s(now_s))
    assert local_s is not None
    assert abs(local_s - now_s) < 0.01, "not late by the delay"


def test_stamps_take_over_when_answers_stay_away_and_the_clock_drifts() -> None:
    """Protects poses when only TIMESYNC is lost: what the rate may have done since then is more than the delay."""
    alignment, remote = ClockAlignment(), Remote([0.98] * 8 + [0.97])
    for i in range(6000):
        now_s = BEGAN_S + 0.01 * i
        alignment.add_one_way(remote.true_s(now_s), now_s + 0.01)
        if i % 20 == 0 and i < 800:
            alignment.add(now_s, remote.true_s(now_s + 0.01), now_s + 0.02)
    assert alignment.round_trip_s is None
    local_s = alignment.to_local_s(remote.true_s(now_s))
    assert local_s is not None
    assert abs(local_s - now_s) < 0.02
