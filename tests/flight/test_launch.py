"""Before a flight: what one process hands to the next, and that nothing is left to compile."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from companion.config.load import load_settings
from companion.errors import InputError
from companion.flight.request import FlightRequest, Start, application, become_the_gate, module, sealed, unsealed
from companion.gate.plan import Plan


def test_what_was_handed_over_cannot_be_changed_by_anybody() -> None:
    """Protects a flight from a change of its configuration under it, and a restart from meaning something else."""
    number = sealed("test", "one")
    try:
        for change in (
            lambda: os.write(number, b"two"),
            lambda: os.ftruncate(number, 1),
            lambda: os.ftruncate(number, 9),
        ):
            with pytest.raises(PermissionError):
                change()
        assert unsealed(number) == "one"
        assert unsealed(number) == "one", "a restarted application reads it again"
    finally:
        os.close(number)


def test_it_is_inherited() -> None:
    number = sealed("test", "vehicle: ä")
    code = f"from companion.flight.request import unsealed; assert unsealed({number}) == 'vehicle: ä'"
    try:
        for _ in range(2):
            subprocess.run([sys.executable, "-c", code], pass_fds=(number,), check=True)
        assert os.get_inheritable(number)
    finally:
        os.close(number)


def test_only_what_is_sealed_is_read(tmp_path: Path) -> None:
    with (tmp_path / "settings.json").open("w+") as file:
        file.write("{}")
        file.flush()
        for number in (file.fileno(), 99999, -1, 2**40):
            with pytest.raises(InputError, match="companion run"):
                unsealed(number)


class _Executed(Exception):  # noqa: N818  what happened is no fault
    """This process would be another program now."""


@pytest.fixture
def executed(monkeypatch: pytest.MonkeyPatch) -> list[list[str]]:
    """The command lines that would have replaced this process."""
    found: list[list[str]] = []

    def execv(file: str, arguments: list[str]) -> None:
        assert file == arguments[0]
        found.append(arguments)
        raise _Executed

    monkeypatch.setattr(os, "execv", execv)
    return found


def plan_of(arguments: list[str]) -> Plan:
    """What the gate would be told."""
    assert arguments[-3:-1] == ["companion.gate", "--plan-fd"]
    return Plan.loads(unsealed(int(arguments[-1])))


def requests_in(plan: Plan) -> list[FlightRequest]:
    """What the application would be asked at first, and when it has died; each in the descriptor that it inherits."""
    assert plan.command == application(plan.inherit[0])
    assert plan.restart_command == application(plan.inherit[1])
    return [FlightRequest.unsealed(number) for number in plan.inherit]


@pytest.mark.parametrize(("terminal", "by"), [(True, "key"), (False, "command")])
def test_the_gate_gets_its_plan_and_the_application_its_request(
    terminal: bool, by: Start, executed: list[list[str]], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """After a death nothing flies by itself: whoever walks to a vehicle that has just landed has not asked for it."""
    monkeypatch.setattr("sys.stdin", SimpleNamespace(isatty=lambda: terminal))
    settings = load_settings(preset="table_ii")
    request = FlightRequest("run", settings, "table_ii", 3, True, ("depth", "-odd"), tmp_path).started_by("now")
    with pytest.raises(_Executed):
        become_the_gate(request)
    (arguments,) = executed
    plan = plan_of(arguments)
    assert plan.autopilot_url == settings.autopilot.url
    assert requests_in(plan) == [request, request.started_by(by)]
    assert plan.restarts > 0
    json.loads(plan.dumps())


def test_a_check_that_dies_is_not_made_again(executed: list[list[str]]) -> None:
    with pytest.raises(_Executed):
        become_the_gate(FlightRequest("check", load_settings(), "flight"))
    assert plan_of(executed[0]).restarts == 0


@pytest.mark.parametrize(("first", "safe"), [("", False), ("/elsewhere/bin", True), (None, False)])
def test_a_module_is_not_looked_for_where_this_process_did_not_look(
    first: str | None, safe: bool, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Started in a folder with anybody's `json.py` in it, the gate must not import that."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [str(tmp_path) if first is None else first, *sys.path])
    assert ("-P" in module("companion.gate")) is safe
    (tmp_path / "json.py").write_text("raise SystemExit(77)")
    ended = subprocess.run([*module("json.tool"), "--help"], capture_output=True, check=False)
    assert (ended.returncode == 0) is safe


# Nothing may compile in flight: it would be seconds without a setpoint.


# In a process of its own: what other tests have compiled before would hide what the warm-up leaves out.
SCRIPT = """
import importlib, pkgutil
from numba.core.dispatcher import Dispatcher
import companion.control, companion.perception
from companion.config.load import load_settings
from companion.flight.warm_up import warm_up

warm_up(load_settings(None, "flight"))
for room in (companion.control, companion.perception):
    for found in pkgutil.iter_modules(room.__path__, room.__name__ + "."):
        if not found.ispkg:
            module = importlib.import_module(found.name)
            for name, value in vars(module).items():
                if isinstance(value, Dispatcher) and value.__module__ == found.name and not value.signatures:
                    print(found.name, name)
"""


@pytest.mark.timeout(300)
def test_the_warm_up_leaves_nothing_of_the_tick_to_compile() -> None:
    done = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True, timeout=280)
    assert set(done.stdout.splitlines()) <= {
        # Compiled as parts of others, never called from Python.
        "companion.control.dogleg _end",
        "companion.control.dogleg _has_room",
        "companion.control.dogleg _is_free",
        "companion.control.ground_grid doubt",
        "companion.control.ground_grid enter",
        "companion.control.ground_grid is_frontier",
        "companion.control.ground_grid level_at",
        "companion.control.ground_grid step_to",
        "companion.control.informed _cost",
        "companion.control.informed _may_go",
        "companion.perception.depth _farthest",
        "companion.perception.ground _go_on_as_beside",
        "companion.perception.ground _line_was_seen",
        "companion.perception.scan_memory _cell",
        "companion.perception.scan_memory _is_seen_through",
        "companion.perception.scan_memory _looked_range",
        # Larger images only: these settings' camera has none to reduce.
        "companion.perception.view _pool_nearest",
    }
