"""What the application may ask for, how often, and what is counted and answered when it may not."""

from __future__ import annotations

from companion.gate.gate import Gate
from companion.mavlink.codec import Frame
from tests.gate.built import APPLICATION, GATE, SETPOINT, SYSTEM, command, frame, read, texts_of
from tests.gate.gate_scene import JUST_S, NOW_S, PLAN, Scene, flying


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
    ):
        assert scene.gate.on_application_message(sent, NOW_S).raw is None
    assert scene.gate.counts == {
        "application: not on the list": 6,
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
    """Protects the ground from commands without an application behind them."""
    scene = Scene()
    for order in (command(400, 1.0), command(22)):
        assert scene.passes(order, NOW_S + 0.5)
        assert not scene.passes(order, NOW_S + 0.5 + JUST_S)
    assert scene.passes(command(400, 2.0), NOW_S + 9.0), "whatever that is, it does not arm"


def test_an_arming_may_take_its_time() -> None:
    """Protects the take-off: between the order and the motors nothing may make the gate forget whose flight it is."""
    scene = Scene()
    assert scene.passes(command(400, 1.0))
    scene.gate.cycle(NOW_S)
    scene.gate.cycle(NOW_S + 0.01)
    scene.heartbeat(scene.ours.hold, NOW_S + 0.02)
    assert scene.gate.airborne


def test_setpoints_of_another_form_are_on_no_list() -> None:
    """Protects the one form that is checked."""
    scene = flying()
    assert scene.gate.on_application_message(frame(SETPOINT, 42, target_system=SYSTEM), NOW_S).raw is None
    assert scene.gate.on_application_message(frame("SET_ATTITUDE_TARGET", target_system=SYSTEM), NOW_S).raw is None
    assert scene.gate.counts == {"application: not on the list": 2}
