"""What the gate does at each stage, message by message, with its own times."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from companion.gate.escalation import Escalation
from companion.gate.failsafe_actions import FailsafeActions
from companion.gate.fault_monitor import FaultMonitor
from companion.gate.faults import Stage
from companion.gate.outgoing import Outgoing
from companion.gate.setpoint_limits import VelocitySetpoint
from companion.gate.vehicle import Vehicle
from companion.mavlink.firmware import AutopilotKind
from companion.mavlink.modes import Personality, personality
from tests.gate.built import AUTOPILOT_NUMBER, KINDS, read
from tests.gate.built import PLAN as BUILT

PLAN = replace(BUILT, period_s=0.0625, silence_s=0.5)
AGAIN_S, PATIENCE_S = 0.5, 2.5
BOTH = pytest.mark.parametrize("kind", KINDS)


class Scene:
    """An answer with all that it needs; the vehicle is armed in the mode of setpoints, and heard all the time."""

    def __init__(self, kind: AutopilotKind = AutopilotKind.PX4, *, steered: bool = True, at_s: float = 64.0) -> None:
        self.vehicle = Vehicle(PLAN.thresholds)
        self.monitor = FaultMonitor(PLAN, self.vehicle)
        self.escalation = Escalation(PLAN.reactions, PLAN.recover_s)
        self.failsafe = FailsafeActions(PLAN, self.vehicle, self.monitor, self.escalation, Outgoing(1))
        self.kind = kind
        self.show(self.ours.offboard, at_s)
        self.ask(self.ours.offboard)
        self.show(self.ours.offboard, at_s)
        if steered:
            self.monitor.asked = VelocitySetpoint(at_s, 0.1, 0.0, 0.0, 0.0)

    @property
    def ours(self) -> Personality:
        return personality(self.kind)

    def stage(self) -> Stage:
        return self.escalation.stage

    def show(self, mode: int, now_s: float) -> None:
        fields = {"autopilot": AUTOPILOT_NUMBER[self.kind], "base_mode": 128, "custom_mode": mode, "system_status": 4}
        self.vehicle.on_message("HEARTBEAT", fields, now_s)

    def ask(self, mode: int) -> None:
        _, main, sub = self.ours.set_mode_parameters(mode)
        self.vehicle.on_command_sent(176, {"param2": main, "param3": sub}, 191)

    def due(self, now_s: float) -> list[Any]:
        """``"stop"``, or the mode that was asked for."""
        if now_s - self.vehicle.heard_s > 0.25:
            self.vehicle.on_message(None, {}, now_s)
        found: list[Any] = []
        for raw in self.failsafe.due(now_s):
            frame, fields = read(raw)
            wanted = fields.get("param1"), fields.get("param2"), fields.get("param3")
            modes = {self.ours.set_mode_parameters(mode): mode for mode in (self.ours.hold, self.ours.land)}
            found.append("stop" if frame.message_id == 84 else modes[wanted])  # type: ignore[index]
        return found


def test_nothing_is_said_while_all_is_well() -> None:
    """Protects the application's setpoints from a second voice."""
    assert Scene().due(64.0) == []


def test_to_brake_is_a_stop_each_period() -> None:
    """Protects both: the autopilot's failsafe must not act meanwhile, and the link is narrow."""
    scene = Scene()
    scene.escalation.force(Stage.BRAKE)
    times_s = [64.0 + i / 64 for i in range(13)]
    sent = [now_s for now_s in times_s if scene.due(now_s) == ["stop"]]
    assert sent == [64.0, 64.0625, 64.125, 64.1875]


def test_a_computer_that_has_just_started_waits_for_nothing() -> None:
    """Protects the first moments of the clock, which begins at zero: the first stop and mode are due at once."""
    scene = Scene(at_s=0.03125)
    scene.escalation.force(Stage.HOLD)
    assert scene.due(0.03125) == ["stop", scene.ours.hold]


def test_who_was_never_steered_is_not_stopped_by_setpoints() -> None:
    """Protects a take-off of the autopilot's own, which they would suppress or not reach."""
    scene = Scene(steered=False)
    scene.escalation.force(Stage.BRAKE)
    assert scene.due(64.0) == []
    scene.escalation.force(Stage.HOLD)
    assert scene.due(64.0) == [scene.ours.hold]


