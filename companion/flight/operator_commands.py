"""What people ask of a flight: start, pause, come home, land, stop; by key, by signal, or by command."""

from __future__ import annotations

import asyncio
import contextlib
import enum
import signal
import sys
import termios
from collections.abc import Callable, Coroutine, Iterator
from typing import Any, TypeVar

from companion.errors import EXIT_INTERRUPTED, CompanionError, InputError
from companion.flight.phase import FlightPhase, PhaseMachine
from companion.link.words import Answer, Command

NOT_BY_COMMAND = "mission.start is not command"

_DOES = {
    FlightPhase.CHECKING: "it is still being checked",
    FlightPhase.WAITING: "it stands and waits",
    FlightPhase.TAKING_OFF: "it is taking off",
    FlightPhase.EXPLORING: "it is exploring",
    FlightPhase.HOMING: "it is on its way home",
    FlightPhase.LEAVING: "its autopilot lands or holds it",
    FlightPhase.ENDED: "its flight is over",
}
"""Why not, in words that fit a pilot's display."""

T = TypeVar("T")


class InterruptedFlightError(CompanionError):
    """Ctrl-C, or the end of the service, before the vehicle explored."""

    exit_code = EXIT_INTERRUPTED


class UnfinishedError(CompanionError):
    """The writing of the map was broken off by whoever did not want to wait."""


class Wish(enum.IntEnum):
    """How a person wants the flight to go on; the larger one counts, and none is taken back."""

    NOTHING = 0
    END = 1
    """The exploring shall end, as ``mission.end_action`` says."""
    HOME = 2
    LAND = 3
    """Where it is."""


class OperatorCommands:
    """What people ask for, from wherever it comes.

    Args:
        by_command: whether a command may start the flight; it may always end it.
        flight: knows the phase. A start that comes before one is waited for is refused: nobody expects a take-off
            minutes later. A signal in the air waits until the vehicle is down.
    """

    def __init__(self, by_command: bool, flight: PhaseMachine) -> None:
        self.start = asyncio.Event()
        self.stop = asyncio.Event()
        """Ends a take-off."""
        self.wish = Wish.NOTHING
        self.in_air = False
        """Whether the start is that of a vehicle which flies already, and is handed over."""
        self.interrupted = False
        """Whether the stop came as a signal: Ctrl-C, or the end of the service."""
        self._by_command = by_command
        self._flight = flight
        self._task: asyncio.Task[object] | None = None
        self._instead: Callable[[], None] | None = None

    @property
    def by_command(self) -> bool:
        """Whether a command may start the flight."""
        return self._by_command

    def ask(self, command: Command) -> Answer:
        """Do what an operator asks for, or say why not. What is done already is accepted again."""
        phase = self._flight.phase
        if command is Command.START:
            return self._start(phase)
        if command in (Command.PAUSE, Command.CONTINUE):
            return self._pause(command is Command.PAUSE, phase)
        if command is Command.STOP:
            return self._brake(phase)
        least = FlightPhase.EXPLORING if command is Command.HOME else FlightPhase.TAKING_OFF
        if not least <= phase < FlightPhase.LEAVING:
            return Answer(False, _DOES[phase])
        self._want(Wish.HOME if command is Command.HOME else Wish.LAND)
        return Answer(True)

    @contextlib.contextmanager
    def signals(self) -> Iterator[None]:
        """SIGINT and SIGTERM ask for the end of a flight; where nothing flies they cancel the task that calls this."""
        loop = asyncio.get_running_loop()
        self._task = asyncio.current_task()
        before = {one: signal.getsignal(one) for one in (signal.SIGINT, signal.SIGTERM)}
        for one in before:
            loop.add_signal_handler(one, self._on_signal)
        try:
            yield
        finally:
            for one, handler in before.items():
                # The loop would leave the default behind, by which SIGTERM kills whoever is about to say goodbye.
                loop.remove_signal_handler(one)
                signal.signal(one, handler)

    @contextlib.contextmanager
    def enter_key(self) -> Iterator[None]:
        """The Enter key starts.

        Raises:
            InputError: there is no terminal, and nothing that stands for one.
        """
        loop = asyncio.get_running_loop()

        def on_input() -> None:
            if not sys.stdin.readline():
                # The end of the input, as under a service manager: nobody will ever press a key.
                loop.remove_reader(sys.stdin)
                return
            self.start.set()

        try:
            if sys.stdin.isatty():
                # What was typed before nobody meant as an answer, least of all after a restart.
                termios.tcflush(sys.stdin, termios.TCIFLUSH)
            loop.add_reader(sys.stdin, on_input)
        except (AttributeError, OSError, ValueError, termios.error):  # no input at all, as under a service manager
            raise InputError(
                "mission.start = key, but there is no terminal: use --start command (a ground station starts the "
                "flight) or --start now"
            ) from None
        try:
            yield
        finally:
            loop.remove_reader(sys.stdin)

    async def finish(self, work: Coroutine[Any, Any, T], on_asked: Callable[[], object]) -> T:
        """Write the map, which is what a flight was for: the first signal is told to wait, the next one breaks it off.

        Args:
            work: writes it.
            on_asked: tells whoever sent the first signal.

        Raises:
            UnfinishedError: it was broken off.
        """
        task = asyncio.ensure_future(work)
        asked = False

        def on_signal() -> None:
            nonlocal asked
            if asked:
                task.cancel()
            else:
                asked = True
                on_asked()

        self._instead = on_signal
        try:
            await asyncio.wait([task])
        finally:
            self._instead = None
            task.cancel()
        if task.cancelled():
            raise UnfinishedError("broken off by Ctrl-C; its journal is whole")
        return task.result()

    def _on_signal(self) -> None:
        if self._instead is not None:
            self._instead()
            return
        # Who comes home is told once more: then it lands where it is.
        self._want(Wish.LAND if self.interrupted else Wish.END)
        self.interrupted = True
        if not self._flight.phase.airborne and self._task is not None:
            self._task.cancel()

    def _want(self, wish: Wish) -> None:
        self.wish = max(self.wish, wish)
        self.stop.set()

    def _start(self, phase: FlightPhase) -> Answer:
        if not self._by_command:
            return Answer(False, NOT_BY_COMMAND)
        if not FlightPhase.WAITING <= phase <= FlightPhase.EXPLORING:
            return Answer(False, _DOES[phase])
        self.start.set()
        return Answer(True)

    def _brake(self, phase: FlightPhase) -> Answer:
        """Stand with the next tick; what is not in the air yet stays on the ground."""
        if phase is FlightPhase.LEAVING:
            return Answer(False, _DOES[phase])
        if phase.steered:
            self._flight.pause(True)
        elif phase in (FlightPhase.CHECKING, FlightPhase.TAKING_OFF):
            self._want(Wish.END)
        # A start that has not been obeyed yet is taken back.
        self.start.clear()
        return Answer(True)

    def _pause(self, paused: bool, phase: FlightPhase) -> Answer:
        if paused and phase is FlightPhase.TAKING_OFF:
            # There is nothing to go on with, and whoever pauses a climb wants it to stop.
            self._want(Wish.END)
            return Answer(True)
        return Answer(True) if self._flight.pause(paused) else Answer(False, _DOES[phase])
