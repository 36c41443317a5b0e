"""The commands of a flight, as far as nothing flies: what they refuse, and how they say so."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from companion import cli
from sitl.together.crew import free_udp_ports
from tests.flights import fly_in_room


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


def test_without_an_autopilot_it_says_where_it_looked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (port,) = free_udp_ports(1)
    file = tmp_path / "vehicle.yaml"
    file.write_text(f"autopilot:\n  url: udpin://127.0.0.1:{port}\n  connect_timeout_s: 0.5\n")
    assert exit_code("check", "--config", str(file)) == 1
    assert f"udpin://127.0.0.1:{port}" in capsys.readouterr().err
