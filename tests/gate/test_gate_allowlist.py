"""Which messages pass down, and which do not."""

from __future__ import annotations

import math
from typing import Any

import pytest

from tests.gate.built import APPLICATION, GROUND, SETPOINT, Air, command, frame, in_the_air

PASSES = [
    frame("HEARTBEAT"),
    frame("STATUSTEXT", text="hello"),
    frame("PARAM_REQUEST_READ", target_system=1),
    command(511, 30.0, 20000.0),
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
    assert in_the_air().gate.on_attached_message(found, "command"), "a ground station's may be anything"


def test_parameters_are_set_on_the_ground_only() -> None:
    """Protects the autopilot's failsafes, which pre-flight has checked."""
    air = Air()
    assert air.ask(frame("PARAM_SET", target_system=1)) is None, "nobody knows yet whether it flies"
    air.heartbeat()
    assert air.ask(frame("PARAM_SET", target_system=1)) is not None
    air.armed = True
    air.heartbeat()
    assert air.ask(frame("PARAM_SET", target_system=1)) is None


def test_nothing_is_armed_without_a_living_application() -> None:
    """Protects the ground: commands alone, without ticks behind them, begin no flight."""
    air = Air()
    air.heartbeat()
    air.beats = False
    air.run(0.1)
    assert air.ask(command(400, 1.0)) is None
    assert air.ask(command(22)) is None
    assert air.ask(command(400, 0.0)) is not None, "to disarm needs nothing"


def test_what_attached_ones_may_send() -> None:
    """Protects the read-only ground station's promise, and the vehicle from steering by two."""
    air = in_the_air()
    beat, steer = frame("HEARTBEAT", GROUND[1], GROUND[0]), frame(SETPOINT, GROUND[1], GROUND[0], target_system=1)
    feed = frame("ODOMETRY", 197)
    mode = frame("COMMAND_LONG", GROUND[1], GROUND[0], target_system=1, target_component=1, command=176)
    found = {
        may: [air.gate.on_attached_message(sent, may) for sent in (beat, steer, feed, mode)]
        for may in ("read", "command", "odometry")
    }
    assert found == {
        "read": [False, False, False, False],
        "command": [True, False, True, True],
        "odometry": [True, False, True, False],
    }
