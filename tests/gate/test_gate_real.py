"""What the real autopilots do, and what the gate makes of it: each of these was seen on PX4 or ArduCopter."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from companion.gate.failsafe_actions import LAND_MPS
from companion.gate.faults import Fault, Stage
from companion.gate.plan import Plan, Reaction
from companion.gate.protocol import Phase
from companion.mavlink.codec import Frame
from companion.mavlink.firmware import AutopilotKind
from companion.mavlink.modes import personality
from tests.gate.built import (
    AUTOPILOT,
    BEAT,
    GROUND,
    KINDS,
    PLAN,
    SETPOINT,
    Air,
    command,
    frame,
    in_the_air,
    reacting,
    setpoint,
    texts_of,
)
from tests.gate.gate_scene import NOW_S, Scene, flying

PX4 = personality(AutopilotKind.PX4)
BOTH = pytest.mark.parametrize("kind", KINDS)


def last_stop(air: Air) -> dict[str, Any]:
    return [fields for _, name, fields in air.sent if name == SETPOINT][-1]


# It stands.


@BOTH
def test_a_vehicle_that_creeps_on_is_led_back(kind: AutopilotKind) -> None:
    """Protects the wall while the gate brakes: on zero PX4 crept half a metre; now 0.06 m/s end after 0.12 m."""
    air = in_the_air(kind=kind)
    air.beats = False
    air.run(0.5)
    stood_m = air.position["x"]
    while air.stage() is Stage.BRAKE:
        air.position["vx"] = 0.06 + last_stop(air)["vx"]
        air.run(0.05)
    assert 0.1 < air.position["x"] - stood_m <= 0.12
    assert air.faults()[Fault.POSE_STALE] == 1, "of the application's pose: the gate has its own"


def test_a_runaway_is_held_by_the_autopilots_own_mode() -> None:
    """Protects from zero velocity that nobody obeys: PX4 with a bad estimate, ArduCopter paused in guided."""
    air = in_the_air(reacting(Fault.NOT_OBEYED, Stage.HOLD, None, 10.0))
    air.wanted = (0.0, 0.0, 0.0, 0.0)
    air.position["vx"] = 0.3
    air.run(0.4)
    assert air.stage() is Stage.PASS, "it has been asked for as little for long, but velocities are noisy"
    air.run(0.3)
    assert (air.stage(), air.mode) == (Stage.HOLD, air.ours.hold)
    assert "not_obeyed asked to stand, flies 0.30 m/s" in air.notices


def test_a_vehicle_that_stands_though_it_is_asked_to_move_is_told() -> None:
    """Protects from ArduCopter that a ground station on another port has paused: it would fly on without a person."""
    air = in_the_air(reacting(Fault.NOT_OBEYED, Stage.HOLD, None, 10.0), AutopilotKind.ARDUPILOT)
    for speed in (0.2, 0.3, 0.4):
        air.wanted = (speed, 0.0, 0.0, 0.0)
        air.run(0.05)
    air.run(2.0)
    assert (air.stage(), air.mode) == (Stage.HOLD, air.ours.hold)
    assert "not_obeyed asked 0.40 m/s, flies 0.00" in air.notices


@BOTH
def test_a_flight_that_is_flown_as_asked_is_no_fault(kind: AutopilotKind) -> None:
    """Protects a good flight from the new faults: it sets out, stops, turns round."""
    air = in_the_air(kind=kind)
    for asked in (0.1, 0.3, 0.5, 0.3, 0.0, -0.2, -0.4, 0.0):
        for step in range(1, 9):
            air.wanted = (air.wanted[0] + (asked - air.wanted[0]) * step / 8, 0.0, 0.0, 0.0)
            air.run(0.05)
        air.run(0.5)
        air.position["vx"] = asked
        air.run(4.0)
    assert air.stage() is Stage.PASS
    assert air.notices == []


@pytest.mark.parametrize("bad", [{"x": float("nan")}, {"time_boot_ms": 0}])
def test_a_position_that_is_no_news_says_nothing_of_obedience(bad: dict[str, float]) -> None:
    """Protects from the velocity of before, told once more: stale is not fresh."""
    scene = flying()
    scene.hear("LOCAL_POSITION_NED", NOW_S, time_boot_ms=round(1e3 * NOW_S) + 20)
    scene.hear("LOCAL_POSITION_NED", NOW_S + 0.25, **({"time_boot_ms": round(1e3 * NOW_S) + 250, "vx": 0.5} | bad))
    assert scene.gate._monitor.obedience._flown_s == NOW_S


def test_a_refused_setpoint_asks_for_a_stand_only_by_what_goes_out() -> None:
    """Protects the comparison: what did not pass to the autopilot was not asked of it."""
    scene = flying()
    scene.gate.on_application_message(setpoint(9.0), NOW_S)
    assert scene.gate._monitor.obedience._asked_mps == (0.0, 0.0)


# What it is told of.


def test_odometry_that_passes_through_is_missed_when_it_stops() -> None:
    """Protects the seconds until the estimator says so: it stops within a quarter of a second."""
    air = in_the_air(reacting(Fault.ODOMETRY_SILENT, Stage.BRAKE, 1.0, 2.0))
    for tick in range(20):
        for name in ("ODOMETRY", "VISION_POSITION_ESTIMATE"):
            assert air.gate.on_attached_message(frame(name, 197, x=0.01 * tick), "odometry", air.now_s)
        air.run(0.04)
    assert air.stage() is Stage.PASS
    air.run(0.3)
    assert air.stage() is Stage.BRAKE
    assert air.faults()[Fault.ODOMETRY_SILENT] == 1


@pytest.mark.parametrize(("name", "may"), [("TIMESYNC", "odometry"), ("ODOMETRY", "command"), ("ODOMETRY", "read")])
def test_only_a_place_of_who_may_tell_one_is_odometry(name: str, may: str) -> None:
    """Protects from missing what nobody feeds the autopilot with."""
    air = in_the_air()
    air.gate.on_attached_message(frame(name, 197), may, air.now_s)
    air.run(1.0)
    assert air.stage() is Stage.PASS


@BOTH
def test_an_estimator_without_news_stops_it(kind: AutopilotKind) -> None:
    """Protects from the drift of an ArduCopter whose figures freeze 7 s before its flags fall."""
    air = in_the_air(kind=kind)
    name, figures = {
        AutopilotKind.PX4: ("ESTIMATOR_STATUS", ("vel_ratio", "pos_horiz_ratio")),
        AutopilotKind.ARDUPILOT: ("EKF_STATUS_REPORT", ("velocity_variance", "pos_horiz_variance")),
    }[kind]
    for tick in range(30):
        new = 0.1 + (0.01 * tick if tick < 15 else 0.2)
        fields: dict[str, Any] = {"flags": 0x33F} | dict.fromkeys(figures, new)
        air.tell(name, **fields)
        air.run(0.1)
        if air.stage() is not Stage.PASS:
            break
    assert 19 <= tick <= 21, "half a second after the last news"
    assert air.faults()[Fault.AIDING_LOST] == 1


def test_a_lost_fix_stops_who_flies_by_gps() -> None:
    """Protects from flying on by what the estimator remembers."""
    air = in_the_air(replace(PLAN, gps=True))
    air.tell("GPS_RAW_INT", fix_type=3)
    air.run(0.9)
    assert air.stage() is Stage.PASS
    air.tell("GPS_RAW_INT", fix_type=1)
    air.run(0.2)
    assert air.stage() is Stage.BRAKE
    assert any(notice.startswith("gps_lost 1.0") and notice.endswith("fix 1") for notice in air.notices)


# Whose it is.


def test_a_failsafe_is_told_as_the_autopilots() -> None:
    """Protects the pilot from looking for the person who took the vehicle: there was none."""
    air = in_the_air()
    air.mode = air.ours.hold
    air.tell("HEARTBEAT", autopilot=12, base_mode=128, custom_mode=air.mode, system_status=5)
    air.run(0.1)
    texts = [fields["text"] for _, name, fields in air.sent if name == "STATUSTEXT"]
    assert texts == ["gate: hands off: autopilot's failsafe hold"]


@BOTH
def test_after_a_silence_nothing_is_ordered_before_a_heartbeat(kind: AutopilotKind) -> None:
    """Protects the autopilot's own hold, and a pilot: a LAND of the application once overruled PX4's failsafe."""
    scene = flying(kind=kind)
    modes = (scene.ours.land, scene.ours.hold, scene.ours.offboard)
    orders = [command(21), command(400, 0.0), *(command(176, *scene.ours.set_mode_parameters(mode)) for mode in modes)]
    late_s = NOW_S + 3.0
    assert not any(scene.passes(order, late_s) for order in orders)
    scene.at(late_s)
    assert not any(scene.passes(order, late_s) for order in orders), "a position does not tell the mode"
    assert scene.passes(command(512), late_s), "asking is free"
    scene.heartbeat(scene.ours.offboard, late_s + 0.25)
    assert scene.passes(command(21), late_s + 0.25)


def test_on_the_ground_a_silence_blocks_nothing() -> None:
    """Protects the start after a pause: what stands is armed by who may, and the heartbeat of then decides."""
    scene = Scene()
    scene.beat(BEAT.phase, NOW_S + 5.0)
    assert scene.passes(command(400, 1.0), NOW_S + 5.0)


# What the pilot reads.


def test_the_stage_is_told_before_the_faults() -> None:
    """Protects the pilot's first look: what is being done now, at once; why, in the seconds after it."""
    air = in_the_air()
    air.beat = replace(BEAT, depth_age_s=9.0, ranges_age_s=9.0)
    air.run(0.1)
    texts = [fields["text"] for _, name, fields in air.sent if name == "STATUSTEXT"]
    assert texts == ["gate: brake: depth_stale"]
    air.run(2.0)
    texts = [fields["text"][:19] for _, name, fields in air.sent if name == "STATUSTEXT"]
    assert texts == ["gate: brake: depth_", "gate: depth_stale 9", "gate: ranges_stale "]


