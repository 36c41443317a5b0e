"""Each fault at its threshold: not a moment too early, not a moment too late, and with which words."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from companion.gate.fault_monitor import FaultMonitor
from companion.gate.faults import Fault
from companion.gate.plan import Geofence, Plan, Stopping
from companion.gate.protocol import Beat, Phase
from companion.gate.setpoint_limits import VelocitySetpoint
from companion.gate.vehicle import Vehicle
from companion.mavlink.firmware import AutopilotKind
from companion.sides import NOTHING_AROUND, Side
from tests.gate.built import PLAN as BUILT

NOW_S = 64.0
JUST_S = 2.0**-20
"""Less than any threshold means, and exact beside `NOW_S`."""
PLAN = replace(
    BUILT,
    period_s=0.125,
    fence=Geofence(north_m=(-4.0, 4.0)),
    stopping=Stopping(delay_s=0.25, brake_mps2=0.25, creep_m=0.0),
    thresholds=replace(
        BUILT.thresholds,
        setpoint_s=0.125,
        beat_s=0.125,
        depth_s=0.5,
        ranges_s=0.5,
        pose_s=0.25,
        pose_frozen_s=0.25,
        heartbeat_s=2.0,
        link_s=0.5,
        map_s=32.0,
    ),
)
FRESH = Beat(NOW_S, 0.0, 0.0, 0.0, 9.0, 0.0, Phase.EXPLORING)


def moved(**changes: float) -> dict[str, float]:
    return dict.fromkeys(("x", "y", "z", "vx", "vy", "vz"), 0.0) | {"time_boot_ms": 1e3} | changes


def vehicle() -> Vehicle:
    """One of which all is well, at `NOW_S`."""
    found = Vehicle(PLAN.thresholds)
    found.on_message(
        "HEARTBEAT", {"autopilot": 12, "base_mode": 128, "custom_mode": 6 << 16, "system_status": 4}, NOW_S
    )
    found.on_message("LOCAL_POSITION_NED", moved(), NOW_S)
    found.on_message("ATTITUDE", {"yaw": 0.0}, NOW_S)
    found.on_command_sent(176, {"param2": 6.0, "param3": 0.0}, 191)
    return found


def watching(beat: Beat | None = FRESH, plan: Plan = PLAN, **changes: Any) -> FaultMonitor:
    """A watch of it, with an application that steers."""
    watched = vehicle()
    for name, value in changes.items():
        setattr(watched, name, value)
    monitor = FaultMonitor(plan, watched)
    if beat is not None:
        assert monitor.on_beat(beat, NOW_S)
    monitor.asked = VelocitySetpoint(NOW_S, 0.0, 0.0, 0.0, 0.0)
    return monitor


def only(monitor: FaultMonitor, fault: Fault, now_s: float = NOW_S) -> str | None:
    """The words of one fault."""
    return monitor.faults(now_s).get(fault)


def test_nothing_is_wrong_when_nothing_is() -> None:
    """Protects all tests here: they begin with a vehicle of which all is well."""
    assert watching().faults(NOW_S) == {}


def test_before_the_first_beat_there_is_no_application() -> None:
    """Protects the beginning: nobody explores, and the beat is late for ever."""
    monitor = watching(None)
    assert (monitor.beat, monitor.phase, monitor.beat_age_s(NOW_S)) == (None, Phase.GROUND, math.inf)
    assert monitor.faults(NOW_S) == {Fault.BEAT_LATE: "never"}


def test_which_beats_can_be() -> None:
    """Protects the clock: neither a future beat nor one from before the newest makes the application younger."""
    monitor = watching()
    assert monitor.on_beat(replace(FRESH, t_s=NOW_S + 0.0625), NOW_S) is False
    assert monitor.on_beat(replace(FRESH, t_s=NOW_S - JUST_S), NOW_S) is False
    assert monitor.on_beat(FRESH, NOW_S), "the same once more"
    ahead = replace(FRESH, t_s=NOW_S + 0.03125)
    assert monitor.on_beat(ahead, NOW_S)
    assert monitor.beat is ahead
    assert monitor.beat_age_s(NOW_S) == 0.0
    assert monitor.beat_age_s(NOW_S + 1.03125) == 1.0
    zero = FaultMonitor(PLAN, vehicle())
    assert zero.on_beat(replace(FRESH, t_s=0.05), 0.0), "at the bound it is one"


@pytest.mark.parametrize(
    ("fault", "changes", "limit_s"),
    [
        (Fault.BEAT_LATE, {}, 0.125),
        (Fault.DEPTH_STALE, {"depth_age_s": 0.4375}, 0.0625),
        (Fault.RANGES_STALE, {"ranges_age_s": 0.4375}, 0.0625),
        (Fault.POSE_STALE, {"pose_age_s": 0.1875}, 0.0625),
        (Fault.MAP, {"map_age_s": 31.9375}, 0.0625),
        (Fault.SETPOINT_LATE, {}, 0.125),
        (Fault.LINK_LOST, {}, 0.5),
        (Fault.HEARTBEAT_LOST, {}, 2.0),
    ],
)
def test_what_is_late_is_late_from_its_threshold_on(fault: Fault, changes: dict[str, Any], limit_s: float) -> None:
    """Protects each age: at its limit it passes, after it never; ages go on while no beat comes."""
    monitor = watching(replace(FRESH, **changes))
    assert only(monitor, fault, NOW_S + limit_s) is None
    words = only(monitor, fault, NOW_S + limit_s + JUST_S)
    assert words is not None
    assert words.endswith(" s")
    age_s = limit_s + sum(changes.values())
    assert float(words[:-2]) == pytest.approx(age_s, abs=0.006)


def test_what_never_came_is_said_to_have_never_come() -> None:
    """Protects the pilot's reading: "inf s" is no word."""
    never = replace(FRESH, depth_age_s=math.inf, ranges_age_s=math.inf, pose_age_s=math.inf, map_age_s=math.inf)
    found = watching(never, heard_s=-math.inf, heartbeat_s=-math.inf).faults(NOW_S)
    late = [Fault.DEPTH_STALE, Fault.RANGES_STALE, Fault.POSE_STALE, Fault.MAP, Fault.LINK_LOST, Fault.HEARTBEAT_LOST]
    assert found == dict.fromkeys(late, "never")


