"""What is shipped for ground stations: that their parsers take it, and that it does what it says."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from companion.flight.events import EventEmitter
from companion.flight.mavlink_commands import MavlinkCommands, Refusals
from companion.flight.operator_commands import OperatorCommands, Wish
from companion.flight.phase import FlightPhase, PhaseMachine
from companion.gate.faults import Stage
from companion.mavlink.ids import MavCmd, MavComponent
from tests.autopilot.fake_link import FakeLink
from tests.gate.built import GROUND, SYSTEM, frame
from tests.gate.gate_scene import NOW_S, flying
from tests.shared.clocks import HandClock

FOLDER = Path(__file__).parents[2] / "ground-stations"
SCRIPT = (FOLDER / "explore.lua").read_text(encoding="ascii")
ACTIONS: list[dict[str, Any]] = json.loads((FOLDER / "qgroundcontrol-actions.json").read_text())["actions"]
BY_LABEL = {action["label"]: action for action in ACTIONS}
STOP = "STOP: brake and hold"

# How QGroundControl 5 reads its actions: these keys, of these types; the first three have to be there.
PARAMETERS = [f"param{n}" for n in range(1, 8)]
KEYS: dict[str, Any] = {"label": str, "description": str, "mavCmd": int, "compId": int}
KEYS |= dict.fromkeys(PARAMETERS, (int, float))


def test_qgroundcontrol_takes_the_file() -> None:
    """Its parser refuses a file of another type or version, and one action that lacks a key refuses all of them."""
    file = json.loads((FOLDER / "qgroundcontrol-actions.json").read_text())
    assert set(file) == {"version", "fileType", "actions"}
    assert (file["version"], file["fileType"]) == (1, "MavlinkActions")
    for action in file["actions"]:
        assert {"label", "description", "mavCmd"} <= set(action) <= set(KEYS)
        for key, value in action.items():
            assert isinstance(value, KEYS[key]), (action["label"], key)
            assert not isinstance(value, bool)
    assert len(BY_LABEL) == len(ACTIONS), "a joystick's button is given its action by the label"


def test_a_stop_comes_first_and_a_start_last() -> None:
    """The Fly View asks nobody whether an action is meant: what takes off is furthest from the hand."""
    assert ACTIONS[0]["label"] == STOP
    assert ACTIONS[-1]["mavCmd"] == MavCmd.MISSION_START
    assert "takes off" in ACTIONS[-1]["description"]


def sent(label: str) -> dict[str, Any]:
    """The COMMAND_LONG that it makes; what is left out is 0, and goes to the autopilot."""
    action = BY_LABEL[label]
    fields = {"command": action["mavCmd"], "target_system": SYSTEM, "target_component": action.get("compId", 1)}
    return fields | {name: float(action.get(name, 0.0)) for name in PARAMETERS}


@pytest.mark.parametrize(
    ("label", "phase", "started", "paused", "wish"),
    [
        ("START: take off and explore", FlightPhase.WAITING, True, False, Wish.NOTHING),
        ("Pause the mission", FlightPhase.EXPLORING, False, True, Wish.NOTHING),
        ("Go on with the mission", FlightPhase.EXPLORING, False, False, Wish.NOTHING),
        ("Come home and land", FlightPhase.EXPLORING, False, False, Wish.HOME),
        ("Land here", FlightPhase.EXPLORING, False, False, Wish.LAND),
    ],
)
def test_each_action_does_what_it_says(label: str, phase: FlightPhase, started: bool, paused: bool, wish: Wish) -> None:
    clock, flight = HandClock(), PhaseMachine()
    link, operator = FakeLink(clock, system_id=SYSTEM), OperatorCommands(True, flight)
    MavlinkCommands(operator, link, Refusals(EventEmitter(), clock))
    flight.phase = phase
    flight.pause(label.startswith("Go on"))
    link.deliver("COMMAND_LONG", sent(label), system_id=255, component_id=190)
    assert [answer["result"] for answer in link.sent_named("COMMAND_ACK")] == [0]
    assert (operator.start.is_set(), flight.paused, operator.wish) == (started, paused, wish)


def test_the_stop_is_the_gates_and_needs_no_application() -> None:
    """Protects from the very fault for which it is pressed: an application that no longer listens."""
    assert sent(STOP)["target_component"] == MavComponent.ONBOARD_COMPUTER2
    scene = flying()
    scene.gate.on_autopilot_message(frame("COMMAND_LONG", GROUND[1], GROUND[0], **sent(STOP)), NOW_S)
    scene.gate.cycle(NOW_S)
    assert scene.gate.stage is Stage.BRAKE


def test_every_action_has_a_test() -> None:
    assert len(ACTIONS) == 6


def test_the_script_and_the_application_mean_the_same_numbers() -> None:
    assert f"\nlocal COMPANION, AUTOPILOT = {MavComponent.ONBOARD_COMPUTER:d}, {MavComponent.AUTOPILOT1:d} " in SCRIPT
    orders = (MavCmd.MISSION_START, MavCmd.DO_PAUSE_CONTINUE, MavCmd.NAV_RETURN_TO_LAUNCH)
    assert f"\nlocal START, PAUSE_CONTINUE, HOME = {', '.join(str(int(order)) for order in orders)}\n" in SCRIPT


def test_what_the_script_says_fits_a_display() -> None:
    """A STATUSTEXT has 50 bytes."""
    said = re.findall(r'(?:say|leave)\((?:WARNING, |NOTICE, )?"([^"]*)"', SCRIPT)
    assert len(said) > 5
    assert max(len(f"Explore: {words}") for words in said) <= 50
