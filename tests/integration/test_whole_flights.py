"""Stub, world and application as separate processes: they explore and land, and how else a flight ends."""

from __future__ import annotations

import json
import os
import signal
import time
from pathlib import Path

import pytest

from companion.config.settings import Settings
from companion.recording.flight_stats import figures
from sitl.launch.processes import command, free_udp_ports
from tests.integration.relay import LOOPBACK
from tests.integration.rig import PERSONALITIES, PILOTS_MODE, Stub, process, take_over
from tests.integration.whole import family, flown
from tests.integration.witness import Witness, apart_m, speed_mps
from validation.landed import off_start_m

HOME_WITHIN_M = 0.5
CRITICAL_M = Settings().control.critical_margin_m


@pytest.mark.slow
@pytest.mark.timeout(200)
@pytest.mark.parametrize(
    ("personality", "gps"),
    [
        pytest.param("px4", True, id="px4"),
        pytest.param("px4", False, id="px4-no-gps", marks=pytest.mark.flight),
        pytest.param("ardupilot", True, id="ardupilot", marks=pytest.mark.flight),
        pytest.param("ardupilot", False, id="ardupilot-no-gps", marks=pytest.mark.flight),
    ],
)
def test_it_explores_a_room_to_completion_comes_home_and_lands(personality: str, gps: bool, tmp_path: Path) -> None:
    """Protects the whole: what flies here is what is installed, started by its own commands, in real time."""
    with flown(tmp_path, personality, gps) as flight:
        assert flight.exit_code(150.0) == 0, flight.said()[-1500:]
        flight.crew.check()
        flight.witness.wait("landed and disarmed", lambda: not flight.witness.armed, 3.0)
        assert flight.witness.ever_armed
        assert abs(flight.witness.pose().z_m) < 0.4
    summary, truth = flight.summary(), flight.crew.score()
    assert (summary["ended_because"], summary["autopilot"]) == ("complete", personality)
    assert (summary["recording"], summary["map_problem"], summary["skipped_checks"]) == ("whole", None, [])
    assert summary["end"]["arrived"], summary["end"]
    assert off_start_m(tmp_path / "truth.csv") < HOME_WITHIN_M
    assert summary["estimated_completeness"] > 0.9
    assert summary["clock_residual_s"] < 0.03
    assert list(flight.folder.glob("map*")), "the map came home"
    assert truth["contacts"] == 0
    assert truth["least_d_m"] > CRITICAL_M
    assert truth["path_length_m"] > 4.0, "further than up and down"
    assert 1.0 < truth["highest_above_start_m"] < 2.0

    flew = figures(flight.folder / "flight.mcap")
    assert flew.damage is None
    assert flew.ended is not None
    assert flew.ended == "complete; the way home: home"
    assert flew.setpoint_rate_hz == pytest.approx(20.0, rel=0.1)
    assert flew.pose_age_s is not None
    assert flew.pose_age_s.median < 0.1
    assert flew.depth_age_s is not None
    assert flew.depth_age_s.median < 0.4


# How the application ends a flight that does not end by itself, and leaves one that may not begin.


SPEED_MPS = 0.1


@pytest.mark.flight
@pytest.mark.timeout(150)
def test_a_pilot_who_takes_over_keeps_the_vehicle(tmp_path: Path) -> None:
    """Protects the pilot's last word against everything that the application does when a flight ends."""
    with flown(tmp_path, "ardupilot") as flight:
        flight.explore_for(2.0)
        take_over(flight.crew.control_port)
        assert flight.exit_code() == 1
        assert "pilot took over" in flight.said()
        time.sleep(1.2)
        assert (flight.witness.mode, flight.witness.armed) == (PILOTS_MODE["ardupilot"], True)
        assert flight.witness.pose().z_m > 1.0, "it was not landed"
        modes = [beat.mode for beat in flight.witness.beats]
        assert set(modes[modes.index(PILOTS_MODE["ardupilot"]) :]) == {PILOTS_MODE["ardupilot"]}
        summary = flight.summary()
        assert (summary["ended_because"], summary["as_it_should"]) == ("pilot took over", False)


@pytest.mark.flight
@pytest.mark.timeout(150)
@pytest.mark.parametrize("times", [1, 2])
def test_ctrl_c_ends_the_exploring_and_the_next_one_the_way_home(times: int, tmp_path: Path) -> None:
    """Protects the operator's way to end a flight: an interrupt is an order to come home, no end of the program."""
    with flown(tmp_path, "px4") as flight:
        flight.explore_for(15.0)
        for _ in range(times):
            flight.gate.send_signal(signal.SIGINT)
            flight.wait_for("coming home, ")
        assert flight.exit_code(90.0) == 130
        flight.witness.wait("landed and disarmed", lambda: not flight.witness.armed, 3.0)
        assert "land" in {beat.mode for beat in flight.witness.beats}
        summary = flight.summary()
        assert (summary["ended_because"], summary["interrupted"]) == ("stopped", True)
        assert summary["end"]["ended_because"] == ("home" if times == 1 else "stopped")
        assert (summary["recording"], summary["map_problem"]) == ("whole", None)


