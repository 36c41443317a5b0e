"""Stub, world and application as separate processes: what a person orders on the way out and home, over MAVLink."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from companion.mavlink.ids import MavCmd
from sitl.autopilot.mavlink import dialect as m
from tests.integration.rig import PERSONALITIES
from tests.integration.whole import Flown, flown
from tests.integration.witness import speed_mps
from validation.landed import off_start_m

WITHIN_M = 0.5
STILL_MPS = 0.1
APPLICATION = 191


def order(flight: Flown, command: MavCmd, parameter: float = 0.0) -> None:
    """As a ground station on the autopilot's network sends it to the application."""
    flight.witness.send(m.MAVLink_command_long_message(1, APPLICATION, command, 0, parameter, *[0.0] * 6))


@pytest.mark.flight
@pytest.mark.timeout(200)
@pytest.mark.parametrize("personality", PERSONALITIES)
def test_a_person_pauses_it_sends_it_home_and_it_lands_where_it_took_off(personality: str, tmp_path: Path) -> None:
    """Protects the person on the ground: each order is obeyed while the gate lets the vehicle fly."""
    with flown(tmp_path, personality) as flight:
        flight.explore_for(20.0)
        order(flight, MavCmd.DO_PAUSE_CONTINUE)
        flight.wait_for("paused: it stands", 5.0)
        time.sleep(2.0)
        still_s = time.monotonic()
        time.sleep(3.0)
        still = [pose for pose in tuple(flight.witness.poses) if pose.t_s > still_s]
        assert max(map(speed_mps, still)) < STILL_MPS
        order(flight, MavCmd.NAV_RETURN_TO_LAUNCH)
        flight.wait_for("coming home, ", 5.0)
        assert flight.exit_code(120.0) == 0, flight.said()[-1500:]
        assert flight.witness.ever_armed
    assert off_start_m(tmp_path / "truth.csv") < WITHIN_M
    assert flight.crew.score()["contacts"] == 0
    summary = flight.summary()
    assert summary["ended_because"] == "stopped"
    assert summary["end"]["arrived"], summary["end"]
    assert "ground_stop" not in flight.said(), "a pause is none of the gate's business"
