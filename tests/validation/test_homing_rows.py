"""What the program of the rows of "when home cannot be reached" takes for wrong, and how it goes on."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest

from validation.homing import rows
from validation.homing.row_flight import Came, Row
from validation.homing.rows import BY_NAME, CELLS, ROWS, main, problems, table

LANDED = Came("landing", "px4", "stopped", 6.0, 0.4, "land", armed=False, contacts=0, after_s=20.0, said=True)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({}, []),
        ({"ended": "home"}, ["ended: home"]),
        ({"ended": None}, ["ended: None"]),
        ({"contacts": 1}, ["1 contacts"]),
        ({"went_m": 2.5}, ["lay 2.50 m from where it was"]),
        ({"lay_m": None}, ["lay - m from home"]),
        ({"armed": True}, ["armed"]),
        ({"row": "pilot", "ended": "pilot took over"}, ["disarmed"]),
        ({"row": "pilot", "ended": "pilot took over", "armed": True}, []),
        ({"row": "depth back", "ended": "home", "lay_m": 0.1, "said": False}, ["did not say: stopped: no depth"]),
        ({"problem": "never armed", "contacts": 2}, ["never armed"]),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_flight(changes: dict[str, Any], words: list[str]) -> None:
    came = replace(LANDED, **changes)
    assert problems(came) == words
    last = table([came]).splitlines()[-1]
    assert last == (f"- {came.row}, px4: {'; '.join(words)}" if words else "every flight ended as it must")


def test_the_flights_are_listed_without_flying(capsys: pytest.CaptureFixture[str]) -> None:
    """Each row once at least, and both autopilots where they have a part in it."""
    assert len(BY_NAME) == len(ROWS), "no two rows have one name"
    assert main(["--list"]) == 0
    assert len(capsys.readouterr().out.splitlines()) == len(CELLS)
    assert main(["--list", "--only", "pilot", "way closed", "--autopilot", "ardupilot"]) == 0
    (line,) = capsys.readouterr().out.splitlines()
    assert line.split()[:2] == ["pilot", "ardupilot"]


def test_what_was_flown_is_not_flown_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Protects an hour of flights that was broken off."""
    file = tmp_path / "rows.json"
    flown = [asdict(replace(LANDED, personality=name)) for name in ("px4", "ardupilot")]
    file.write_text(json.dumps(flown), encoding="utf-8")
    assert main(["--only", "landing", "--json", str(file), "--resume"]) == 0
    assert capsys.readouterr().out.rstrip().endswith("every flight ended as it must")
    with pytest.raises(SystemExit):
        main(["--resume"])


def test_a_flight_that_came_to_nothing_is_flown_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects the table from a computer that was too busy to take off."""
    file = tmp_path / "rows.json"
    came = replace(LANDED, personality="ardupilot", problem="CrewError: not in time")
    file.write_text(json.dumps([asdict(LANDED), asdict(came)]), encoding="utf-8")
    flown: list[str] = []

    def fly(row: Row, personality: str, folder: Path) -> Came:
        del row, folder
        flown.append(personality)
        return replace(LANDED, personality=personality)

    monkeypatch.setattr(rows, "fly", fly)
    assert main(["--only", "landing", "--json", str(file), "--resume"]) == 0
    assert flown == ["ardupilot"]
    assert [one["problem"] for one in json.loads(file.read_text(encoding="utf-8"))] == [None, None]
