"""The request to the application, the sealed memory in which it is handed over, and the gate that starts it.

Not a file: a configuration that is edited while the vehicle flies changes nothing, also when the application has to be
started again.
"""

from __future__ import annotations

import fcntl
import os
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, NoReturn

from pydantic import TypeAdapter, ValidationError

from companion.config.settings import Settings
from companion.errors import InputError

_SEALS = fcntl.F_SEAL_WRITE | fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW | fcntl.F_SEAL_SEAL
Start = Literal["now", "key", "command"]


@dataclass(frozen=True, slots=True)
class FlightRequest:
    """One flight, or one pre-flight check, as a person has asked for it.

    Attributes:
        what: to fly, or only to check.
        settings: the whole configuration.
        preset: the name of the one below it, for the records.
        seed: draws every choice of the navigator; None draws a new one, which is recorded.
        fix: whether pre-flight may set parameters of the autopilot.
        skip: names of checks to skip, besides those in the settings.
        resume_map: the folder of an earlier flight whose map and known ground go on, from the same start of the
            autopilot; both stay in that folder.
    """

    what: Literal["run", "check"]
    settings: Settings
    preset: str
    seed: int | None = None
    fix: bool = False
    skip: tuple[str, ...] = ()
    resume_map: Path | None = None

    def started_by(self, start: Start) -> FlightRequest:
        """The same with another ``mission.start``."""
        mission = self.settings.mission.model_copy(update={"start": start})
        return replace(self, settings=self.settings.model_copy(update={"mission": mission}))

    def sealed(self) -> int:
        """A file descriptor for the application, from which `unsealed` reads this request."""
        return sealed("companion-request", _REQUEST.dump_json(self).decode())

    @classmethod
    def unsealed(cls, number: int) -> FlightRequest:
        """The request that was handed over.

        Raises:
            InputError: this file descriptor holds none.
        """
        try:
            return _REQUEST.validate_json(unsealed(number), strict=True)
        except ValidationError as error:
            raise InputError(f"what was handed over in file descriptor {number} is no request: {error}") from None


_REQUEST = TypeAdapter(FlightRequest)


def sealed(name: str, text: str) -> int:
    """A file descriptor, inherited by the processes that follow, from which this text can be read and nothing else."""
    # Without MFD_CLOEXEC: that it is inherited is what it is for.
    number = os.memfd_create(name, os.MFD_ALLOW_SEALING)
    with os.fdopen(number, "wb", closefd=False) as file:
        file.write(text.encode())
    fcntl.fcntl(number, fcntl.F_ADD_SEALS, _SEALS)
    return number


def unsealed(number: int) -> str:
    """What was handed over. It can be read again by whoever is started next: nothing is used up.

    Raises:
        InputError: this file descriptor holds nothing that was handed over.
    """
    try:
        if fcntl.fcntl(number, fcntl.F_GET_SEALS) & _SEALS != _SEALS:
            raise OSError("it is not sealed")
        return os.pread(number, os.fstat(number).st_size, 0).decode()
    except (OSError, OverflowError, ValueError) as error:
        raise InputError(
            f"nothing was handed over in file descriptor {number} ({error}): start with `companion run`"
        ) from None


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
        plan = replace(plan, restarts=0)
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