@pytest.mark.flight
@pytest.mark.timeout(150)
@pytest.mark.parametrize("personality", PERSONALITIES)
def test_a_gate_that_is_killed_leaves_a_vehicle_that_stands_still(personality: str, tmp_path: Path) -> None:
    """Protects against the death of the gate itself: --fix has configured what the autopilot does then.

    And against losing what was flown for: the application writes the map, and says why it ended.
    """
    with flown(tmp_path, personality) as flight:
        flight.explore_for(3.0)
        flight.gate.kill()
        killed_s = time.monotonic()
        assert flight.exit_code() == -signal.SIGKILL
        time.sleep(4.0)
        still = [pose for pose in tuple(flight.witness.poses) if pose.t_s > killed_s + 2.6]
        assert len(still) > 20
        assert max(map(speed_mps, still)) < SPEED_MPS
        assert apart_m(flight.witness.pose_at(killed_s), still[-1]) < 0.9
        assert min(pose.z_m for pose in still) > 1.0
        assert flight.witness.mode == {"px4": "hold", "ardupilot": "guided"}[personality]
        assert flight.crew.score()["contacts"] == 0
        give_up_s = time.monotonic() + 30.0
        while (left := family(flight.gate.pid)) and time.monotonic() < give_up_s:
            time.sleep(0.1)
        assert left == [], "the application ends by itself; recorder and map do not outlive it"
        assert "gate: gone" in flight.said()
        assert "gate lost" in flight.summary()["ended_because"]
        assert list(flight.folder.glob("map*")), "the map came home"


@pytest.mark.flight
@pytest.mark.timeout(170)
@pytest.mark.parametrize("personality", PERSONALITIES)
def test_an_application_that_is_killed_is_stopped_landed_and_not_flown_again(personality: str, tmp_path: Path) -> None:
    """Protects against the death of the application: the gate stops the vehicle, and whoever comes to it is safe."""
    with flown(tmp_path, personality) as flight:
        flight.explore_for(3.0)
        before = flight.application()
        os.kill(before, signal.SIGKILL)
        killed_s = time.monotonic()
        time.sleep(1.6)
        stopping = [pose for pose in tuple(flight.witness.poses) if pose.t_s > killed_s + 1.3]
        assert len(stopping) > 5
        assert max(map(speed_mps, stopping)) < SPEED_MPS
        assert apart_m(flight.witness.pose_at(killed_s), stopping[-1]) < 0.5
        flight.witness.wait("held", lambda: flight.witness.mode in ("hold", "brake"), 5.0)
        flight.witness.wait("landed and disarmed", lambda: not flight.witness.armed, 45.0)
        assert flight.crew.score()["contacts"] == 0

        flight.wait_for("ready: waiting for MAV_CMD_MISSION_START", 60.0)
        assert flight.application() != before
        time.sleep(3.0)
        assert not flight.witness.armed, "what was started by --start now before waits for a person now"
        flight.gate.send_signal(signal.SIGTERM)
        assert flight.exit_code() == 130


@pytest.mark.flight
@pytest.mark.timeout(120)
def test_a_check_that_fails_refuses_the_flight(tmp_path: Path) -> None:
    """Protects the ground: without a camera nothing is armed, and the operator reads why."""
    (port,) = free_udp_ports(1)
    config, log = tmp_path / "vehicle.yaml", tmp_path / "application.log"
    sections = {
        "preset": "flight",
        "autopilot": {"url": f"udpin://{LOOPBACK}:{port}"},
        "mission": {"start": "now"},
        "record": {"folder": str(tmp_path / "flights"), "largest_mb": 100.0},
    }
    config.write_text(json.dumps(sections), encoding="utf-8")
    with (
        Witness() as witness,
        Stub(tmp_path, "px4", (port, witness.port)).running(),
        process(log, [*command("run"), "--config", str(config)]) as application,
    ):
        assert application.wait(90.0) == 1
        said = log.read_text(encoding="utf-8")
        assert "FAIL  depth" in said
        assert "not armed" in said
        time.sleep(1.2)
        assert not witness.ever_armed
    assert not (tmp_path / "flights").exists(), "there was no flight to record"
