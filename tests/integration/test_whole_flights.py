"""Stub, world and application as separate processes over MAVLink on loopback: they explore and land."""

from __future__ import annotations

from pathlib import Path

import pytest

from companion.config.settings import Settings
from companion.recording.flight_stats import figures
from tests.integration.whole import flown

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
def test_it_explores_a_room_to_completion_and_lands(personality: str, gps: bool, tmp_path: Path) -> None:
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
    assert summary["completeness_estimate"] > 0.9
    assert summary["clock_residual_s"] < 0.03
    assert list(flight.folder.glob("map*")), "the map came home"
    assert truth["contacts"] == 0
    assert truth["least_d_m"] > CRITICAL_M
    assert truth["path_length_m"] > 4.0, "further than up and down"
    assert 1.0 < truth["highest_above_start_m"] < 2.0

    flew = figures(flight.folder / "flight.mcap")
    assert flew.damage is None
    assert flew.ended is not None
    assert flew.ended.startswith("complete")
    assert flew.setpoint_rate_hz == pytest.approx(20.0, rel=0.1)
    assert flew.pose_age_s is not None
    assert flew.pose_age_s.median < 0.1
    assert flew.depth_age_s is not None
    assert flew.depth_age_s.median < 0.4
