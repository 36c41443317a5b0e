"""What the application and the world of a flight are started with: the same addresses on both sides."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from companion.config.settings import Settings
from sitl.launch.processes import Crew, FlightPlan

STATION = {"url": "udpout://127.0.0.1:14550", "may": "command"}


def attached(folder: Path, **options: Any) -> tuple[Settings, str]:
    """The application's settings, and the command line of the world."""
    crew = Crew(FlightPlan(folder=folder, **options))
    return crew.write_settings(), " ".join(crew._world().arguments)


def test_without_gps_the_odometry_passes_through_the_gate(tmp_path: Path) -> None:
    """Protects from odometry that freezes or ends and that the gate cannot notice, because it never hears it."""
    settings, world = attached(tmp_path, gps=False, personality="ardupilot")
    (one,) = settings.safety.attached
    assert one.may == "odometry"
    assert one.url.startswith("udpin://127.0.0.1:")
    assert f"--odometry-to {one.url.replace('udpin', 'udpout')}" in world
    assert "--odometry-hz 50" in world


def test_who_is_attached_already_stays_attached(tmp_path: Path) -> None:
    """A list in an upper layer of the settings takes the place of a lower one: nobody may be lost by that."""
    settings, _ = attached(tmp_path, gps=False, settings={"safety": {"attached": [STATION], "restarts": 1}})
    assert [one.may for one in settings.safety.attached] == ["command", "odometry"]
    assert settings.safety.restarts == 1


def test_with_gps_there_is_no_odometry(tmp_path: Path) -> None:
    """Nothing listens that nobody needs."""
    settings, world = attached(tmp_path, settings={"safety": {"attached": [STATION]}})
    assert [one.may for one in settings.safety.attached] == ["command"]
    assert "odometry" not in world
