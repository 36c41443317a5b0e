"""Two vehicles in one mine, over MAVLink: every process of both, started by the command."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pytest

from sitl.launch.processes import command

FLIGHT_S = 30.0


@pytest.mark.flight
@pytest.mark.timeout(560)
def test_two_vehicles_hear_and_see_each_other_and_stay_apart(tmp_path: Path) -> None:
    """Protects what only the whole shows: frames, clocks and ports fit together, and nobody is touched."""
    out = tmp_path / "several"
    words = ("sitl", "fly", "--vehicles", "2", "--world", "complex", "--seed", "2", "--time-limit", f"{FLIGHT_S:g}")
    ended = subprocess.run(
        command(*words, "--boot-s", "2", "--out", str(out)), capture_output=True, text=True, timeout=540.0, check=False
    )
    said = ended.stdout + ended.stderr
    # The time is up before the map is complete.
    assert ended.returncode == 1, said
    for number, other in ((1, 2), (2, 1)):
        folder = out / f"vehicle-{number}"
        truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
        assert (truth["contacts"], truth["collisions"]) == (0, 0), said
        # They started two margins apart; layers are 1 m from each other.
        assert 0.6 <= truth["least_distance_between_vehicles_m"] <= 2.1
        (summary,) = folder.glob("*/summary.json")
        fleet = json.loads(summary.read_text(encoding="utf-8"))["fleet"]
        assert (fleet["number"], fleet["heard"], fleet["refused"]) == (number, [other], 0)