@pytest.mark.parametrize("phase", list(Phase))
def test_what_is_expected_depends_on_what_the_application_does(phase: Phase) -> None:
    """Protects a landing from being stopped for a blind camera, and an end of flight from needing beats."""
    blind = replace(FRESH, depth_age_s=9.0, ranges_age_s=9.0, map_age_s=99.0, ahead_m=0.1, phase=phase)
    monitor = watching(blind)
    monitor.asked = VelocitySetpoint(NOW_S - 9.0, 0.5, 0.0, 0.0, 0.0)
    monitor._vehicle.motion._state = (0.0, 0.0, 0.0, 0.5, 0.0, 0.0)
    monitor._vehicle.motion.fresh_s = NOW_S - 1.0
    monitor._vehicle.heard_s = monitor._vehicle.heartbeat_s = NOW_S + 1.0
    expected = set() if phase is Phase.ENDED else {Fault.BEAT_LATE}
    if phase in (Phase.CLIMBING, Phase.EXPLORING):
        expected |= {Fault.POSE_STALE}
    if phase is Phase.EXPLORING:
        expected |= {Fault.DEPTH_STALE, Fault.RANGES_STALE, Fault.MAP, Fault.SETPOINT_LATE, Fault.DISTANCE}
    assert set(monitor.faults(NOW_S + 1.0)) == expected


