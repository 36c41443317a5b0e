"""Whose the vehicle is: every heartbeat that could be mistaken for ours, or ours for somebody else's."""

from __future__ import annotations

import math

import pytest

from companion.mavlink.firmware import AutopilotKind
from companion.mavlink.mode_monitor import DISARMED, ModeMonitor
from companion.mavlink.modes import px4_mode

HOLD, OFFBOARD, LAND, POSITION = px4_mode(4, 3), px4_mode(6), px4_mode(4, 6), px4_mode(3)


def asked(armed_before: bool = True) -> ModeMonitor:
    """In hold, and asked for offboard."""
    watch = ModeMonitor(AutopilotKind.PX4)
    watch.on_heartbeat(HOLD, armed_before, 1.0)
    watch.request(frozenset({OFFBOARD}))
    return watch


def engaged() -> ModeMonitor:
    """Armed, in offboard, as asked for."""
    watch = asked()
    watch.on_heartbeat(OFFBOARD, True, 2.0)
    return watch


def test_a_new_monitor_knows_nothing() -> None:
    """Protects the first moment: a vehicle whose heartbeat has not come is neither armed nor ours."""
    watch = ModeMonitor(AutopilotKind.PX4)
    assert (watch.mode, watch.armed, watch.heartbeat_s) == (None, False, -math.inf)
    assert (watch.confirmed, watch.taken_over, watch.ours) == (False, None, frozenset())
    watch.on_refused(0)
    assert (watch.confirmed, watch.ours) == (False, frozenset())
    watch.request(frozenset({OFFBOARD}))
    watch.on_heartbeat(POSITION, True, -5.0)
    assert watch.taken_over == "position", "with no heartbeat before there is no mode before"


def test_nothing_is_taken_over_before_anything_was_asked_for() -> None:
    watch = ModeMonitor(AutopilotKind.PX4)
    watch.on_heartbeat(POSITION, True, 1.0)
    watch.on_heartbeat(HOLD, False, 2.0)
    assert watch.taken_over is None


def test_the_mode_before_may_show_until_ours_does() -> None:
    """Heartbeats are up to 1 s late: the old mode in one of them is no pilot."""
    watch = asked()
    watch.on_heartbeat(HOLD, True, 2.0)
    assert (watch.taken_over, watch.confirmed) == (None, False)
    watch.on_heartbeat(OFFBOARD, True, 3.0)
    assert (watch.taken_over, watch.confirmed) == (None, True)
    watch.on_heartbeat(HOLD, True, 4.0)
    assert watch.taken_over == "hold"


def test_a_third_mode_is_somebody_elses_even_while_ours_has_not_shown() -> None:
    watch = asked()
    watch.on_heartbeat(POSITION, True, 1.5)
    assert watch.taken_over == "position"


@pytest.mark.parametrize("mode", [HOLD, LAND, POSITION, px4_mode(1), px4_mode(4, 5), 0, -1])
def test_any_other_mode_latches_for_good(mode: int) -> None:
    """PX4 returns to offboard by itself: that must not give the vehicle back to us."""
    watch = engaged()
    watch.on_heartbeat(mode, True, 3.0)
    name = watch.taken_over
    assert name is not None
    watch.on_heartbeat(OFFBOARD, True, 4.0)
    watch.request(frozenset({OFFBOARD}))
    watch.on_heartbeat(OFFBOARD, True, 5.0)
    assert watch.taken_over == name


def test_a_disarmed_vehicle_in_our_mode_is_not_ours() -> None:
    """After a failsafe landing PX4 shows offboard, disarmed."""
    watch = engaged()
    watch.on_heartbeat(OFFBOARD, False, 3.0)
    assert watch.taken_over == DISARMED


@pytest.mark.parametrize("armed_before", [True, False])
def test_a_vehicle_that_disarms_without_having_been_told_to_is_not_ours(armed_before: bool) -> None:
    """Whether it was armed before the request or after it, once armed it does not disarm by our doing."""
    watch = asked(armed_before)
    if not armed_before:
        watch.on_heartbeat(HOLD, True, 2.0)
        watch.on_heartbeat(OFFBOARD, True, 3.0)
    watch.on_heartbeat(OFFBOARD, False, 4.0)
    assert watch.taken_over == DISARMED