def test_when_it_is_over_nothing_is_well() -> None:
    """Protects from "pass: all is well" after a landing that a fault ordered; in the air it is said."""
    air = in_the_air(reacting(Fault.BATTERY, Stage.LAND, None, None))
    air.tell("SYS_STATUS", battery_remaining=5, voltage_battery=11_000)
    air.run(0.1)
    assert air.notices[-1] == "land: battery"
    air.run(2.0)
    air.armed = False
    air.heartbeat()
    air.run(2.0)
    assert (air.stage(), air.gate.airborne) == (Stage.PASS, False)
    assert not any(notice.startswith("pass") for notice in air.notices)
    again = in_the_air()
    again.beats = False
    again.run(0.3)
    again.beats = True
    again.run(2.0)
    assert again.notices[-1] == "pass: all is well"


def test_in_other_hands_nothing_is_well_either() -> None:
    """Protects the pilot who has just taken over from reading that all is well."""
    scene = flying(replace(PLAN, reactions=PLAN.reactions | {Fault.DEPTH_STALE: Reaction(Stage.BRAKE, None, None)}))
    scene.beat(BEAT.phase, depth_age_s=9.0)
    scene.gate.cycle(NOW_S)
    scene.heartbeat(3 << 16)
    scene.gate.cycle(NOW_S)
    scene.heartbeat(3 << 16, armed=False)
    scene.gate.cycle(NOW_S)
    assert not any(text.startswith("pass") for text in texts_of(scene.gate))


