"""What may pass: the tables by themselves, and the gate that goes by them."""

from __future__ import annotations

import math
from typing import Any

import pytest

from companion.gate.allowlist import is_forced, mode_asked_for, only_reads
from companion.gate.gate import Gate
from companion.mavlink.codec import Frame
from companion.mavlink.firmware import AutopilotKind
from companion.mavlink.messages import BY_NAME
from companion.mavlink.modes import personality, px4_mode
from tests.gate.built import APPLICATION, GATE, GROUND, SETPOINT, SYSTEM, command, frame, in_the_air, read, texts_of
from tests.gate.gate_scene import JUST_S, NOW_S, PLAN, Scene, flying


@pytest.mark.parametrize("kind", list(AutopilotKind))
def test_a_mode_is_read_as_it_is_asked_for(kind: AutopilotKind) -> None:
    """Protects the comparison with the modes that may pass: both ways through the same numbers."""
    ours = personality(kind)
    for mode in (ours.offboard, ours.hold, ours.land):
        _, main, sub = ours.set_mode_parameters(mode)
        assert mode_asked_for(kind, {"param2": main, "param3": sub}) == mode


@pytest.mark.parametrize(
    ("main", "sub", "mode"),
    [
        (0.0, 0.0, 0),
        (255.0, 255.0, 255 << 16 | 255 << 24),
        (6.9, 0.9, px4_mode(6)),
        (256.0, 0.0, None),
        (0.0, 256.0, None),
        (-0.5, 0.0, None),
        (4.0, -0.5, None),
        (math.nan, 0.0, None),
        (4.0, math.nan, None),
        (math.inf, 0.0, None),
        (4.0, math.inf, None),
    ],
)
def test_what_is_no_byte_is_no_mode(main: float, sub: float, mode: int | None) -> None:
    """Protects the gate from raising, and from reading another mode than the autopilot."""
    assert mode_asked_for(AutopilotKind.PX4, {"param2": main, "param3": sub}) == mode


@pytest.mark.parametrize(("main", "mode"), [(4.0, 4), (6.9, 6), (255.0, 255), (256.0, None), (math.nan, None)])
def test_ardupilot_has_one_number(main: float, mode: int | None) -> None:
    """Protects the same where the second number means nothing."""
    found = mode_asked_for(AutopilotKind.ARDUPILOT, {"param2": main, "param3": 3.0})
    assert found == mode
    assert not isinstance(found, float)


@pytest.mark.parametrize(("magic", "forced"), [(0.0, False), (21196.0, True), (2989.0, True), (1.0, True)])
def test_any_magic_number_is_force(magic: float, forced: bool) -> None:
    """Protects the autopilot's checks, and the motors in the air, also from magic numbers of other firmware."""
    assert is_forced({"param2": magic}) is forced


# Which messages pass down, and which do not.


PASSES = [
    frame("HEARTBEAT"),
    frame("STATUSTEXT", text="hello"),
    frame("PARAM_REQUEST_READ", target_system=1),
    command(511, 30.0, 20000.0),
    command(401),
    frame("COMMAND_INT", target_system=1, target_component=1, command=512),
]


PASSES_NOT = [
    frame("SET_MODE", target_system=1, base_mode=1),
    frame("SET_ATTITUDE_TARGET", target_system=1),
    frame("SET_POSITION_TARGET_GLOBAL_INT", target_system=1),
    frame("MANUAL_CONTROL"),
    frame("RC_CHANNELS_OVERRIDE"),
    frame("ODOMETRY"),
    frame("PARAM_SET", target_system=1),
    frame("COMMAND_INT", target_system=1, target_component=1, command=400, param1=1.0),
    command(246, 1.0),
    command(400, 0.0, 21196.0),
    command(400, 1.0, 21196.0),
    command(176, 1.0, 3.0),
    command(176, 1.0, math.nan),
    command(176, 1.0, 256.0),
    command(176, 1.0, 4.0, -1.0),
    command(511, target_system=2),
    command(511, target_component=154),
    frame("HEARTBEAT", 42),
    frame("HEARTBEAT", APPLICATION, 2),
]


@pytest.mark.parametrize("sent", PASSES, ids=lambda sent: str(sent.message_id))
def test_what_is_on_the_list_passes(sent: Any) -> None:
    """Protects the application's work: asking, telling."""
    assert in_the_air().ask(sent) == sent.raw


@pytest.mark.parametrize("sent", PASSES_NOT, ids=lambda sent: str(sent.message_id))
def test_what_is_not_on_the_list_does_not_pass(sent: Any) -> None:
    """Protects everything else: what nobody thought of does not reach the autopilot."""
    air = in_the_air()
    before = air.gate.counts.total()
    assert air.ask(sent) is None
    assert air.gate.counts.total() == before + 1


def test_a_message_that_is_not_known_does_not_pass_down() -> None:
    """Protects the list: unknown is not harmless."""
    unknown = bytes([0xFD, 0, 0, 0, 0, 1, APPLICATION, 0xE0, 0x2E, 0, 1, 2])
    from companion.mavlink.codec import Framer

    (found,) = Framer().frames(unknown)
    assert in_the_air().ask(found) is None
    assert in_the_air().gate.on_attached_message(found, "command", 0.0), "a ground station's may be anything"


