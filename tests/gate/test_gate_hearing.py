"""Whom the gate hears and what it believes, and what it knows of an application that hangs, dies or is new."""

from __future__ import annotations

from dataclasses import replace

import pytest

from companion.gate.faults import Stage
from companion.gate.gate import Gate
from companion.gate.protocol import Goodbye, Notice, Phase
from companion.mavlink.codec import Frame
from tests.gate.built import APPLICATION, AUTOPILOT, BEAT, GATE, SYSTEM, command, frame, read, texts_of
from tests.gate.gate_scene import JUST_S, NOW_S, PLAN, Scene, flying


def test_a_new_gate_knows_nothing() -> None:
    """Protects the first moment: nothing flies, nothing is done, nothing was said."""
    gate = Gate(PLAN, NOW_S)
    assert (gate.stage, gate.airborne, gate.armed, gate.goodbye) == (Stage.PASS, False, False, None)
    assert (texts_of(gate), gate.drain_upward(), gate.counts.total()) == ([], [], 0)
    assert [read(raw)[0].message_id for raw in gate.cycle(NOW_S)] == [0], "it lives, and has no more to say"
    assert texts_of(gate) == []
    assert not gate.hangs(NOW_S + 1e6)
    assert Gate(PLAN, 0.0).drain_notices(0.0) == [Notice(Stage.PASS)], "the stage is said from the beginning"


def test_each_beat_that_cannot_be_is_counted_once() -> None:
    """Protects the numbers in the log; a goodbye is none of them."""
    scene = Scene()
    for data in (b"x", replace(BEAT, t_s=NOW_S + 1.0).packed(), Goodbye(0).packed(), replace(BEAT, t_s=NOW_S).packed()):
        scene.gate.on_word(data, NOW_S)
    assert scene.gate.counts == {"beat that cannot be": 2}


@pytest.mark.parametrize(
    ("component", "system"), [(AUTOPILOT, 2), (154, SYSTEM), (APPLICATION, SYSTEM), (GATE, SYSTEM), (0, SYSTEM)]
)
def test_only_the_autopilot_of_our_vehicle_is_believed(component: int, system: int) -> None:
    """Protects from the words of a neighbour, a camera, and our own echo."""
    gate = Gate(PLAN, NOW_S)
    gate.on_autopilot_message(frame("HEARTBEAT", component, system, autopilot=12, base_mode=128), NOW_S)
    assert not gate.armed
    assert not gate._vehicle.heard_s > 0.0
    gate.on_autopilot_message(frame("HEARTBEAT", AUTOPILOT, SYSTEM, autopilot=12, base_mode=128), NOW_S)
    assert gate.armed


def test_what_is_not_read_is_heard() -> None:
    """Protects the link from being called dead because of a message that nobody here knows, or a longer one."""
    scene = Scene()
    scene.gate.on_autopilot_message(Frame(b"", 12000, SYSTEM, AUTOPILOT, b"", signed=False), NOW_S + 1.0)
    assert scene.gate._vehicle.heard_s == NOW_S + 1.0
    longer = Frame(b"", 0, SYSTEM, AUTOPILOT, b"\1" * 10, signed=False)
    scene.gate.on_autopilot_message(longer, NOW_S + 2.0)
    assert scene.gate._vehicle.heard_s == NOW_S + 2.0
    assert scene.gate._vehicle.heartbeat_s == NOW_S


@pytest.mark.parametrize(
    ("phase", "hangs"),
    [
        (Phase.GROUND, False),
        (Phase.CLIMBING, True),
        (Phase.EXPLORING, True),
        (Phase.ENDING, True),
        (Phase.ENDED, False),
    ],
)
def test_when_an_application_hangs(phase: Phase, hangs: bool) -> None:
    """Protects a working application from being killed, and a vehicle from one that does not work."""
    scene = Scene(phase=phase)
    assert not scene.gate.hangs(NOW_S + 10.0)
    assert scene.gate.hangs(NOW_S + 10.0 + JUST_S) is hangs
    scene.gate.on_application_died("fell")
    assert not scene.gate.hangs(NOW_S + 11.0)
    assert texts_of(scene.gate) == ["the application fell"]


def test_a_new_application_starts_afresh() -> None:
    """Protects it from the last one's end, and the vehicle from being believed to be its."""
    scene = flying()
    scene.gate.on_word(Goodbye(4).packed(), NOW_S)
    assert scene.goodbye() == Goodbye(4)
    scene.gate.on_application_died("fell")
    scene.gate.cycle(NOW_S)
    assert scene.stage() is Stage.BRAKE
    scene.gate.on_application_started()
    assert scene.goodbye() is None
    assert (scene.gate.stage, scene.gate.armed, scene.gate.airborne) == (Stage.PASS, True, False)
    assert not scene.passes(command(400, 1.0)), "it has not ticked yet"
    scene.beat(Phase.CLIMBING)
    assert scene.passes(command(400, 1.0))
    assert scene.gate.airborne
