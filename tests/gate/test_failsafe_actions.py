"""What the gate does at each stage, message by message, with its own times."""

from __future__ import annotations

import pytest

from companion.gate.faults import Stage
from companion.mavlink.firmware import AutopilotKind
from tests.gate.built import KINDS
from tests.gate.failsafe_scene import Scene

AGAIN_S, PATIENCE_S = 0.5, 2.5
BOTH = pytest.mark.parametrize("kind", KINDS)


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
