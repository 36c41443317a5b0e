"""From the command to the gate, and from the gate to the application: what is handed over cannot change any more.

Settings and plan go into sealed memory that the next process inherits, not into a file: a configuration file that is
edited while the vehicle flies changes nothing, also when the application has to be started again.
"""

from __future__ import annotations

import dataclasses
import fcntl
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

from companion.config.settings import Settings
from companion.errors import InputError

_SEALS = fcntl.F_SEAL_WRITE | fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW | fcntl.F_SEAL_SEAL


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


def become_the_gate(settings: Settings, words: Sequence[str], restart_words: Sequence[str] | None) -> NoReturn:
    """Replace this process by the gate, which starts the application as its child.

    Args:
        settings: the whole configuration, which the application gets as it is here.
        words: of the application's command line, after the settings.
        restart_words: the same when it has died and is started again; None: it is not started again.

    Raises:
        CompanionError: the gate cannot work with these settings.
    """
    from companion.safety_case.gate_plan import to_plan

    handed = sealed("companion-settings", settings.model_dump_json())
    application = (*module("companion.flight"), "--settings-fd", str(handed))
    plan = to_plan(
        settings,
        command=(*application, *words),
        restart_command=(*application, *(words if restart_words is None else restart_words)),
        inherit=(handed,),
    )
    if restart_words is None:
        plan = dataclasses.replace(plan, restarts=0)
    gate = [*module("companion.gate"), "--plan-fd", str(sealed("companion-plan", plan.dumps()))]
    sys.stdout.flush()
    sys.stderr.flush()
    # The same process with another program: whoever watches the command, a person or systemd, watches the gate.
    os.execv(gate[0], gate)  # noqa: S606 - our own command, without a shell


def module(name: str) -> list[str]:
    """The command line of a module, run by this interpreter.

    `python -m` looks for modules in the current folder first, where anybody's file may lie: it does so only when this
    process did.
    """
    here = sys.path[:1] in ([""], [str(Path.cwd())])
    return [sys.executable, *([] if here else ["-P"]), "-m", name]
