"""What is late or wrong, and how far the answer to it goes."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from companion.gate.faults import Fault, Stage
from companion.gate.protocol import Phase
from companion.mavlink.firmware import AutopilotKind
from tests.gate.built import BEAT, GROUND, KINDS, PLAN, VALID, command, frame, in_the_air, reacting, read, setpoint


@pytest.mark.parametrize("kind", KINDS)
def test_a_flight_in_which_nothing_is_wrong_is_left_alone(kind: AutopilotKind) -> None:
    """Protects the application from a gate that sees ghosts: no stop, no mode, every setpoint to the last byte."""
    air = in_the_air(kind=kind)
    air.run(20.0)
    assert air.stops() == []
    assert air.modes() == []
    assert len(air.passed) == 400
    assert all(fields["vx"] == pytest.approx(0.1) for _, fields in air.passed)
    assert air.notices == []
    raw = setpoint(0.1).raw
    assert air.ask(setpoint(0.1)) == raw


@pytest.mark.parametrize("kind", KINDS)
def test_an_application_that_falls_silent_is_braked_then_held_then_landed(kind: AutopilotKind) -> None:
    """Protects the vehicle from a dead application: the ladder with its delays, counted from the fault."""
    air = in_the_air(kind=kind)
    air.beats = air.setpoints = False
    silent_s = air.now_s
    air.run(4.9)
    assert air.stops()[0] - silent_s <= 0.15, "the aim on the wire"
    gaps = [b - a for a, b in zip(air.stops(), air.stops()[1:], strict=False)]
    assert max(gaps) <= 0.06, "the autopilot's own failsafe must not act meanwhile"
    assert air.modes() == []
    assert air.stage() is Stage.BRAKE
    air.run(1.5)
    assert air.stage() is Stage.HOLD
    assert air.mode == air.ours.hold
    air.run(1.0)
    held = len(air.sent)
    air.run(5.0)
    assert [name for _, name, _ in air.sent[held:] if name != "HEARTBEAT"] == [], "in hold nothing more is needed"
    air.run(20.0)
    assert air.stage() is Stage.LAND
    assert air.mode == air.ours.land


def test_what_is_over_is_over_only_after_a_while_and_a_fault_that_flickers_climbs() -> None:
    """Protects against a gate that lets go too soon: gone for less than `recover_s` is not gone."""
    air = in_the_air()
    for _ in range(7):
        air.beats = False
        air.run(0.2)
        air.beats = True
        air.run(0.6)
    assert air.stage() is Stage.HOLD
    air = in_the_air()
    air.beats = False
    air.run(0.3)
    air.beats = True
    air.run(0.9)
    assert air.stage() is Stage.BRAKE
    air.run(0.3)
    assert air.stage() is Stage.PASS
    assert "pass: all is well" in air.notices
    before = len(air.passed)
    air.run(0.5)
    assert len(air.passed) == before + 10


def test_after_hold_only_a_person_goes_on() -> None:
    """Protects the rule that nothing flies by itself after a hold: neither recovery nor the application leave it."""
    air = in_the_air()
    air.beats = False
    air.run(7.0)
    air.beats = True
    air.run(10.0)
    assert air.stage() is Stage.HOLD
    assert air.set_mode(air.ours.offboard) is None
    assert air.ask(command(22)) is None
    assert air.ask(command(400, 1.0)) is None
    assert air.set_mode(air.ours.land) is not None, "to end a flight is always allowed"
    air.armed = False
    air.run(1.5)
    assert not air.gate.airborne
    assert air.stage() is Stage.PASS, "a new flight is begun by a person"


STALE = [
    (Fault.DEPTH_STALE, {"depth_age_s": 0.61}),
    (Fault.RANGES_STALE, {"ranges_age_s": math.inf}),
    (Fault.POSE_STALE, {"pose_age_s": 0.26}),
]


@pytest.mark.parametrize(("fault", "changes"), STALE)
def test_stale_inputs_brake(fault: Fault, changes: dict[str, Any]) -> None:
    """Protects against an application that flies on what it no longer sees."""
    air = in_the_air()
    air.beat = replace(BEAT, **changes)
    air.run(0.1)
    assert air.stage() is Stage.BRAKE
    assert air.faults()[fault] == 1
    air.beat = replace(BEAT, phase=Phase.ENDING, **changes)
    air.wanted = (0.0, 0.0, 0.0, 0.0)
    air.run(2.0)
    assert air.stage() is Stage.PASS, "who lands needs no look ahead"


def test_the_age_goes_on_while_no_beat_comes() -> None:
    """Protects the sum: the age that a beat tells, and that of the beat itself."""
    air = in_the_air(replace(PLAN, thresholds=replace(PLAN.thresholds, beat_s=10.0, setpoint_s=10.0)))
    air.beat = replace(BEAT, depth_age_s=0.4)
    air.run(0.05)
    air.beats = False
    air.run(0.15)
    assert air.stage() is Stage.PASS
    air.run(0.15)
    assert air.faults()[Fault.DEPTH_STALE] == 1


def test_setpoints_that_stop_while_beats_go_on_are_late() -> None:
    """Protects against a tick that completes and steers nothing: the autopilot would fly on with the last one."""
    air = in_the_air()
    air.setpoints = False
    air.run(0.11)
    assert air.stops() == []
    air.run(0.05)
    assert air.faults()[Fault.SETPOINT_LATE] == 1
    assert air.stops()


def test_a_fault_that_invalidates_the_velocity_lands_at_once() -> None:
    """Protects a vehicle that no longer knows its own velocity: to brake or hold means nothing to it."""
    air = in_the_air(reacting(Fault.ESTIMATOR, Stage.LAND, None, None))
    air.tell("ESTIMATOR_STATUS", flags=VALID)
    air.run(0.1)
    assert air.stage() is Stage.PASS
    air.tell("ESTIMATOR_STATUS", flags=229)  # PX4 without aiding
    air.run(0.02)
    assert air.stage() is Stage.LAND
    assert air.mode == air.ours.land
    air = in_the_air(reacting(Fault.ESTIMATOR, Stage.LAND, None, None), AutopilotKind.ARDUPILOT)
    air.tell("ESTIMATOR_STATUS", flags=0)
    air.run(0.02)
    assert air.stage() is Stage.PASS, "ArduPilot speaks of its estimator in another message"
    air.tell("EKF_STATUS_REPORT", flags=0)
    air.run(0.02)
    assert air.stage() is Stage.LAND


def test_positions_that_stop_jump_freeze_or_are_no_numbers() -> None:
    """Protects against an estimate that cannot be true, as the autopilot tells it."""
    air = in_the_air()
    air.positions = False
    air.run(0.3)
    assert air.faults()[Fault.POSE_STALE] == 1
    assert air.stops()
    air = in_the_air()
    air.position["y"] += 2.0
    air.run(0.05)
    assert air.faults()[Fault.POSE_JUMP] == 1
    air.run(1.3)
    assert air.stage() is Stage.PASS, "a jump is over when the place goes on from where it led"
    air = in_the_air()
    air.positions = False
    for tick in range(20):
        air.run(0.02)
        air.tell("LOCAL_POSITION_NED", time_boot_ms=round(air.now_s * 1e3), x=1.0, y=float(tick < 0))
    assert air.faults()[Fault.POSE_FROZEN] == 1
    air = in_the_air()
    air.position["vz"] = math.nan
    air.run(0.3)
    assert air.faults()[Fault.POSE_STALE] == 1


def test_a_heartbeat_or_a_link_that_is_gone() -> None:
    """Protects against a dead link, and against sending into one: what comes back first is the autopilot's mode."""
    air = in_the_air()
    air.heartbeats = False
    air.run(4.0)
    assert air.faults()[Fault.HEARTBEAT_LOST] == 1
    air = in_the_air()
    air.positions = air.heartbeats = False
    air.run(0.45)
    assert air.faults()[Fault.LINK_LOST] == 1
    assert air.stops()
    air.run(0.1)
    assert read(air.gate.cycle(air.now_s)[0])[0].message_id != 84 if air.gate.cycle(air.now_s) else True
    silent = len(air.stops())
    air.run(2.0)
    assert len(air.stops()) == silent, "it may not hear us: its own failsafe acts, and is not called back"
    air.positions = True
    air.run(0.5)
    assert len(air.stops()) == silent, "positions do not tell what its failsafe has made of the silence"
    assert air.ask(setpoint(0.1)) is None
    air.heartbeat()
    air.run(0.1)
    assert len(air.stops()) > silent