def test_what_attached_ones_may_send() -> None:
    """Protects the read-only ground station's promise, and the vehicle from steering by two."""
    air = in_the_air()
    beat, steer = frame("HEARTBEAT", GROUND[1], GROUND[0]), frame(SETPOINT, GROUND[1], GROUND[0], target_system=1)
    feed = frame("ODOMETRY", 197)
    mode = frame("COMMAND_LONG", GROUND[1], GROUND[0], target_system=1, target_component=1, command=176)
    found = {
        may: [air.gate.on_attached_message(sent, may, air.now_s) for sent in (beat, steer, feed, mode)]
        for may in ("read", "command", "odometry")
    }
    assert found == {
        "read": [False, False, False, False],
        "command": [True, False, True, True],
        "odometry": [True, False, True, False],
    }


# What the application may ask for, how often, and what is counted and answered when it may not.


def test_a_burst_of_half_a_second_passes_and_no_more() -> None:
    """Protects the autopilot's link: to the message, and with the time that fills up again."""
    scene = Scene()
    gate = Gate(PLAN, NOW_S)
    ping = frame("HEARTBEAT")
    assert [gate.on_application_message(ping, NOW_S).raw is not None for _ in range(201)] == [True] * 200 + [False]
    assert gate.counts == {"application: flood": 1}
    assert gate.on_application_message(ping, NOW_S + 0.00225).raw is None
    assert gate.on_application_message(ping, NOW_S + 0.00375).raw is not None
    assert gate.on_application_message(ping, NOW_S + 0.00375).raw is None
    later_s = NOW_S + 60.0
    assert sum(gate.on_application_message(ping, later_s).raw is not None for _ in range(300)) == 200
    assert scene.gate.counts.total() == 0


def test_every_reason_has_its_count() -> None:
    """Protects who looks for the cause in the log."""
    scene = flying()
    for sent in (
        frame("HEARTBEAT", 42),
        frame("HEARTBEAT", APPLICATION, 2),
        frame("MANUAL_CONTROL"),
        frame("COMMAND_INT", target_system=SYSTEM, target_component=1, command=400),
        frame("PARAM_SET", target_system=SYSTEM),
        command(511, target_system=2),
        command(511, target_component=154),
        command(246, 1.0),
        Frame(b"", 12000, SYSTEM, APPLICATION, b"", signed=False),
        Frame(b"", 84, SYSTEM, APPLICATION, b"\1" * 54, signed=False),
        frame(SETPOINT, 42, target_system=SYSTEM),
        frame("SET_ATTITUDE_TARGET", target_system=SYSTEM),
    ):
        assert scene.gate.on_application_message(sent, NOW_S).raw is None
    assert scene.gate.counts == {
        "application: not on the list": 8,
        "application: parameter in flight": 1,
        "application: command for another": 2,
        "application: command refused": 1,
    }


def test_a_refused_command_is_answered_to_the_application() -> None:
    """Protects the application from waiting for an autopilot that never heard of it."""
    scene = Scene()
    assert not scene.passes(command(246, 1.0))
    (raw,) = scene.gate.drain_upward()
    found, fields = read(raw)
    assert (found.system_id, found.component_id, found.message_id) == (SYSTEM, GATE, 77)
    assert (fields["command"], fields["result"]) == (246, 1)
    assert (fields["target_system"], fields["target_component"]) == (SYSTEM, APPLICATION)
    assert scene.gate.drain_upward() == []
    assert texts_of(scene.gate) == ["command 246 refused"]
    assert scene.passes(command(512, target_component=0))
    assert scene.gate.drain_upward() == []


def test_parameters_pass_to_an_autopilot_that_stands() -> None:
    """Protects the failsafes in flight; on the ground they are what pre-flight sets."""
    gate = Gate(PLAN, NOW_S)
    put = frame("PARAM_SET", target_system=SYSTEM)
    assert gate.on_application_message(put, NOW_S).raw is None
    scene = Scene()
    assert scene.passes(put)
    scene.heartbeat(scene.ours.hold)
    assert not scene.passes(put)


def test_who_has_not_ticked_for_half_a_second_begins_nothing() -> None:
    """Protects the ground from commands without a living application behind them."""
    scene = Scene()
    for order in (command(400, 1.0), command(22)):
        assert scene.passes(order, NOW_S + 0.5)
        assert not scene.passes(order, NOW_S + 0.5 + JUST_S)
    for parameter in (0.0, 2.0):
        assert scene.passes(command(400, parameter), NOW_S + 9.0), "it disarms, or whatever that is; it does not arm"


def test_an_arming_may_take_its_time() -> None:
    """Protects the take-off: between the order and the motors nothing may make the gate forget whose flight it is."""
    scene = Scene()
    assert scene.passes(command(400, 1.0))
    scene.gate.cycle(NOW_S)
    scene.gate.cycle(NOW_S + 0.01)
    scene.heartbeat(scene.ours.hold, NOW_S + 0.02)
    assert scene.gate.airborne


def file_operation(opcode: int) -> Frame:
    """One FILE_TRANSFER_PROTOCOL of the application, as it is on the wire."""
    layout = BY_NAME["FILE_TRANSFER_PROTOCOL"]
    payload = bytes((0, 1, 1, 7, 0, 0, opcode)) + b"/etc/extras/all_events.json.xz"
    return Frame(b"raw", layout.message_id, 1, 191, payload, signed=False)


@pytest.mark.parametrize("opcode", range(20))
def test_files_of_the_autopilot_are_read_and_not_changed(opcode: int) -> None:
    """Protects the autopilot's files: PX4's texts are read from one, and none is made, written or removed."""
    reads = opcode in {1, 2, 3, 4, 5, 14, 15}
    verdict = Gate(PLAN, 0.0).on_application_message(file_operation(opcode), 0.0)
    assert (verdict.raw is not None) == reads


def test_an_operation_that_is_left_out_is_none() -> None:
    """Protects from a payload whose end was cut off."""
    assert not only_reads(b"\0\1\1\7\0")
