"""Orders of a person: who may stop the vehicle, over which link, and addressed to whom."""

from __future__ import annotations

import math
from typing import Any

import pytest

from companion.gate.faults import Fault
from companion.mavlink.codec import Frame
from tests.gate.built import APPLICATION, AUTOPILOT, GATE, GROUND, SYSTEM, frame, read
from tests.gate.gate_scene import NOW_S, ORDER, Scene


def ordered(scene: Scene) -> bool:
    return Fault.GROUND_STOP in scene.gate._monitor.faults(NOW_S)


@pytest.mark.parametrize("name", ["COMMAND_LONG", "COMMAND_INT"])
@pytest.mark.parametrize("system", [0, SYSTEM])
@pytest.mark.parametrize("component", [0, APPLICATION, GATE])
def test_an_order_to_stop_reaches_us_however_it_is_addressed(name: str, system: int, component: int) -> None:
    """Protects the person on the ground: over the autopilot's link, and over their own."""
    order = frame(name, GROUND[1], GROUND[0], **(ORDER | {"target_system": system, "target_component": component}))
    scene = Scene()
    scene.gate.on_autopilot_message(order, NOW_S)
    assert ordered(scene)
    attached = Scene()
    assert attached.gate.on_attached_message(order, "command") is (component == 0)
    assert ordered(attached)
    acks = [fields for fields in (read(raw)[1] for raw in attached.gate.cycle(NOW_S)) if "result" in fields]
    assert [(ack["command"], ack["result"], ack["target_system"], ack["target_component"]) for ack in acks] == (
        [(193, 0, *GROUND)] if component == GATE else []
    )
    assert 77 not in attached.sent(NOW_S), "once"


@pytest.mark.parametrize(
    "changes",
    [
        {"target_system": 2},
        {"target_component": AUTOPILOT},
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
    scene.gate.on_attached_message(order, "command")
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
    assert Scene().gate.on_attached_message(unknown, "command") is True


@pytest.mark.parametrize("may", ["read", "odometry"])
def test_who_may_not_command_does_not_stop_either(may: str) -> None:
    """Protects the promise of "read": nothing that comes from there does anything."""
    scene = Scene()
    assert not scene.gate.on_attached_message(frame("COMMAND_LONG", GROUND[1], GROUND[0], **ORDER), may)
    assert not ordered(scene)
    assert scene.gate.counts == {"attached: not permitted": 1}
    assert scene.gate.on_attached_message(frame("HEARTBEAT", 197), may) is (may == "odometry")


def test_the_autopilot_and_the_application_order_nothing_as_a_person() -> None:
    """Protects from taking the vehicle's own words for those of a person."""
    scene = Scene()
    for component in (AUTOPILOT, APPLICATION):
        scene.gate.on_autopilot_message(frame("COMMAND_LONG", component, **ORDER), NOW_S)
    assert not ordered(scene)