def test_a_low_battery_lands() -> None:
    """Protects the way down; a battery that says nothing of itself is the pre-flight check's business."""
    air = in_the_air(reacting(Fault.BATTERY, Stage.LAND, None, None))
    for percent in (-1, 101, 15):
        air.tell("SYS_STATUS", battery_remaining=percent)
        air.run(0.02)
        assert air.stage() is Stage.PASS
    air.tell("SYS_STATUS", battery_remaining=14)
    air.run(0.02)
    assert air.stage() is Stage.LAND
    assert "battery 14 %" in air.notices


@pytest.mark.parametrize("target", [0, 192])
@pytest.mark.parametrize("through", ["autopilot", "attached"])
def test_a_person_on_the_ground_stops_it_for_good(target: int, through: str) -> None:
    """Protects the operator's stop: it comes over either way, and ends only with the flight."""
    air = in_the_air(reacting(Fault.GROUND_STOP, Stage.BRAKE, 1.0, None))
    order: dict[str, Any] = {"target_system": 1, "target_component": target, "command": 193}
    if through == "autopilot":
        air.tell("COMMAND_LONG", GROUND[1], GROUND[0], **order)
    else:
        passes = air.gate.on_attached_message(
            frame("COMMAND_LONG", GROUND[1], GROUND[0], **order), "command", air.now_s
        )
        assert not passes, "a pause that ArduCopter hears as well freezes it in guided"
    air.run(0.05)
    assert air.stage() is Stage.BRAKE
    air.run(10.0)
    assert air.stage() is Stage.HOLD, "and no landing where nobody asked for one"
    acks = [fields for _, name, fields in air.sent if name == "COMMAND_ACK"]
    assert [ack["target_system"] for ack in acks] == [255]


