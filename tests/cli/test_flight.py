"""The commands of a flight, as far as nothing flies: what they refuse, and how they say so."""

from __future__ import annotations

import json
from pathlib import Path
from typing import NoReturn

import pytest

from companion.cli import main as cli
from companion.config.load import load_settings
from companion.flight import request as requests
from companion.flight.request import FlightRequest
from companion.mapping.files.graph_file import read_graph
from tests.recording.flights import fly_in_room


def exit_code(*arguments: str) -> int:
    """What the shell gets."""
    with pytest.raises(SystemExit) as ended:
        cli.main(arguments)
    code = ended.value.code
    return 0 if code is None else int(code)


@pytest.mark.parametrize("command", ["figures", "replay"])
def test_what_is_no_recording_is_refused(command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "notes.mcap"
    file.write_text("no recording")
    assert exit_code(command, str(file)) == 2
    assert str(file) in capsys.readouterr().err


def test_a_replay_compares_and_its_exit_code_says_what_came_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "flight.mcap"
    fly_in_room(file, 5.0)
    assert exit_code("replay", str(file), "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert found["compared"] > 50
    assert found["differing"] == 0
    slower = tmp_path / "slower.yaml"
    slower.write_text("control:\n  max_yaw_rate_radps: 0.55\n")
    assert exit_code("replay", str(file), "--config", str(slower)) == 1


def test_a_replay_makes_the_navigation_graph_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Protects the graph of a flight that ended before it was written: the recording has it; nothing is overwritten."""
    file, target = tmp_path / "flight.mcap", tmp_path / "graph.json"
    fly_in_room(file, 5.0)
    assert exit_code("replay", str(file), "--graph", str(target)) == 0
    graph = read_graph(target)
    # The first second is not flown by the navigator.
    assert sum(edge.time_s for edge in graph.edges) == pytest.approx(4.0, abs=0.2)
    capsys.readouterr()
    assert exit_code("replay", str(file), "--json") == 0
    assert json.loads(capsys.readouterr().out)["graph"] == graph.counts()._asdict()
    assert exit_code("replay", str(file), "--graph", str(target)) == 2
    assert f"--graph {target}: exists already; give a new name" in capsys.readouterr().err
    assert exit_code("replay", str(file), "--graph", str(tmp_path / "none" / "graph.json")) == 1
    assert "No such file or directory; give a file that you may write" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["check", "run"])
def test_settings_that_cannot_be_used_are_refused_before_anything_starts(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "vehicle.yaml"
    file.write_text("autopilot:\n  url: usb0\n")
    assert exit_code(command, "--config", str(file)) == 2
    message = capsys.readouterr().err
    assert f"{file}:2" in message
    assert "expected udpin://" in message


@pytest.fixture
def handed(monkeypatch: pytest.MonkeyPatch) -> list[FlightRequest]:
    """What would have been handed over to the gate."""
    found: list[FlightRequest] = []

    def become(request: FlightRequest) -> NoReturn:
        found.append(request)
        raise SystemExit(0)

    monkeypatch.setattr(requests, "become_the_gate", become)
    return found


def test_a_flight_is_handed_to_the_gate_as_it_was_ordered(handed: list[FlightRequest], tmp_path: Path) -> None:
    file = tmp_path / "vehicle.yaml"
    file.write_text("preset: table_ii\ncontrol:\n  speed_law: governor\n")
    words = ("--seed", "4", "--fix", "--skip", "battery", "--skip", "depth", "--start", "now")
    assert exit_code("run", "--config", str(file), *words, "--resume-map", str(tmp_path / "." / "earlier")) == 0
    asked = FlightRequest(
        "run", load_settings(file), "table_ii", 4, fix=True, skip=("battery", "depth"), resume_map=tmp_path / "earlier"
    )
    assert handed == [asked.started_by("now")]


def test_a_check_is_handed_over(handed: list[FlightRequest]) -> None:
    assert exit_code("check", "--fix") == 0
    assert handed == [FlightRequest("check", load_settings(), "flight", fix=True)]


@pytest.mark.parametrize("command", ["check", "run"])
def test_a_configuration_in_which_a_wall_can_be_reached_is_refused(
    command: str, handed: list[FlightRequest], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "vehicle.yaml"
    file.write_text("safety:\n  stale:\n    depth_s: 5.0\n")
    assert exit_code(command, "--config", str(file)) == 2
    assert "a wall can be reached" in capsys.readouterr().err
    assert handed == []
