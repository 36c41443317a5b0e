"""A signed link from end to end: an autopilot that drops everything unsigned, and the gate that signs and checks."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from sitl.launch.processes import command, environment, free_udp_ports
from tests.integration.relay import LOOPBACK
from tests.integration.rig import BOOT_S, SILENCE, process, wait_for_words


def key_file(file: Path, key: str) -> Path:
    file.write_text(key * 32)
    file.chmod(0o600)
    return file


@pytest.mark.flight
@pytest.mark.parametrize(("gates_key", "found", "patience_s"), [("7c", True, 8.0), ("11", False, 3.0)])
def test_only_who_has_the_key_is_accepted(gates_key: str, found: bool, patience_s: float, tmp_path: Path) -> None:
    """Protects both directions: the autopilot obeys only the key, and what it says is believed only with it."""
    (port,) = free_udp_ports(1)
    log = tmp_path / "autopilot.log"
    stub = [
        *command("sitl", "autopilot", "--personality", "px4", "--boot-s", str(BOOT_S), "--to", f"{LOOPBACK}:{port}"),
        *(part for parameter in SILENCE["px4"] for part in ("--param", parameter)),
        *("--signing-key", str(key_file(tmp_path / "autopilot.key", "7c"))),
    ]
    config = tmp_path / "vehicle.yaml"
    config.write_text(
        f"autopilot:\n  url: udpin://{LOOPBACK}:{port}\n  connect_timeout_s: {patience_s}\n  ready_timeout_s: 5.0\n"
        f"record:\n  folder: {tmp_path}\n"
        f"safety:\n  signing:\n    key_file: {key_file(tmp_path / 'gate.key', gates_key)}\n"
    )
    with process(log, stub) as running:
        wait_for_words(log, running, "standing at", 60.0)
        checked = subprocess.run(
            command("check", "--config", str(config)), env=environment(), check=False, capture_output=True, text=True
        )
    said = checked.stdout + checked.stderr
    assert checked.returncode == 1, "there are no sensors"
    assert ("autopilot         px4 " in said) == found, said
    assert ("no autopilot of system 1" in said) != found, said
    if found:
        # A parameter that is read shows that questions arrive as well as answers.
        assert "COM_OF_LOSS_T" in said
