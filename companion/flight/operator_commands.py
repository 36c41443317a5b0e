"""What people ask of a flight: start, pause, come home, land; by key, by signal, or from a ground station."""

from __future__ import annotations

import asyncio
import contextlib
import enum
import functools
import signal
import sys
import termios
from collections.abc import Callable, Coroutine, Iterator
from typing import Any, TypeVar

from companion.autopilot.interface import Link, LinkError, Message
from companion.autopilot.vehicle_state import integer, number
from companion.errors import EXIT_INTERRUPTED, CompanionError, InputError
from companion.flight.phase import FlightPhase, PhaseMachine
from companion.link.words import Answer, Command
from companion.mavlink.ids import MavCmd, MavComponent, MavResult

LARGEST_COMMAND = 65535

ACCEPTED = Answer(accepted=True)

_COMMANDS: dict[int, Command] = {
    MavCmd.MISSION_START: Command.START,
    MavCmd.NAV_RETURN_TO_LAUNCH: Command.HOME,
    MavCmd.NAV_LAND: Command.LAND,
}

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
        by_command: whether a ground station may start the flight; it may always end it.
        flight: knows the phase. A start that comes before one is waited for is refused: nobody expects a take-off
            minutes later. A signal in the air waits until the vehicle is down.
    """

    def __init__(self, by_command: bool, flight: PhaseMachine) -> None:
        self.start = asyncio.Event()
        self.stop = asyncio.Event()
        """Ends a take-off."""
        self.wish = Wish.NOTHING
        self.interrupted = False
        """Whether the stop came as a signal: Ctrl-C, or the end of the service."""
        self._by_command = by_command
        self._flight = flight
        self._task: asyncio.Task[object] | None = None
        self._instead: Callable[[], None] | None = None

    def obey(self, command: Command) -> Answer:
        """Do what an operator asks, from wherever it comes; what became of it."""
        phase = self._flight.phase
        if command is Command.STOP:
            return self._brake()
        if command is Command.START:
            return self._begin()
        if command in (Command.PAUSE, Command.CONTINUE):
            if command is Command.PAUSE and phase is FlightPhase.TAKING_OFF:
                # There is nothing to go on with, and whoever pauses a climb wants it to stop.
                self._want(Wish.END)
                return ACCEPTED
            if self._flight.pause(command is Command.PAUSE):
                return ACCEPTED
            return _not_now(phase, "pauses only while it explores or comes home")
        lands = command is Command.LAND
        if not phase.steered and not (lands and phase is FlightPhase.TAKING_OFF):
            return _not_now(phase, "lands only in the air" if lands else "comes home only once it explores")
        self._want(Wish.LAND if lands else Wish.HOME)
        return ACCEPTED

    def _begin(self) -> Answer:
        if not self._by_command:
            return Answer(accepted=False, reason="mission.start is not command: the flight is started at the vehicle")
        phase = self._flight.phase
        if phase < FlightPhase.WAITING:
            return _not_now(phase, "wait until it is ready")
        if phase > FlightPhase.WAITING:
            # It was done: who asks again has not heard of it yet.
            return ACCEPTED if phase.steered or phase is FlightPhase.TAKING_OFF else _not_now(phase, "it has flown")
        self.start.set()
        return ACCEPTED

    def _brake(self) -> Answer:
        phase = self._flight.phase
        if phase.steered:
            self._flight.pause(True)
        elif phase in (FlightPhase.CHECKING, FlightPhase.TAKING_OFF):
            self._want(Wish.END)
        elif phase is FlightPhase.LEAVING:
            return _not_now(phase, "the autopilot holds or lands it already: stop it there, from its ground station")
        # On the ground whoever stops takes a start back that has not been obeyed yet.
        self.start.clear()
        return ACCEPTED

    def listen(self, link: Link) -> None:
        """Obey a ground station's commands to this component."""
        for name in ("COMMAND_LONG", "COMMAND_INT"):
            link.events(name, functools.partial(self._on_command, link), anyone=True)

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

    def _on_command(self, link: Link, message: Message) -> None:
        command = integer(message, "command")
        ours = (integer(message, "target_system"), integer(message, "target_component"))
        if (
            ours != (link.system_id, MavComponent.ONBOARD_COMPUTER)
            or command is None
            or not 0 <= command <= LARGEST_COMMAND
        ):
            return
        result = self._obey(command, number(message, "param1"))
        answer: dict[str, Any] = {
            "command": command,
            "result": result,
            "progress": 0,
            "result_param2": 0,
            "target_system": message.system_id,
            "target_component": message.component_id,
        }
        # A ground station that is gone when the answer leaves has its order all the same.
        with contextlib.suppress(LinkError):
            link.send("COMMAND_ACK", answer)

    def _obey(self, command: int, parameter: float) -> int:
        if command == MavCmd.DO_PAUSE_CONTINUE and parameter not in (0.0, 1.0):
            return MavResult.DENIED
        if command == MavCmd.DO_PAUSE_CONTINUE:
            asked = Command.PAUSE if parameter == 0.0 else Command.CONTINUE
        elif command in _COMMANDS:
            asked = _COMMANDS[command]
        else:
            return MavResult.UNSUPPORTED
        if self.obey(asked).accepted:
            return MavResult.ACCEPTED
        never = asked is Command.START and not self._by_command
        return MavResult.DENIED if never else MavResult.TEMPORARILY_REJECTED


def _not_now(phase: FlightPhase, why: str) -> Answer:
    return Answer(accepted=False, reason=f"not while {phase.in_words}: {why}")
