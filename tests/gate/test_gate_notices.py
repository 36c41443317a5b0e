"""What the pilot is told: each thing once, in one order, and nothing on the ground."""

from __future__ import annotations

import math

from companion.gate.faults import Fault, Stage
from companion.gate.protocol import Notice, Phase
from tests.gate.built import GROUND, frame, setpoint, texts_of
from tests.gate.gate_scene import JUST_S, NOW_S, ORDER, Scene, flying


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
        assert texts_of(scene.gate) == ["hands off, mode position"]
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