def test_positions_that_stop_are_stale() -> None:
    """Protects against the autopilot's silence about its place, which the application's own age may not show."""
    monitor = watching()
    for after_s, words in ((0.25, None), (0.25 + JUST_S, "0.25 s")):
        monitor.on_beat(replace(FRESH, t_s=NOW_S + after_s), NOW_S + after_s)
        assert only(monitor, Fault.POSE_STALE, NOW_S + after_s) == words


def test_setpoints_are_expected_once_it_explores_in_offboard() -> None:
    """Protects the change from climbing to exploring: the time counts from there, not from each beat."""
    monitor = watching(replace(FRESH, phase=Phase.CLIMBING))
    monitor.asked = None
    for tick in range(3):
        monitor.on_beat(replace(FRESH, t_s=NOW_S + 0.0625 * tick), NOW_S + 0.0625 * tick)
    assert only(monitor, Fault.SETPOINT_LATE, NOW_S + 0.125) is None
    assert only(monitor, Fault.SETPOINT_LATE, NOW_S + 0.125 + JUST_S) == "0.13 s"
    monitor.asked = VelocitySetpoint(NOW_S - 9.0, 0.0, 0.0, 0.0, 0.0)
    assert only(monitor, Fault.SETPOINT_LATE, NOW_S + 0.125) is None, "one from before does not make it late"
    monitor.asked = VelocitySetpoint(NOW_S + 0.125, 0.0, 0.0, 0.0, 0.0)
    assert only(monitor, Fault.SETPOINT_LATE, NOW_S + 0.25) is None
    monitor.on_beat(replace(FRESH, t_s=NOW_S + 0.5, phase=Phase.ENDING), NOW_S + 0.5)
    monitor.on_beat(replace(FRESH, t_s=NOW_S + 1.0), NOW_S + 1.0)
    assert only(monitor, Fault.SETPOINT_LATE, NOW_S + 1.125) is None, "it began anew"
    monitor._vehicle.on_command_sent(21, {}, 191)
    assert only(monitor, Fault.SETPOINT_LATE, NOW_S + 5.0) is None, "nobody steers in another mode"


@pytest.mark.parametrize("name", ["bad_s", "flooded_s"])
def test_what_happened_counts_for_a_moment(name: str) -> None:
    """Protects events from being overlooked between two cycles, and from lasting."""
    fault = {"bad_s": Fault.SETPOINT_BAD, "flooded_s": Fault.FLOOD}[name]
    monitor = watching()
    setattr(monitor, name, 0.0)
    assert monitor._of_the_application(0.09375)[fault] == ""
    assert fault not in monitor._of_the_application(0.1)


def test_a_jump_counts_for_a_moment() -> None:
    """Protects the same for a position that jumped."""
    monitor = watching()
    monitor._vehicle.motion.jumped_s = 0.0
    assert monitor._of_the_autopilot(0.09375)[Fault.POSE_JUMP] == ""
    assert Fault.POSE_JUMP not in monitor._of_the_autopilot(0.1)


def test_a_dead_application_and_an_order_from_the_ground() -> None:
    """Protects what is told once and stays."""
    monitor = watching()
    monitor.died = True
    assert monitor.faults(NOW_S) == {Fault.APPLICATION: "died"}
    monitor = watching()
    monitor.stop_ordered = True
    assert monitor.faults(NOW_S) == {Fault.GROUND_STOP: ""}


@pytest.mark.parametrize(
    ("changes", "found"),
    [
        ({"estimator_good": None}, {}),
        ({"estimator_good": True}, {}),
        ({"estimator_good": False}, {Fault.ESTIMATOR: ""}),
    ],
)
def test_what_the_autopilot_says_of_itself(changes: dict[str, Any], found: dict[Fault, str]) -> None:
    """Protects against bad words being ignored; what it does not say is no fault in the air."""
    assert watching(**changes).faults(NOW_S) == found


