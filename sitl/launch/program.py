"""One program of a flight: how it is started, when it serves, and how it ends."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from companion.errors import CompanionError
from companion.gate.runtime.processes import end_with_parent

END_TIMEOUT_S = 10.0
SAID = 500
"""Characters of what it said, for who reads why it did not start."""


class CrewError(CompanionError):
    """A process of the flight did not start, or ended too soon."""


@dataclass(frozen=True, slots=True)
class Ports:
    """UDP ports of this computer to which an autopilot sends."""

    application: int
    ground: int
    world: int


@dataclass(frozen=True, slots=True)
class Program:
    """What is to be started.

    Attributes:
        name: of its log.
        arguments: the command line.
        serves: what it says when it serves; one that dies says something too.
        environment: variables besides those that there are.
        folder: where it runs; None: here.
    """

    name: str
    arguments: Sequence[str]
    serves: str
    environment: Mapping[str, str] = field(default_factory=dict)
    folder: Path | None = None


def tied() -> Callable[[], None]:
    """For ``preexec_fn``: a process that is told to end when this one has ended, however that ended.

    To be started from a thread that lives as long as this process: for the kernel that thread is the parent.
    """
    parent = os.getpid()

    def tie() -> None:
        end_with_parent(signal.SIGTERM)
        if os.getppid() != parent:
            # It ended before the kernel was told.
            os.kill(os.getpid(), signal.SIGKILL)

    return tie


class Running:
    """A program that has been started.

    Args:
        program: which.
        folder: for its log.
        niceness: how far others go first.
    """

    def __init__(self, program: Program, folder: Path, niceness: int = 0) -> None:
        self.program = program
        self.log = folder / f"{program.name}.log"
        self._niceness = niceness
        self.log.write_bytes(b"")
        self.process = self._started()

    def restart(self) -> None:
        """Kill it, and start it again at once."""
        self.process.kill()
        self.process.wait()
        self.process = self._started()

    def _started(self) -> subprocess.Popen[bytes]:
        program = self.program
        before = ("nice", "-n", str(self._niceness)) if self._niceness else ()
        with self.log.open("ab") as log:
            return subprocess.Popen(  # noqa: S603 - our own command, or the autopilot that the user has named
                [*before, *program.arguments],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env={**os.environ, "PYTHONUNBUFFERED": "1", **program.environment},
                cwd=program.folder,
                # Ctrl-C is for the application, which ends the flight; the others end after it.
                start_new_session=True,
                preexec_fn=tied(),
            )

    def wait(self, timeout_s: float) -> None:
        """Until it says that it serves.

        Raises:
            CrewError: it ended, or did not say it in time.
        """
        give_up_s = time.monotonic() + timeout_s
        while self.program.serves not in self.said():
            self.check("did not start")
            if time.monotonic() > give_up_s:
                raise CrewError(f"the process {self.program.name} was not ready in {timeout_s:g} s: {self.words()}")
            time.sleep(0.05)

    def check(self, what: str = "ended too soon") -> None:
        """Raise when it does not run any more."""
        if self.process.poll() is not None:
            raise CrewError(f"the process {self.program.name} {what}; its words: {self.words()}")

    def words(self) -> str:
        """The last that it said."""
        return self.said().strip()[-SAID:] or "none"

    def ask_to_end(self) -> None:
        """In good order, so that it writes what it knows; `end` waits for it."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
            # One that was stopped hears nothing else.
            self.process.send_signal(signal.SIGCONT)

    def end(self) -> None:
        """In good order, or killed."""
        self.ask_to_end()
        try:
            self.process.wait(END_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()

    def said(self) -> str:
        """Its log."""
        return self.log.read_text(encoding="utf-8", errors="replace")
