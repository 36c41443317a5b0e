"""What passes at each stage of the answer, when a flight ends, and what the pilot is told of it."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from companion.gate.faults import Fault, Stage
from companion.gate.plan import Reaction
from companion.gate.protocol import Notice, Phase
from companion.mavlink.firmware import AutopilotKind
from tests.gate.built import GROUND, KINDS, command, frame, setpoint, texts_of
from tests.gate.gate_scene import JUST_S, NOW_S, ORDER, PLAN, Scene, flying

BOTH = pytest.mark.parametrize("kind", KINDS)
STAGES = (Stage.PASS, Stage.BRAKE, Stage.HOLD, Stage.LAND)


@BOTH
@pytest.mark.parametrize("stage", STAGES)
def test_which_commands_pass_at_which_stage(kind: AutopilotKind, stage: Stage) -> None:
    """Protects the ladder from being climbed down, and the way down from being closed."""
    scene = flying(kind=kind)
    ours = scene.ours
    orders = {
        "arm": command(400, 1.0),
        "disarm": command(400, 0.0),
        "take off": command(22),
        "land": command(21),
        "offboard": command(176, *ours.set_mode_parameters(ours.offboard)),
        "hold": command(176, *ours.set_mode_parameters(ours.hold)),
        "land mode": command(176, *ours.set_mode_parameters(ours.land)),
        "forced": command(400, 0.0, 21196.0),
        "another mode": command(176, 1.0, 1.0, 0.0),
        "another command": command(246, *ours.set_mode_parameters(ours.land)),
    }
    may = {"disarm", "land", "land mode"}
    may |= {"arm", "take off", "offboard"} if stage is Stage.PASS else set()
    may |= {"hold"} if stage < Stage.LAND else set()
    scene.gate._escalation.force(stage)
    assert {name for name, order in orders.items() if scene.passes(order)} == may
    pilots = {AutopilotKind.PX4: 3 << 16, AutopilotKind.ARDUPILOT: 5}[kind]
    scene.heartbeat(pilots)
    assert {name for name, order in orders.items() if scene.passes(order)} == set(), "the pilot has it"
    assert scene.passes(command(512)), "but asking is free"


@pytest.mark.parametrize("stage", STAGES[1:])
def test_while_the_gate_stops_no_setpoint_passes(stage: Stage) -> None:
    """Protects the stop from being overwritten, by good setpoints too."""
    scene = flying()
    scene.gate._escalation.force(stage)
    assert scene.gate.on_application_message(setpoint(), NOW_S).raw is None
    assert scene.gate.on_application_message(setpoint(9.0), NOW_S).raw is None
    assert scene.gate.counts == {
        "application: setpoint while the gate stops": 2,
        "application: setpoint that broke a limit": 1,
    }


def test_hands_off_is_hands_off() -> None:
    """Protects the pilot, and an autopilot that may not hear: not even a stop goes out, and no fault is made of it."""
    scene = flying()
    scene.gate.on_autopilot_message(frame("COMMAND_LONG", GROUND[1], GROUND[0], **ORDER), NOW_S)
    assert 84 in scene.sent(NOW_S)
    texts_of(scene.gate)
    assert scene.gate.on_application_message(setpoint(9.0), NOW_S + 0.75).raw is None
    scene.heartbeat(3 << 16, NOW_S + 1.0)
    assert scene.gate.on_application_message(setpoint(), NOW_S + 1.0).raw is None
    assert scene.gate.counts == {"application: setpoint, but hands are off": 2}
    assert texts_of(scene.gate) == []
    assert scene.sent(NOW_S + 1.0) == [0, 253]


def test_after_a_flight_the_ladder_is_at_its_foot() -> None:
    """Protects the next flight from the stage, the faults and the patience of the last."""
    scene = flying()
    scene.gate.on_autopilot_message(frame("COMMAND_LONG", GROUND[1], GROUND[0], **ORDER), NOW_S)
    scene.gate._escalation.force(Stage.HOLD)
    scene.gate.cycle(NOW_S)
    assert scene.patient_since_s() == NOW_S
    assert scene.stage() is Stage.HOLD
    assert scene.mode(scene.ours.land)
    scene.heartbeat(scene.ours.land)
    scene.gate.cycle(NOW_S)
    scene.heartbeat(scene.ours.land, armed=False)
    scene.gate.cycle(NOW_S)
    assert scene.stage() is Stage.PASS
    assert scene.patient_since_s() is None
    assert not scene.gate._escalation.counting


@pytest.mark.parametrize(
    ("blind_s", "after", "stage"),
    [
        (3.0, Phase.ENDED, Stage.LAND),
        (0.5, Phase.ENDED, Stage.PASS),
        (3.0, Phase.EXPLORING, Stage.HOLD),
    ],
)
def test_a_landing_stays_due_when_the_application_ends_its_flight_in_a_hold(
    blind_s: float, after: Phase, stage: Stage
) -> None:
    """Protects a vehicle that was stopped: who ends tells no more, which is not the same as that all is well."""
    scene = flying(replace(PLAN, reactions=PLAN.reactions | {Fault.DEPTH_STALE: Reaction(Stage.BRAKE, 3.0, 10.0)}))
    for quarter in range(12 * 4):
        now_s = NOW_S + quarter / 4
        blind = now_s <= NOW_S + blind_s
        shown = {Stage.HOLD: scene.ours.hold, Stage.LAND: scene.ours.land}.get(scene.stage(), scene.ours.offboard)
        scene.heartbeat(shown, now_s)
        scene.at(now_s, x=1e-3 * (quarter % 3))
        scene.beat(Phase.EXPLORING if blind else after, now_s, depth_age_s=9.0 if blind else 0.0)
        scene.gate.on_application_message(setpoint(), now_s)
        scene.gate.cycle(now_s)
    assert scene.stage() is stage


# What the pilot is told: each thing once, in one order, and nothing on the ground.


def test_a_flood_is_a_fault_while_it_lasts() -> None:
    """Protects the pilot's knowledge of it."""
    scene = flying()
    for _ in range(300):
        scene.gate.on_application_message(frame("HEARTBEAT"), NOW_S)
    scene.gate.cycle(NOW_S)
    assert texts_of(scene.gate) == ["flood", "brake: flood"]


