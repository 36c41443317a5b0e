"""Stub, world and application as separate processes, flown from a ground station's buttons and by a switch."""

from __future__ import annotations

import json
import time
from pathlib import Path

import pytest

from sitl.autopilot.mavlink import dialect as m
from tests.integration.rig import PERSONALITIES, transmitter, wait_for_words
from tests.integration.whole import Flown, flown
from tests.integration.witness import speed_mps
from validation.landed import off_start_m

ACTIONS = json.loads((Path(__file__).parents[2] / "ground-stations" / "qgroundcontrol-actions.json").read_text())
CHANNEL, LOW_US, MIDDLE_US, HIGH_US = 9, 1000, 1500, 2000
READY = "ready: waiting for MAV_CMD_MISSION_START"
LOST_S, STANDS_S, STILL_MPS, WITHIN_M = 4.0, 4.0, 0.1, 0.5
OUT_OF_REACH = {"px4": (), "ardupilot": ("FS_OPTIONS=20",)}
"""What lets a flight go on without its transmitter; PX4's is set by pre-flight."""


def press(flight: Flown, label: str) -> None:
    """A button of QGroundControl, by what is shipped for it."""
    (action,) = (action for action in ACTIONS["actions"] if action["label"] == label)
    parameters = [float(action.get(f"param{n}", 0.0)) for n in range(1, 8)]
    flight.witness.send(m.MAVLink_command_long_message(1, action["compId"], action["mavCmd"], 0, *parameters))


def is_still(flight: Flown) -> bool:
    """Whether it has stood for a second, once it has had the time to stop."""
    time.sleep(STANDS_S)
    recent = [pose for pose in tuple(flight.witness.poses) if pose.t_s > time.monotonic() - 1.0]
    return max(map(speed_mps, recent)) < STILL_MPS


@pytest.mark.flight
@pytest.mark.timeout(300)
@pytest.mark.parametrize("personality", PERSONALITIES)
def test_a_switch_starts_it_pauses_it_and_calls_it_home_and_its_loss_does_nothing(
    personality: str, tmp_path: Path
) -> None:
    """Protects the pilot who has nothing but a transmitter, and the flight that leaves its reach."""
    mission = {"start": "command", "rc_switch": {"channel": CHANNEL}}
    with flown(tmp_path, personality, mission=mission, parameters=OUT_OF_REACH[personality]) as flight:
        hand = flight.crew.control_port
        transmitter(hand, f"rc channel {CHANNEL} {LOW_US}")
        transmitter(hand, "rc on")
        flight.wait_for(READY)
        assert not flight.witness.ever_armed
        transmitter(hand, f"rc channel {CHANNEL} {HIGH_US}")
        flight.explore_for(5.0)
        transmitter(hand, f"rc channel {CHANNEL} {MIDDLE_US}")
        flight.wait_for("paused: it stands", 5.0)
        assert is_still(flight)
        transmitter(hand, f"rc channel {CHANNEL} {HIGH_US}")
        flight.wait_for("goes on", 5.0)
        transmitter(hand, "rc off")
        transmitter(hand, f"rc channel {CHANNEL} {LOW_US}")
        time.sleep(LOST_S)
        assert "coming home" not in flight.said(), "what nobody sees orders nothing"
        transmitter(hand, "rc on")
        flight.wait_for("coming home, ", 5.0)
        assert flight.exit_code(120.0) == 0, flight.said()[-1500:]
    assert off_start_m(tmp_path / "truth.csv") < WITHIN_M
    assert flight.crew.score()["contacts"] == 0
    assert flight.summary()["ended_because"] == "stopped"


@pytest.mark.flight
@pytest.mark.timeout(200)
@pytest.mark.parametrize("personality", PERSONALITIES)
def test_a_switch_that_is_on_is_refused_before_anything_is_armed(personality: str, tmp_path: Path) -> None:
    with flown(tmp_path, personality, mission={"start": "command", "rc_switch": {"channel": CHANNEL}}) as flight:
        transmitter(flight.crew.control_port, f"rc channel {CHANNEL} {HIGH_US}")
        transmitter(flight.crew.control_port, "rc on")
        assert flight.exit_code(120.0) == 1
        assert not flight.witness.ever_armed
        assert "stands high" in flight.said()
        assert "switch it off" in flight.said()


@pytest.mark.flight
@pytest.mark.timeout(200)
@pytest.mark.parametrize("personality", PERSONALITIES)
def test_the_buttons_of_qgroundcontrol_start_it_and_stop_it(personality: str, tmp_path: Path) -> None:
    """Protects the person at the screen: what is refused is said there, and a stop is one whatever it is at."""
    with flown(tmp_path, personality, mission={"start": "command"}) as flight:
        flight.wait_for(READY)
        press(flight, "Come home and land")
        wait_for_words(flight.log, flight.gate, "home refused: it stands and waits", 5.0)
        press(flight, "START: take off and explore")
        flight.explore_for(5.0)
        press(flight, "STOP: brake and hold")
        flight.wait_for("brake: ground_stop", 5.0)
        assert is_still(flight)
        assert flight.witness.armed, "it holds, until somebody lands it"


@pytest.mark.flight
@pytest.mark.timeout(200)
def test_the_mode_explore_starts_it_and_is_refused_before_its_time(tmp_path: Path) -> None:
    """Protects who chooses a mode and nothing else; on the real one: `tests/real/test_starts.py`."""
    explore = (m.MAV_CMD_DO_SET_MODE, 0, 1, 101, *[0] * 5)
    with flown(tmp_path, "ardupilot", mission={"start": "command"}, parameters=("SCR_ENABLE=1",)) as flight:
        flight.wait_for("connected; listening")
        flight.witness.send(m.MAVLink_command_long_message(1, 1, *explore))
        flight.wait_for("start refused: it is still being checked")
        flight.witness.wait("the mode before", lambda: "Explore: start: not now" in flight.witness.texts, 5.0)
        assert not flight.witness.ever_armed
        flight.wait_for(READY)
        flight.witness.send(m.MAVLink_command_long_message(1, 1, *explore))
        flight.explore_for(5.0)
        flight.witness.send(m.MAVLink_command_long_message(1, 1, *explore))
        time.sleep(2.0)
        assert flight.witness.mode == "guided", "in the air it is not to be had"
        press(flight, "Land here")
        assert flight.exit_code() == 0, flight.said()[-1500:]
    assert flight.crew.score()["contacts"] == 0