def test_positions_that_repeat_themselves_are_frozen() -> None:
    """Protects against an estimator that stands still, not against a link that does."""
    for repeated_s, frozen in ((0.25, False), (0.25 + JUST_S, True)):
        monitor = watching()
        monitor._vehicle.on_message("LOCAL_POSITION_NED", moved(time_boot_ms=2e3), NOW_S + repeated_s)
        assert (Fault.POSE_FROZEN in monitor.faults(NOW_S + repeated_s)) is frozen
    assert Fault.POSE_FROZEN not in watching().faults(NOW_S + 9.0)


@pytest.mark.parametrize(("north_m", "words"), [(4.0, None), (5.5, "1.5 m outside"), (-4.25, "0.2 m outside")])
def test_who_is_outside_the_fence_is_told_how_far(north_m: float, words: str | None) -> None:
    """Protects the fence: on it is inside."""
    monitor = watching()
    monitor._vehicle.motion._state = (north_m, 0.0, 0.0, 0.0, 0.0, 0.0)
    assert only(monitor, Fault.FENCE) == words
    nowhere = watching()
    nowhere._vehicle.motion._state = None
    assert only(nowhere, Fault.FENCE) is None, "a place that is not known is a fault of its own"


def flying(flown_mps: float | None, asked_mps: float | None, ahead_m: float) -> FaultMonitor:
    monitor = watching(replace(FRESH, ahead_m=ahead_m))
    motion = monitor._vehicle.motion
    motion._state = None if flown_mps is None else (0.0, 0.0, 0.0, flown_mps, 0.0, 0.0)
    monitor.asked = None if asked_mps is None else VelocitySetpoint(NOW_S, asked_mps, 0.0, 0.0, 0.0)
    return monitor


@pytest.mark.parametrize(
    ("flown_mps", "asked_mps"), [(0.5, 0.0), (0.5, -1.0), (0.5, None), (None, 0.5), (0.25, 0.5), (-0.5, 0.5)]
)
def test_the_distance_is_what_is_left_after_stopping(flown_mps: float | None, asked_mps: float | None) -> None:
    """Protects against the wall: 0.5 m/s · (0.25 + 2 · 0.125 s) + 0.5² / (2 · 0.25) m is 0.75 m; 0.5 m must be left."""
    assert only(flying(flown_mps, asked_mps, 1.25), Fault.DISTANCE) is None
    assert only(flying(flown_mps, asked_mps, 1.25 - JUST_S), Fault.DISTANCE) == "1.25 m ahead"
    later = flying(flown_mps, asked_mps, 1.3125)
    later.asked = None if later.asked is None else replace(later.asked, t_s=NOW_S + 0.125)
    assert only(later, Fault.DISTANCE, NOW_S + 0.125) is None
    assert only(later, Fault.DISTANCE, NOW_S + 0.125 + JUST_S) == "1.31 m ahead", "it went on since it was measured"


def test_a_slow_vehicle_needs_less() -> None:
    """Protects a vehicle in a narrow place: 0.25 m/s · 0.5 s + 0.25² / 0.5 m is 0.25 m."""
    assert only(flying(0.25, None, 0.75), Fault.DISTANCE) is None
    assert only(flying(0.25, None, 0.75 - JUST_S), Fault.DISTANCE) == "0.75 m ahead"
    assert only(flying(0.11, None, 0.0), Fault.DISTANCE) == "0.00 m ahead", "so slow it still closes in"


@pytest.mark.parametrize(("flown_mps", "asked_mps"), [(0.0, None), (0.1, 0.1), (-0.5, 0.0), (None, None), (None, -0.5)])
def test_who_does_not_close_in_may_be_near(flown_mps: float | None, asked_mps: float | None) -> None:
    """Protects the way out of a narrow place: who stands, or backs away, is let go."""
    assert only(flying(flown_mps, asked_mps, 0.0), Fault.DISTANCE) is None


