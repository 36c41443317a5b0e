"""What the program of flights that come home takes for wrong."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from validation.homing.__main__ import main, problems, table
from validation.homing.flight import Flown, Task
from validation.landed import off_start_m

TASK = Task("px4", True, "random:3", 1, 30.0, 10.0)
END = {
    "arrived": True,
    "ended_because": "home",
    "way_home_m": 12.0,
    "homing_s": 40.0,
    "charge_promised_percent": 80.0,
    "charge_came_percent": 79.0,
}
WELL = Flown(TASK, "time limit", END, 0.2, 0, 1.0, 0, 90.0)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({}, []),
        ({"off_start_m": 0.51}, ["landed 0.51 m off"]),
        ({"off_start_m": None}, ["landed - m off"]),
        ({"contacts": 2}, ["2 contacts"]),
        ({"replay_differing": 7}, ["replay: 7 setpoints differ"]),
        ({"end": None}, ["time limit; the way home: none"]),
        ({"end": END | {"arrived": False, "ended_because": "battery low"}}, ["time limit; the way home: battery low"]),
        ({"end": END | {"charge_came_percent": 76.9}}, ["80 % promised, 77 % came"]),
        ({"problem": "never armed", "contacts": 2}, ["never armed"]),
    ],
)
def test_what_is_wrong_with_a_flight(changes: dict[str, Any], words: list[str]) -> None:
    flown = replace(WELL, **changes)
    assert problems(flown) == words
    assert table([flown]).splitlines()[-1] == (
        f"- {TASK.name}: {words[0]}" if words else "every flight was as it must be"
    )


def test_how_far_it_landed_from_where_it_stood(tmp_path: Path) -> None:
    truth = tmp_path / "truth.csv"
    truth.write_text("t_s,x_m,y_m\n0.0,1.0,1.0\n1.0,9.0,9.0\n2.0,1.3,1.4\n", encoding="utf-8")
    assert off_start_m(truth) == pytest.approx(0.5)
    truth.write_text("t_s,x_m,y_m\n", encoding="utf-8")
    with pytest.raises(ValueError, match="is empty"):
        off_start_m(truth)


def test_the_flights_are_listed_without_flying(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--list", "--count", "2", "--world", "random:3", "--no-gps"]) == 0
    names = [f"{name}-nogps-random-3-{seed}" for seed in (1, 2) for name in ("px4", "ardupilot")]
    assert capsys.readouterr().out.split() == names
