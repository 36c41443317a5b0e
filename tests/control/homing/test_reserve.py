"""When it is time to turn back: the real way, the real speed, the measured drain."""

from __future__ import annotations

import math

import pytest

from companion.control.homing.reserve import LANDING_S, LEAST_PERCENT, LEAST_S, Charge, Reserve


def told(
    reserve: Reserve, *, seconds: int, percent_per_s: float, way_home_s: float | None, start: float = 100.0
) -> float:
    """Whole percents, as autopilots tell them, once a second; what is left then."""
    for second in range(seconds):
        reserve.update(float(second), float(math.floor(start - percent_per_s * second)), way_home_s)
    return start - percent_per_s * (seconds - 1)


def test_what_will_be_left_is_charge_less_drain_times_the_way() -> None:
    """The promise: within a percent, though the autopilot tells whole ones."""
    reserve = Reserve(25.0)
    left = told(reserve, seconds=240, percent_per_s=0.1, way_home_s=100.0)
    assert reserve.drain_percent_per_s == pytest.approx(0.1, rel=0.03)
    assert reserve.left_percent == pytest.approx(left - 0.1 * (100.0 + LANDING_S), abs=1.0)
    assert not reserve.is_due


def test_it_is_due_when_less_than_the_reserve_would_be_left() -> None:
    """Turns back in time, and not before: just over the reserve it explores on."""
    for way_home_s, due in ((450.0, True), (350.0, False)):
        reserve = Reserve(25.0)
        told(reserve, seconds=300, percent_per_s=0.1, way_home_s=way_home_s)
        assert reserve.is_due == due, way_home_s


def test_a_battery_that_falls_faster_is_noticed() -> None:
    """A worn cell: what counts is the drain of the last minutes, not that of the whole flight."""
    reserve = Reserve(25.0)
    left = told(reserve, seconds=300, percent_per_s=0.05, way_home_s=200.0)
    for second in range(200):
        reserve.update(300.0 + second, float(math.floor(left - 0.2 * second)), 200.0)
    assert reserve.drain_percent_per_s == pytest.approx(0.2, rel=0.1)
    assert reserve.is_due


@pytest.mark.parametrize("seconds", [1, round(LEAST_S) - 2])
def test_nothing_is_said_before_enough_is_known(seconds: int) -> None:
    """Protects from turning back at once: one percent less in the first second says nothing of the drain."""
    reserve = Reserve(25.0)
    told(reserve, seconds=seconds, percent_per_s=0.1, way_home_s=1000.0)
    assert reserve.left_percent is None
    assert not reserve.is_due


def test_who_knows_no_charge_or_no_way_promises_nothing() -> None:
    """Silence is no promise, and an old one is not repeated."""
    reserve = Reserve(25.0)
    told(reserve, seconds=120, percent_per_s=0.1, way_home_s=10.0)
    assert reserve.left_percent is not None
    promises = []
    for t_s, percent, way_home_s in ((121.0, None, 10.0), (122.0, 80.0, None)):
        reserve.update(t_s, percent, way_home_s)
        promises.append(reserve.left_percent)
    assert promises == [None, None]


def test_a_battery_that_hardly_drains_has_no_drain_yet() -> None:
    """Less than two percents in minutes may be the rounding of one."""
    reserve = Reserve(25.0)
    told(reserve, seconds=100, percent_per_s=0.5 * LEAST_PERCENT / 100.0, way_home_s=10.0)
    assert reserve.drain_percent_per_s is None


class TestCharge:
    """What is left, by whatever can be believed."""

    def test_the_smaller_of_percent_and_voltage(self) -> None:
        """ArduPilot counts from 100 at each boot: a half empty battery is told by its voltage alone."""
        charge = Charge(14.0)
        assert charge.percent(100.0, 16.0) == 100.0
        assert charge.percent(90.0, 15.0) == pytest.approx(50.0)
        assert charge.percent(30.0, 15.0) == pytest.approx(30.0)
        assert charge.percent(30.0, 13.0) == 0.0

    def test_voltage_alone_and_percent_alone(self) -> None:
        """Who says nothing is not asked."""
        assert Charge(14.0).percent(None, 16.0) == 100.0
        assert Charge(None).percent(70.0, 15.0) == 70.0
        assert Charge(None).percent(None, 15.0) is None
        assert Charge(14.0).percent(None, None) is None

    def test_a_battery_that_is_empty_at_the_start(self) -> None:
        """No division by nothing: below its end a voltage says nothing of how much there was."""
        assert Charge(14.0).percent(None, 13.0) is None
