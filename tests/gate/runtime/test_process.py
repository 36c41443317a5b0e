"""The process from its plan to its exit code, and what it says when it cannot begin."""

from __future__ import annotations

import os
import runpy
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from companion.errors import CompanionError, InputError
from companion.gate import __main__ as main_module
from companion.gate.gate import Gate
from companion.gate.plan import Attached, Plan, Signing
from companion.gate.protocol import Goodbye
from companion.gate.runtime import main as process
from companion.gate.runtime import processes as precedence
from tests.gate.built import PLAN
from tests.gate.runtime.rig import HOST, bound


def whole(**changes: Any) -> Plan:
    with bound() as free:
        url = f"udpin://{HOST}:{free.getsockname()[1]}"
    says_goodbye = (
        sys.executable,
        "-c",
        "import os, socket; "
        "gate = socket.socket(fileno=int(os.environ['COMPANION_GATE_FD'])); "
        f"gate.send(bytes.fromhex('{Goodbye(5).packed().hex()}'))",
    )
    return replace(PLAN, autopilot_url=url, command=says_goodbye, **changes)


def test_the_process_ends_with_the_applications_last_word(capfd: pytest.CaptureFixture[str]) -> None:
    """Protects the way from a plan to the exit code, with nothing of it replaced."""
    plan = whole(attached=(Attached("udpout://127.0.0.1:9", "read"),))
    assert process.run(plan) == 5
    said = capfd.readouterr().err
    assert "not real time" in said
    assert "gate: " in said.splitlines()[-1]


def test_a_broken_gate_ends_at_once_and_says_why(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Never on in a state that nobody knows: silence is what the autopilot understands."""

    def broken(_self: Gate, _now_s: float) -> list[bytes]:
        raise ArithmeticError("two and two is five")

    monkeypatch.setattr(Gate, "cycle", broken)
    assert process.run(whole()) == 70
    said = capfd.readouterr().err
    assert "the gate is broken and ends" in said
    assert "two and two is five" in said


def test_precedence_is_taken_where_it_is_given(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Protects the start on computers that give real time, a nice value, or neither."""
    asked: list[tuple[int, int]] = []

    def refused(*_: object) -> None:
        raise PermissionError

    monkeypatch.setattr(
        os, "sched_setscheduler", lambda _pid, policy, parameter: asked.append((policy, parameter.sched_priority))
    )
    assert process.run(whole(realtime=True)) == 5
    assert "real time" in capfd.readouterr().err
    assert asked == [(os.SCHED_RR, 1)]
    monkeypatch.setattr(os, "sched_setscheduler", refused)
    nice: list[int] = []
    monkeypatch.setattr(os, "setpriority", lambda _which, _who, value: nice.append(value))
    assert precedence.take_precedence() == "nice -10"
    monkeypatch.setattr(os, "setpriority", refused)
    assert precedence.take_precedence().startswith("no precedence")


def test_what_cannot_be_started_or_opened_is_one_clear_line(tmp_path: Path) -> None:
    """Protects the person with a wrong path, or with a key that others can read."""
    with pytest.raises(CompanionError, match="the application cannot be started: /no/such program: "):
        process.run(replace(whole(), command=("/no/such", "program")))
    with pytest.raises(InputError, match=r"safety.signing.key_file .*key: "):
        process.run(whole(signing=Signing(str(tmp_path / "key"), 1)))
    key = tmp_path / "key"
    key.write_text("0123456789abcdef" * 4)
    key.chmod(0o644)
    with pytest.raises(InputError, match=r"chmod 600"):
        process.run(whole(signing=Signing(str(key), 1)))
    key.chmod(0o600)
    assert process.run(whole(signing=Signing(str(key), 1))) == 5


def plan_fd(text: str) -> str:
    fd = os.memfd_create("plan")
    os.write(fd, text.encode())
    return str(fd)


def test_the_module_reads_its_plan_and_runs() -> None:
    """Protects the way in which the application's command starts the gate."""
    assert main_module.main(("--plan-fd", plan_fd(whole().dumps()))) == 5


@pytest.mark.parametrize("arguments", [(), ("--plan-fd",), ("--plan", "3"), ("--plan-fd", "x")])
def test_started_by_hand_it_says_how(arguments: tuple[str, ...], capfd: pytest.CaptureFixture[str]) -> None:
    """Protects who starts the gate without a plan: they are told which command to use."""
    assert main_module.main(arguments) == 2
    assert "companion run" in capfd.readouterr().err


def test_as_a_program_it_ends_with_its_exit_code(monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects the exit code on its way to the shell."""
    monkeypatch.setattr(sys, "argv", ["safety", "--plan-fd"])
    with pytest.raises(SystemExit, match="2"):
        runpy.run_path(str(main_module.__file__), run_name="__main__")


def test_a_plan_that_is_none_is_refused(capfd: pytest.CaptureFixture[str]) -> None:
    """Protects against a gate that runs with half a plan."""
    assert main_module.main(("--plan-fd", plan_fd("{}"))) == 2
    assert main_module.main(("--plan-fd", "1000000")) == 2
    assert capfd.readouterr().err.count("the gate cannot read its plan: ") == 2
