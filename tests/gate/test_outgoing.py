"""What the gate says itself, to the byte of the wire."""

from __future__ import annotations

from typing import Any

import pytest

from companion.gate.faults import Fault, Stage
from companion.gate.outgoing import Outgoing
from companion.mavlink.firmware import AutopilotKind
from companion.mavlink.modes import personality
from tests.gate.built import read

SYSTEM = 7


def said(raw: bytes) -> tuple[int, dict[str, Any]]:
    frame, fields = read(raw)
    assert (frame.system_id, frame.component_id) == (SYSTEM, 192)
    return frame.message_id, fields


@pytest.mark.parametrize(
    ("stage", "airborne", "status"),
    [
        (Stage.PASS, False, 3),
        (Stage.LAND, False, 3),
        (Stage.PASS, True, 4),
        (Stage.BRAKE, True, 5),
        (Stage.HOLD, True, 6),
        (Stage.LAND, True, 6),
    ],
)
def test_its_heartbeat_says_what_it_does(stage: Stage, airborne: bool, status: int) -> None:
    """Protects what a ground station shows; and it must be taken neither for an autopilot nor for a vehicle."""
    (raw,) = Outgoing(SYSTEM).due(stage, airborne, 0.0)
    number, fields = said(raw)
    assert number == 0
    assert (fields["type"], fields["autopilot"], fields["system_status"]) == (18, 8, status)
    assert (fields["mavlink_version"], fields["base_mode"], fields["custom_mode"]) == (3, 0, 0)


def test_a_heartbeat_comes_each_second() -> None:
    """Protects the link from more, and whoever waits for it from less."""
    outgoing = Outgoing(SYSTEM)
    sent = [now_s for now_s in (5.0, 5.0, 5.9375, 6.0, 6.25, 6.9375, 7.25) if outgoing.due(Stage.PASS, False, now_s)]
    assert sent == [5.0, 6.0, 7.25]


def test_texts_go_out_in_order_two_a_second_and_the_newest_eight_wait() -> None:
    """Protects the pilot's view: the link is narrow, the newest counts, none is cut by the autopilot."""
    outgoing = Outgoing(SYSTEM)
    outgoing.due(Stage.PASS, False, 0.0)
    for i in range(10):
        outgoing.say(f"{i} " + "x" * 60)
    texts = {}
    for sixteenth in range(1, 100):
        now_s = sixteenth / 16
        for raw in outgoing.due(Stage.PASS, False, now_s):
            number, fields = said(raw)
            if number == 253:
                assert fields["severity"] == 4
                assert len(fields["text"]) == 50
                texts[now_s] = fields["text"][:7]
    assert texts == {0.0625 + 0.5 * i: f"gate: {i + 2}" for i in range(8)}


def test_the_log_and_the_application_are_told_all_of_it() -> None:
    """Protects the record of a flight: texts and notices, in order, whole; bounded when nobody takes them."""
    outgoing = Outgoing(SYSTEM)
    outgoing.say("to all " + "x" * 60, Fault.MAP)
    outgoing.note("not to the pilot")
    assert outgoing.drain_notices() == [(Fault.MAP, "to all " + "x" * 60), (None, "not to the pilot")]
    assert outgoing.drain_notices() == []
    for i in range(70):
        outgoing.note(str(i))
    assert outgoing.drain_notices() == [(None, str(i)) for i in range(6, 70)]
    sent = [said(raw) for raw in outgoing.due(Stage.PASS, False, 0.0)]
    assert [number for number, _ in sent] == [0, 253]


def test_a_stop_is_a_setpoint_of_nothing() -> None:
    """Protects the one message that everything rests on: for our autopilot, velocity alone, all of it zero."""
    number, fields = said(Outgoing(SYSTEM).velocity(0.0, 0.0, 0.0, 4_294_969.5))
    assert number == 84
    assert fields.pop("time_boot_ms") == 2204, "wraps round after 49 days"
    assert fields.pop("target_system") == SYSTEM
    assert fields.pop("target_component") == 1
    assert (fields.pop("coordinate_frame"), fields.pop("type_mask")) == (8, 0x5C7)
    assert set(fields.values()) == {0.0}


@pytest.mark.parametrize(
    ("kind", "hold"), [(AutopilotKind.PX4, (1.0, 4.0, 3.0)), (AutopilotKind.ARDUPILOT, (1.0, 17.0, 0.0))]
)
def test_a_mode_is_asked_for_in_the_autopilots_own_numbers(
    kind: AutopilotKind, hold: tuple[float, float, float]
) -> None:
    """Protects the second stage; what is remembered of it is what was sent."""
    ours = personality(kind)
    raw, remembered = Outgoing(SYSTEM).mode(ours, ours.hold)
    number, fields = said(raw)
    assert (number, fields["command"], fields["confirmation"]) == (76, 176, 0)
    assert (fields["target_system"], fields["target_component"]) == (SYSTEM, 1)
    assert (fields["param1"], fields["param2"], fields["param3"]) == hold
    assert remembered == {"param1": hold[0], "param2": hold[1], "param3": hold[2]}


@pytest.mark.parametrize("result", [0, 1])
def test_who_ordered_is_answered(result: int) -> None:
    """Protects whoever gave the command from sending it again and again."""
    number, fields = said(Outgoing(SYSTEM).acknowledge(193, result, 255, 190))
    assert number == 77
    assert (fields["command"], fields["result"]) == (193, result)
    assert (fields["target_system"], fields["target_component"]) == (255, 190)


def texts(outgoing: Outgoing, now_s: float) -> list[str]:
    return [fields["text"] for number, fields in map(said, outgoing.due(Stage.PASS, False, now_s)) if number == 253]


def test_what_is_urgent_waits_for_nothing() -> None:
    """Protects the pilot's first look: what is being done now comes at once, before what was found."""
    outgoing = Outgoing(SYSTEM)
    for i in range(8):
        outgoing.say(f"fault {i}")
    assert texts(outgoing, 0.0) == ["gate: fault 0"]
    outgoing.say("brake: fault", urgent=True)
    outgoing.say("hold: fault", urgent=True)
    assert texts(outgoing, 0.0625) == ["gate: brake: fault", "gate: hold: fault"], "in their order"
    assert texts(outgoing, 0.5) == []
    assert texts(outgoing, 0.5625) == ["gate: fault 1"], "then the others go on, half a second after it"
    assert [text for _, text in outgoing.drain_notices()] == [
        *(f"fault {i}" for i in range(8)),
        "brake: fault",
        "hold: fault",
    ]


def test_of_what_is_urgent_the_newest_four_wait() -> None:
    """Protects the link from a stage that flutters."""
    outgoing = Outgoing(SYSTEM)
    for i in range(6):
        outgoing.say(f"{i}", urgent=True)
    assert texts(outgoing, 0.0) == [f"gate: {i}" for i in (2, 3, 4, 5)]


def test_a_velocity_of_the_gates_own_does_not_turn() -> None:
    """Protects what keeps a place: forward, right and down as asked, and the heading as it is."""
    number, fields = said(Outgoing(SYSTEM).velocity(0.25, -0.5, 0.125, 1.0))
    assert number == 84
    assert (fields["vx"], fields["vy"], fields["vz"], fields["yaw_rate"]) == (0.25, -0.5, 0.125, 0.0)