@BOTH
def test_the_pause_button_stops_it_and_does_not_reach_the_autopilot(kind: AutopilotKind) -> None:
    """Protects from ArduCopter frozen in guided: the gate stops it, and only a person begins a new flight."""
    air = in_the_air(reacting(Fault.GROUND_STOP, Stage.BRAKE, 1.0, None), kind)
    pause = frame("COMMAND_LONG", GROUND[1], GROUND[0], target_system=1, target_component=AUTOPILOT, command=193)
    assert not air.gate.on_attached_message(pause, "command", air.now_s)
    air.run(0.05)
    assert air.stage() is Stage.BRAKE
    go_on = frame(
        "COMMAND_LONG", GROUND[1], GROUND[0], target_system=1, target_component=AUTOPILOT, command=193, param1=1.0
    )
    air.gate.on_attached_message(go_on, "command", air.now_s)
    air.run(3.0)
    assert air.stage() is Stage.HOLD, "to press continue is no start"
    assert [fields["target_system"] for _, name, fields in air.sent if name == "COMMAND_ACK"] == [GROUND[0]]


# It lands where it is.


def nowhere(plan: Plan = PLAN) -> Air:
    """PX4 that was given an origin in flight, and has no position on the globe."""
    air = in_the_air(plan)
    air.tell("GPS_GLOBAL_ORIGIN", latitude=473977418, longitude=85455939)
    air.run(3.5)
    air.sent.clear()
    air.passed.clear()
    return air


@pytest.mark.parametrize("order", [command(21), command(176, *PX4.set_mode_parameters(PX4.land))])
def test_a_landing_that_would_fly_away_is_flown_by_the_gate(order: Frame) -> None:
    """Protects from walls between here and 0°/0°: whatever the application orders, the autopilot lands in place."""
    air = nowhere()
    assert air.ask(order) is None, "it never reaches the autopilot"
    air.run(0.5)
    assert air.stage() is Stage.LAND
    assert last_stop(air)["vz"] == pytest.approx(LAND_MPS)
    assert "land: ordered" in air.notices, "and the pilot is told so"


def test_what_else_is_asked_for_passes_as_before() -> None:
    """Protects the hold of such a vehicle, and its disarming on the ground."""
    air = nowhere()
    assert air.ask(command(176, *air.ours.set_mode_parameters(air.ours.hold))) is not None
    assert air.ask(command(400, 0.0)) is not None
    assert air.stage() is Stage.PASS


@pytest.mark.parametrize(
    ("asked", "passes"),
    [
        (setpoint(vz=0.1), True),
        (setpoint(), True),
        (setpoint(vz=-0.1), False),
        (setpoint(vx=0.1, vz=0.1), False),
        (setpoint(vz=0.1, yaw_rate=0.1), False),
    ],
)
def test_an_application_that_ends_its_flight_may_sink_and_nothing_else(asked: Frame, passes: bool) -> None:
    """Protects the application's own landing by setpoints, and nothing more than that."""
    air = nowhere()
    air.setpoints = False
    air.beat = replace(BEAT, phase=Phase.ENDING)
    air.run(0.06)
    raw = air.ask(asked)
    assert raw is not None
    assert (raw == asked.raw) == passes