@BOTH
def test_a_mode_is_asked_for_until_it_shows_and_stops_go_on_until_then(kind: AutopilotKind) -> None:
    """Protects against a lost command, and against the gap between two modes."""
    scene = Scene(kind)
    scene.escalation.force(Stage.HOLD)
    found = {64.0 + i / 16: scene.due(64.0 + i / 16) for i in range(17)}
    asked = [now_s for now_s, sent in found.items() if scene.ours.hold in sent]
    assert asked == [64.0, 64.0 + AGAIN_S, 64.0 + 2 * AGAIN_S]
    assert all(sent[0] == "stop" for sent in found.values())
    scene.show(scene.ours.hold, 65.5)
    assert [scene.due(65.5 + i / 16) for i in range(16)] == [[]] * 16, "it holds by itself"
    scene.escalation.force(Stage.LAND)
    assert scene.due(67.0) == ["stop", scene.ours.land]
    scene.show(scene.ours.land, 67.25)
    assert [scene.due(67.25 + i / 16) for i in range(16)] == [[]] * 16


@BOTH
def test_the_patience_with_a_hold_ends(kind: AutopilotKind) -> None:
    """Protects a vehicle whose autopilot has no hold: it lands, at its time and not before."""
    scene = Scene(kind)
    scene.escalation.force(Stage.HOLD)
    scene.due(64.0)
    assert scene.due(64.0 + PATIENCE_S) == ["stop", scene.ours.hold]
    assert scene.stage() is Stage.HOLD
    scene.due(64.0 + PATIENCE_S + 2.0**-10)
    assert scene.stage() is Stage.LAND
    assert scene.due(64.0 + PATIENCE_S + AGAIN_S) == ["stop", scene.ours.land]


def test_the_patience_counts_anew_in_the_next_flight() -> None:
    """Protects the next flight from the impatience, and the stops, of the last."""
    scene = Scene()
    scene.escalation.force(Stage.HOLD)
    scene.due(64.0)
    scene.escalation.reset()
    scene.failsafe.reset()
    scene.escalation.force(Stage.HOLD)
    assert scene.due(64.03125) == ["stop", scene.ours.hold], "at once"
    scene.due(64.03125 + PATIENCE_S)
    assert scene.stage() is Stage.HOLD


@BOTH
def test_a_landing_that_was_begun_is_left_to_land(kind: AutopilotKind) -> None:
    """Protects it from a milder hold: asked for again while it does not show, and left alone when it does."""
    scene = Scene(kind)
    scene.ask(scene.ours.land)
    scene.escalation.force(Stage.HOLD)
    assert scene.due(64.0) == ["stop", scene.ours.land]
    scene.show(scene.ours.land, 64.25)
    assert scene.due(65.0) == []


def test_a_hold_of_ours_does_not_keep_from_landing() -> None:
    """Protects the last stage: to hold is not enough then."""
    scene = Scene()
    scene.ask(scene.ours.hold)
    scene.show(scene.ours.hold, 64.0)
    scene.escalation.force(Stage.LAND)
    assert scene.due(64.0) == ["stop", scene.ours.land]
    assert scene.vehicle.asked_modes == {scene.ours.land}, "and the mode that comes is ours"


@pytest.mark.parametrize("stage", [Stage.BRAKE, Stage.HOLD, Stage.LAND])
def test_nothing_is_sent_to_one_who_may_not_hear(stage: Stage) -> None:
    """Protects a failsafe of the autopilot that it began in the silence: first it has to tell its mode."""
    scene = Scene()
    scene.escalation.force(stage)
    heard_s = scene.vehicle.heard_s
    assert scene.failsafe.due(heard_s + 0.5) != [], "so long it waits itself"
    assert not scene.failsafe.link_silent(heard_s + 0.5)
    assert scene.failsafe.link_silent(heard_s + 0.5 + 2.0**-10)
    assert scene.failsafe.due(heard_s + 0.75) == []
    scene.vehicle.on_message("ATTITUDE", {"yaw": 0.0}, heard_s + 1.0)
    assert scene.failsafe.due(heard_s + 1.0) == [], "which an attitude does not tell"
    scene.vehicle.heartbeat_s = heard_s + 0.75
    assert scene.failsafe.due(heard_s + 1.0) == [], "nor a heartbeat from before its end"
    scene.show(scene.ours.offboard, heard_s + 1.25)
    assert not scene.failsafe.link_silent(heard_s + 1.25)
    assert scene.failsafe.due(heard_s + 1.25) != []
    assert scene.failsafe.link_silent(heard_s + 9.0), "and again"
