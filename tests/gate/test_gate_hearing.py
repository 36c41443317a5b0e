"""Whom the gate hears and what it believes: autopilots, the application, and a person who says stop."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from companion.gate.faults import Fault, Stage
from companion.gate.gate import Gate
from companion.gate.protocol import Goodbye, Notice, Phase
from companion.mavlink.codec import Frame
from tests.gate.built import APPLICATION, AUTOPILOT, BEAT, GATE, GROUND, SYSTEM, command, frame, read, texts_of
from tests.gate.gate_scene import JUST_S, NOW_S, ORDER, PLAN, Scene, flying


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
    """Protects the clock of the beats, in which neither the future nor the past is alive; a goodbye is no beat."""
    scene = Scene()
    for data in (b"", b"x", b"beat", b"\xff" * 53, Goodbye(0).packed()):
        scene.gate.on_word(data, NOW_S)
    for sent_s in (NOW_S + 1.0, 1.0, NOW_S):
        scene.gate.on_word(replace(BEAT, t_s=sent_s).packed(), NOW_S)
    assert scene.gate.counts == {"beat that cannot be": 6}


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
    """Protects a working application from being killed, and a vehicle from one that neither works nor ends."""
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


# Orders of a person: who may stop the vehicle, over which link, and addressed to whom.


def ordered(scene: Scene) -> bool:
    return Fault.GROUND_STOP in scene.gate._monitor.faults(NOW_S)


@pytest.mark.parametrize("name", ["COMMAND_LONG", "COMMAND_INT"])
@pytest.mark.parametrize("system", [0, SYSTEM])
@pytest.mark.parametrize("component", [0, AUTOPILOT, GATE])
def test_an_order_to_stop_reaches_us_however_it_is_addressed(name: str, system: int, component: int) -> None:
    """Protects the person on the ground: over the autopilot's link, and over their own, where it ends with us.

    The pause button of a ground station addresses the autopilot: ArduCopter would freeze in guided without a word, and
    fly on as soon as somebody presses "continue".
    """
    order = frame(name, GROUND[1], GROUND[0], **(ORDER | {"target_system": system, "target_component": component}))
    scene = Scene()
    scene.gate.on_autopilot_message(order, NOW_S)
    assert ordered(scene)
    attached = Scene()
    assert attached.gate.on_attached_message(order, "command", NOW_S) is False, "it ends here"
    assert ordered(attached)
    acks = [fields for fields in (read(raw)[1] for raw in attached.gate.cycle(NOW_S)) if "result" in fields]
    assert [(ack["command"], ack["result"], ack["target_system"], ack["target_component"]) for ack in acks] == (
        [(193, 0, *GROUND)] if component != APPLICATION else []
    )
    assert 77 not in attached.sent(NOW_S), "once"


@pytest.mark.parametrize(
    "changes",
    [
        {"target_system": 2},
        {"target_component": 154},
        {"command": 194},
        {"command": 300},
        {"param1": 1.0},
        {"param1": math.nan},
    ],
)
def test_other_orders_are_not_ours(changes: dict[str, Any]) -> None:
    """Protects the flight from orders to somebody else, and from "continue"."""
    order = frame("COMMAND_LONG", GROUND[1], GROUND[0], **(ORDER | changes))
    scene = Scene()
    scene.gate.on_autopilot_message(order, NOW_S)
    scene.gate.on_attached_message(order, "command", NOW_S)
    scene.gate.on_autopilot_message(frame("HEARTBEAT", GROUND[1], GROUND[0]), NOW_S)
    assert not ordered(scene)


@pytest.mark.parametrize("component", [APPLICATION, GATE])
def test_a_person_may_sit_at_any_component(component: int) -> None:
    """Protects a ground station that has our numbers, in a system of its own."""
    scene = Scene()
    scene.gate.on_autopilot_message(frame("COMMAND_LONG", component, GROUND[0], **ORDER), NOW_S)
    assert ordered(scene)


def test_who_may_command_may_send_what_nobody_here_knows() -> None:
    """Protects a ground station's work: files, logs, missions."""
    unknown = Frame(b"", 12000, *GROUND, b"", signed=False)
    assert Scene().gate.on_attached_message(unknown, "command", NOW_S) is True


@pytest.mark.parametrize("may", ["read", "odometry"])
def test_who_may_not_command_does_not_stop_either(may: str) -> None:
    """Protects the promise of "read": nothing that comes from there does anything."""
    scene = Scene()
    assert not scene.gate.on_attached_message(frame("COMMAND_LONG", GROUND[1], GROUND[0], **ORDER), may, NOW_S)
    assert not ordered(scene)
    assert scene.gate.counts == {"attached: not permitted": 1}
    assert scene.gate.on_attached_message(frame("HEARTBEAT", 197), may, NOW_S) is (may == "odometry")


def test_the_autopilot_and_the_application_order_nothing_as_a_person() -> None:
    """Protects from taking the vehicle's own words, or ours sent back, for those of a person."""
    scene = Scene()
    for component in (AUTOPILOT, APPLICATION, GATE):
        scene.gate.on_autopilot_message(frame("COMMAND_LONG", component, **ORDER), NOW_S)
    assert not ordered(scene)


def stop(scene: Scene) -> list[str]:
    """A person orders one; what the gate says to it."""
    texts_of(scene.gate)
    scene.gate.on_autopilot_message(frame("COMMAND_LONG", GROUND[1], GROUND[0], **ORDER), NOW_S)
    return texts_of(scene.gate)


def test_after_a_stop_on_the_ground_nothing_takes_off() -> None:
    """Protects from a vehicle that is armed and braked on the ground, and from a stop that seems not to be heard."""
    scene = Scene()
    assert stop(scene) == ["stop ordered: nothing takes off"]
    assert stop(scene) == [], "once"
    assert not scene.passes(command(400, 1.0)), "not armed"
    assert not scene.passes(command(22))
    assert scene.passes(command(400, 0.0)), "but disarmed at any time"
    scene.gate.on_application_started()
    scene.beat(Phase.GROUND)
    assert scene.passes(command(400, 1.0)), "who runs it again means it"


def test_a_stop_in_the_air_is_not_about_taking_off() -> None:
    assert stop(flying()) == []
