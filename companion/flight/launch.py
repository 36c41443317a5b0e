"""From the command to the gate, whose child is the application."""

from __future__ import annotations

import dataclasses
import os
import sys
from pathlib import Path
from typing import NoReturn

from companion.flight.request import FlightRequest, sealed


def become_the_gate(request: FlightRequest) -> NoReturn:
    """Replace this process by the gate, which starts the application as its child.

    An application that dies in a flight is started again, and then waits for a person: at the terminal, or without one
    at a ground station. A check that dies is not made again.

    Raises:
        CompanionError: the gate cannot work with these settings.
    """
    from companion.safety_case.gate_plan import to_plan

    by_person = request.started_by("key" if sys.stdin is not None and sys.stdin.isatty() else "command")
    first, again = request.sealed(), by_person.sealed()
    plan = to_plan(
        request.settings, command=application(first), restart_command=application(again), inherit=(first, again)
    )
    if request.what == "check":
        plan = dataclasses.replace(plan, restarts=0)
    gate = [*module("companion.gate"), "--plan-fd", str(sealed("companion-plan", plan.dumps()))]
    sys.stdout.flush()
    sys.stderr.flush()
    # The same process with another program: whoever watches the command, a person or systemd, watches the gate.
    os.execv(gate[0], gate)  # noqa: S606 - our own command, without a shell


def application(request_fd: int, name: str = "companion.flight") -> tuple[str, ...]:
    """The command line of the application for a sealed request."""
    return (*module(name), "--request-fd", str(request_fd))


def module(name: str) -> list[str]:
    """The command line of a module, run by this interpreter.

    `python -m` looks for modules in the current folder first, where anybody's file may lie: it does so only when this
    process did.
    """
    here = sys.path[:1] in ([""], [str(Path.cwd())])
    return [sys.executable, *([] if here else ["-P"]), "-m", name]