def test_faults_that_come_together_are_told_in_one_order() -> None:
    """Protects tests and logs from sets, which have none."""
    scene = flying()
    never = dict.fromkeys(("depth_age_s", "ranges_age_s", "pose_age_s", "map_age_s"), math.inf)
    scene.beat(Phase.EXPLORING, **never)
    scene.gate.on_application_died("fell")
    scene.gate.cycle(NOW_S)
    _, *told = texts_of(scene.gate)
    names = ["application died", "depth_stale never", "map never", "pose_stale never", "ranges_stale never"]
    assert told == [*names, "brake: application"]


def test_what_is_told_of_a_fault_and_of_its_answer() -> None:
    """Protects the pilot's reading: the fault with its number once, the stage with its cause, and the end of it."""
    scene = flying()
    scene.beat(Phase.EXPLORING, depth_age_s=0.75)
    assert scene.sent(NOW_S) == [84, 253]
    assert texts_of(scene.gate) == ["depth_stale 0.75 s", "brake: depth_stale"]
    assert scene.sent(NOW_S + 0.0625) == [], "not twice in a period, and the pilot reads the first text yet"
    for later_s in (0.6, 1.2, 1.8):
        now_s = NOW_S + later_s
        scene.heartbeat(scene.ours.offboard, now_s)
        scene.at(now_s, x=1e-3 * later_s)
        scene.beat(Phase.EXPLORING, now_s)
        scene.gate.on_application_message(setpoint(), now_s)
        scene.gate.cycle(now_s)
    assert scene.stage() is Stage.PASS
    assert texts_of(scene.gate)[-1] == "pass: all is well"


def test_an_order_is_told_without_numbers() -> None:
    """Protects the same for faults that have none."""
    scene = flying()
    scene.gate.on_autopilot_message(frame("COMMAND_LONG", GROUND[1], GROUND[0], **ORDER), NOW_S)
    assert scene.sent(NOW_S)[:2] == [77, 84], "the answer goes out with the stop"
    assert texts_of(scene.gate) == ["ground_stop", "brake: ground_stop"]


def test_hands_are_off_once_in_each_flight() -> None:
    """Protects the pilot from being told again and again, and from not being told the next time."""
    scene = flying()
    for _ in range(2):
        scene.heartbeat(3 << 16)
        assert not scene.gate.airborne
        scene.gate.cycle(NOW_S)
        scene.gate.cycle(NOW_S)
        assert texts_of(scene.gate) == ["hands off: mode position"]
        scene.heartbeat(3 << 16, armed=False)
        scene.gate.cycle(NOW_S)
        scene.heartbeat(3 << 16)
        assert not scene.gate.airborne, "who arms it now is somebody else"
        scene.gate.cycle(NOW_S)
        assert texts_of(scene.gate) == []
        scene.heartbeat(3 << 16, armed=False)
        scene.gate.on_application_started()
        scene.beat(Phase.CLIMBING)
        scene.fly()


def test_on_the_ground_nothing_is_a_fault() -> None:
    """Protects from stops, modes and texts before anything flies."""
    scene = Scene()
    for second in range(1, 9):
        assert scene.sent(NOW_S + second) == [0]
    assert texts_of(scene.gate) == []


def test_the_stage_is_said_again_when_there_is_nothing_else_to_tell() -> None:
    """Protects from a notice that was lost: a take-off would go on under a gate that holds."""
    scene = flying()
    scene.gate.drain_notices(NOW_S)
    assert scene.gate.drain_notices(NOW_S + 0.125 - JUST_S) == [], "not each time"
    assert scene.gate.drain_notices(NOW_S + 0.125) == [Notice(Stage.PASS)]
    scene.beat(Phase.EXPLORING, depth_age_s=0.75)
    scene.gate.cycle(NOW_S)
    told = scene.gate.drain_notices(NOW_S + 0.25)
    assert [(notice.stage, notice.fault) for notice in told] == [(Stage.BRAKE, Fault.DEPTH_STALE)] * 2
    assert scene.gate.drain_notices(NOW_S + 0.375 - JUST_S) == [], "it has just been said"
    assert scene.gate.drain_notices(NOW_S + 0.375) == [Notice(Stage.BRAKE, Fault.DEPTH_STALE)]