def test_who_took_it_first_is_named() -> None:
    """The pilot who takes over from a failsafe is not the reason why the flight ended."""
    watch = engaged()
    watch.on_heartbeat(HOLD, True, 3.0)
    watch.on_heartbeat(POSITION, True, 4.0)
    watch.on_heartbeat(POSITION, False, 5.0)
    assert watch.taken_over == "hold"


def test_a_refused_landing_does_not_allow_to_disarm() -> None:
    watch = engaged()
    watch.on_refused(watch.request(frozenset({LAND}), may_disarm=True))
    assert watch.confirmed
    watch.on_heartbeat(OFFBOARD, False, 3.0)
    assert watch.taken_over == DISARMED


def test_disarming_after_our_landing_is_what_was_asked_for() -> None:
    watch = engaged()
    watch.request(frozenset({LAND}), may_disarm=True)
    watch.on_heartbeat(LAND, True, 3.0)
    watch.on_heartbeat(LAND, False, 4.0)
    watch.on_heartbeat(HOLD, False, 5.0)
    assert watch.taken_over is None
    assert not watch.armed


def test_the_first_heartbeat_after_arming_may_still_say_disarmed() -> None:
    watch = ModeMonitor(AutopilotKind.PX4)
    watch.on_heartbeat(HOLD, False, 1.0)
    watch.request(frozenset({HOLD}))
    watch.on_heartbeat(HOLD, False, 2.0)
    watch.on_heartbeat(HOLD, True, 3.0)
    assert watch.taken_over is None


def test_after_a_refusal_the_mode_before_is_ours_again() -> None:
    watch = engaged()
    watch.on_refused(watch.request(frozenset({HOLD})))
    watch.on_heartbeat(OFFBOARD, True, 3.0)
    assert watch.taken_over is None
    watch.on_heartbeat(POSITION, True, 4.0)
    assert watch.taken_over == "position"


def test_a_late_refusal_does_not_undo_a_newer_request() -> None:
    """A cancelled manoeuvre cleans up after the vehicle has been told to land."""
    watch = engaged()
    request = watch.request(frozenset({HOLD}))
    watch.request(frozenset({LAND}), may_disarm=True)
    watch.on_refused(request)
    watch.on_heartbeat(LAND, True, 3.0)
    assert (watch.taken_over, watch.confirmed) == (None, True)


def test_a_mode_on_the_way_to_ours_is_nobody_elses_until_ours_has_shown() -> None:
    """Setpoints stop when landing is asked for; when the command is slow, PX4's failsafe holds meanwhile."""
    watch = engaged()
    watch.request(frozenset({LAND}), may_disarm=True, passing=frozenset({HOLD}))
    watch.on_heartbeat(HOLD, True, 3.0)
    assert watch.taken_over is None
    watch.on_heartbeat(LAND, True, 4.0)
    watch.on_heartbeat(HOLD, True, 5.0)
    assert watch.taken_over == "hold"


def test_a_late_heartbeat_is_judged_but_is_not_the_newest() -> None:
    """After a hang the newest is looked at first; the failsafe in the one before it still counts."""
    watch = engaged()
    watch.on_heartbeat(OFFBOARD, True, 5.0)
    watch.on_heartbeat(HOLD, True, 4.0)
    assert watch.taken_over == "hold"
    assert (watch.mode, watch.heartbeat_s) == (OFFBOARD, 5.0)


@pytest.mark.parametrize(("critical", "mode", "by_failsafe"), [(True, HOLD, True), (False, POSITION, False)])
def test_a_failsafe_says_that_it_is_one(critical: bool, mode: int, by_failsafe: bool) -> None:
    """Protects the pilot's reading: "somebody took it" means another thing than "the autopilot did"."""
    watch = engaged()
    watch.on_heartbeat(OFFBOARD, True, 2.5, critical=True)
    assert (watch.taken_over, watch.by_failsafe) == (None, False), "in our mode it is nobody's"
    watch.on_heartbeat(mode, True, 3.0, critical=critical)
    assert watch.taken_over is not None
    assert watch.by_failsafe is by_failsafe
    watch.on_heartbeat(mode, True, 4.0, critical=not critical)
    assert watch.by_failsafe is by_failsafe, "it was decided by the heartbeat that showed it"


def test_who_disarms_is_no_failsafe() -> None:
    """Protects the same for a vehicle that was switched off by hand."""
    watch = engaged()
    watch.on_heartbeat(OFFBOARD, False, 3.0, critical=True)
    assert (watch.taken_over, watch.by_failsafe) == (DISARMED, False)