@pytest.mark.parametrize(
    ("where", "words"), [("front", "ahead"), ("left", "on the left"), ("back", "behind"), ("right", "on the right")]
)
def test_what_is_seen_to_come_nearer_counts_on_every_side(where: str, words: str) -> None:
    """Protects from a velocity that is wrong: the autopilot says that it stands, and is carried into a wall."""
    for distance_m, told in ((1.25, None), (1.25 - JUST_S, f"1.25 m {words}")):
        monitor = flying(0.0, None, math.inf)
        sides = NOTHING_AROUND._replace(**{where: Side(distance_m, 0.5)})
        assert monitor.on_beat(replace(FRESH, ahead_m=math.inf, sides=sides), NOW_S)
        assert only(monitor, Fault.DISTANCE) == told


@pytest.mark.parametrize("told", [True, False], ids=["flown", "asked"])
@pytest.mark.parametrize(
    ("where", "forward_right"), [("left", (0.0, -0.5)), ("back", (-0.5, 0.0)), ("right", (0.0, 0.5))]
)
def test_motion_to_a_side_is_bounded_as_the_one_ahead(
    where: str, forward_right: tuple[float, float], told: bool
) -> None:
    """Protects from walls beside and behind: a vehicle that makes room, or slips in a turn, flies that way."""
    for side, distance_m, expected in ((where, 1.25, False), (where, 1.25 - JUST_S, True), ("front", 1.0, False)):
        sides = NOTHING_AROUND._replace(**{side: Side(distance_m, 0.0)})
        monitor = flying(0.0, None, math.inf)
        assert monitor.on_beat(replace(FRESH, ahead_m=math.inf, sides=sides), NOW_S)
        if told:
            monitor._vehicle.motion._state = (0.0, 0.0, 0.0, *forward_right, 0.0)
        else:
            monitor.asked = VelocitySetpoint(NOW_S, *forward_right, 0.0, 0.0)
        assert (only(monitor, Fault.DISTANCE) is not None) is expected


def test_a_distance_that_is_not_known_is_judged_where_setpoints_are() -> None:
    """Protects from stopping in a phase in which nothing moves; moving into the unknown is refused at once."""
    assert only(flying(0.5, 0.5, math.nan), Fault.DISTANCE) is None


def test_a_new_application_begins_with_nothing() -> None:
    """Protects the next one from what the last did, and did not."""
    monitor = watching()
    monitor.died = monitor.stop_ordered = True
    monitor.bad_s = monitor.flooded_s = NOW_S
    monitor.reset()
    assert (monitor.beat, monitor.asked) == (None, None)
    assert monitor.faults(NOW_S) == {Fault.BEAT_LATE: "never"}
    assert monitor.on_beat(replace(FRESH, t_s=NOW_S - 1.0), NOW_S + 1.0), "its own clock counts"
    assert only(monitor, Fault.SETPOINT_LATE, NOW_S + 1.125) is None, "and its own exploring"
    assert only(monitor, Fault.SETPOINT_LATE, NOW_S + 1.25) == "0.25 s"


def test_a_computer_that_has_just_started_has_no_faults_from_before() -> None:
    """Protects the first moments of the clock, which begins at zero: what never happened is not recent."""
    monitor = FaultMonitor(PLAN, vehicle())
    for _ in range(2):
        assert set(monitor._of_the_application(0.0625)) == {Fault.BEAT_LATE}
        assert Fault.POSE_JUMP not in monitor._of_the_autopilot(0.0625)
        monitor.reset()


def test_ardupilot_is_steered_in_guided() -> None:
    """Protects the same where the mode has another number."""
    watched = Vehicle(PLAN.thresholds)
    watched.on_message("HEARTBEAT", {"autopilot": 3, "base_mode": 128, "custom_mode": 4, "system_status": 4}, NOW_S)
    assert watched.kind is AutopilotKind.ARDUPILOT
    watched.on_command_sent(176, {"param2": 4.0, "param3": 0.0}, 191)
    monitor = FaultMonitor(PLAN, watched)
    monitor.on_beat(FRESH, NOW_S)
    assert only(monitor, Fault.SETPOINT_LATE, NOW_S + 0.25) == "0.25 s"