@pytest.mark.parametrize("through", ["autopilot", "attached"])
def test_a_pause_for_the_application_is_its_own_business(through: str) -> None:
    """Protects a pause that can be continued: a stop of the gate lasts until the flight has ended."""
    air = in_the_air(reacting(Fault.GROUND_STOP, Stage.BRAKE, 1.0, None))
    order: dict[str, Any] = {"target_system": 1, "target_component": 191, "command": 193}
    if through == "autopilot":
        air.tell("COMMAND_LONG", GROUND[1], GROUND[0], **order)
    else:
        told = frame("COMMAND_LONG", GROUND[1], GROUND[0], **order)
        assert not air.gate.on_attached_message(told, "command", air.now_s), "it is not for the autopilot"
    air.run(2.0)
    assert air.stage() is Stage.PASS
    assert not [fields for _, name, fields in air.sent if name == "COMMAND_ACK"], "the application answers"


def test_an_application_that_died_is_not_waited_for() -> None:
    """Protects against hope: a process that is gone does not come back by itself, whatever is heard meanwhile."""
    air = in_the_air(reacting(Fault.APPLICATION, Stage.BRAKE, 2.0, 15.0))
    air.gate.on_application_died("was killed by SIGKILL")
    air.run(0.02)
    assert air.stage() is Stage.BRAKE
    air.run(5.0)
    assert air.mode == air.ours.hold
    air.run(12.0)
    assert air.mode == air.ours.land
    air.armed = False
    air.run(1.5)
    air.gate.on_application_started()
    air.beat = replace(BEAT, phase=Phase.CLIMBING)
    air.run(0.2)
    assert air.ask(command(400, 1.0)) is not None, "a person has started it again"


def test_the_map_alone_stops_nothing_but_is_told() -> None:
    """Protects the pilot's knowledge: without its map the vehicle flies as safely as before."""
    air = in_the_air()
    air.beat = replace(BEAT, map_age_s=31.0)
    air.run(1.0)
    assert air.stage() is Stage.PASS
    assert air.faults()[Fault.MAP] == 1


def test_a_flood_is_cut_off_and_stops_the_vehicle() -> None:
    """Protects the autopilot's link from an application gone wild."""
    air = in_the_air()
    passed = sum(air.ask(frame("HEARTBEAT")) is not None for _ in range(5000))
    assert passed <= 200
    air.run(0.05)
    assert air.faults()[Fault.FLOOD] == 1
    air.run(2.0)
    assert air.stage() is Stage.PASS
    assert air.ask(frame("HEARTBEAT")) is not None
