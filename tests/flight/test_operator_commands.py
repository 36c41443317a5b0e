"""Who may start and stop a flight."""

from __future__ import annotations

import asyncio
import os
import signal
from pathlib import Path

import pytest

from companion.errors import InputError
from companion.flight.operator_commands import OperatorCommands, UnfinishedError, Wish
from companion.flight.phase import FlightPhase, PhaseMachine
from companion.link.words import Command


def in_phase(phase: FlightPhase) -> PhaseMachine:
    machine = PhaseMachine()
    machine.phase = phase
    return machine


CHECKING, WAITING, TAKING_OFF, EXPLORING, HOMING, LEAVING, ENDED = FlightPhase


@pytest.mark.parametrize("command", list(Command))
@pytest.mark.parametrize("phase", list(FlightPhase))
def test_every_command_is_done_or_refused_with_a_reason_that_fits_a_display(
    command: Command, phase: FlightPhase
) -> None:
    """Protects whoever waits in front of a screen: silence is no answer."""
    for by_command in (True, False):
        answer = OperatorCommands(by_command, in_phase(phase)).ask(command)
        assert answer.accepted is not bool(answer.reason)
        assert len(f"{command.value} refused: {answer.reason}") <= 50


@pytest.mark.parametrize(
    ("command", "phases"),
    [
        (Command.START, {WAITING, TAKING_OFF, EXPLORING}),
        (Command.PAUSE, {TAKING_OFF, EXPLORING, HOMING}),
        (Command.CONTINUE, {EXPLORING, HOMING}),
        (Command.HOME, {EXPLORING, HOMING}),
        (Command.LAND, {TAKING_OFF, EXPLORING, HOMING}),
        (Command.STOP, {CHECKING, WAITING, TAKING_OFF, EXPLORING, HOMING, ENDED}),
    ],
)
def test_what_is_accepted_when_and_accepted_again(command: Command, phases: set[FlightPhase]) -> None:
    for phase in FlightPhase:
        operator = OperatorCommands(True, in_phase(phase))
        answers = {operator.ask(command).accepted for _ in range(2)}
        assert answers == {phase in phases}, phase


def test_a_stop_brakes_whatever_steers() -> None:
    """Protects the one button that must not fail: it is never a question of the phase while we steer."""
    for phase in (EXPLORING, HOMING):
        flight = in_phase(phase)
        operator = OperatorCommands(True, flight)
        assert operator.ask(Command.STOP).accepted
        assert flight.paused, "the next tick brakes"
        assert operator.wish is Wish.NOTHING, "a person decides how it goes on"
    operator = OperatorCommands(True, in_phase(TAKING_OFF))
    assert operator.ask(Command.STOP).accepted
    assert operator.stop.is_set(), "the climb ends"


def test_a_stop_on_the_ground_takes_the_start_back() -> None:
    operator = OperatorCommands(True, in_phase(WAITING))
    assert operator.ask(Command.START).accepted
    assert operator.ask(Command.STOP).accepted
    assert not operator.start.is_set()
    operator = OperatorCommands(True, in_phase(CHECKING))
    assert operator.ask(Command.STOP).accepted
    assert operator.stop.is_set(), "nothing takes off after it"


def test_what_the_autopilot_ends_it_is_told_to_stop_itself() -> None:
    operator = OperatorCommands(True, in_phase(LEAVING))
    answer = operator.ask(Command.STOP)
    assert not answer.accepted
    assert "autopilot" in answer.reason
    assert not operator.stop.is_set()


@pytest.mark.parametrize("command", list(Command))
def test_asked_twice_it_is_done_once(command: Command) -> None:
    for phase in FlightPhase:
        flight = in_phase(phase)
        operator = OperatorCommands(True, flight)
        first = operator.ask(command)
        state = (operator.wish, operator.start.is_set(), operator.stop.is_set(), flight.paused)
        assert operator.ask(command) == first
        assert (operator.wish, operator.start.is_set(), operator.stop.is_set(), flight.paused) == state


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
async def test_signals_ask_for_the_end_of_the_flight(number: signal.Signals) -> None:
    """Ctrl-C in flight must land the vehicle, not break off the program that flies it."""
    operator = OperatorCommands(by_command=False, flight=in_phase(FlightPhase.TAKING_OFF))
    before = signal.getsignal(number)
    with operator.signals():
        os.kill(os.getpid(), number)
        await asyncio.wait_for(operator.stop.wait(), 5.0)
        wishes = [operator.wish]
        os.kill(os.getpid(), number)
        await asyncio.sleep(0.01)
        wishes.append(operator.wish)
    assert wishes == [Wish.END, Wish.LAND], "who asks twice wants no way home"
    assert operator.interrupted
    assert not operator.start.is_set()
    assert signal.getsignal(number) is before, "whoever is about to say goodbye would die of the next one"


async def test_the_enter_key_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    reading, writing = os.pipe()
    operator = OperatorCommands(by_command=False, flight=PhaseMachine())
    with os.fdopen(reading) as terminal, os.fdopen(writing, "wb", buffering=0) as hand:
        monkeypatch.setattr("sys.stdin", terminal)
        with operator.enter_key():
            hand.write(b"\n")
            await asyncio.wait_for(operator.start.wait(), 5.0)


async def test_what_was_typed_before_starts_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """An Enter from the flight before must not let the application that was started again take off at once."""
    hand, terminal = os.openpty()
    operator = OperatorCommands(by_command=False, flight=PhaseMachine())
    with os.fdopen(terminal) as keyboard:
        monkeypatch.setattr("sys.stdin", keyboard)
        os.write(hand, b"\n\n")
        with operator.enter_key():
            await asyncio.sleep(0.1)
            assert not operator.start.is_set()
            os.write(hand, b"\n")
            await asyncio.wait_for(operator.start.wait(), 5.0)
    os.close(hand)


async def test_without_a_terminal_the_key_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Under a service manager nobody can press it: waiting for ever would look like a hang."""
    operator = OperatorCommands(by_command=False, flight=PhaseMachine())
    with Path(os.devnull).open() as nothing:  # noqa: ASYNC230 - nothing is read from it
        monkeypatch.setattr("sys.stdin", nothing)
        with pytest.raises(InputError, match="--start command"), operator.enter_key():
            pass


async def test_where_nothing_flies_a_signal_ends_the_program() -> None:
    """Connecting and loading take up to minutes: Ctrl-C must not seem to be ignored."""
    operator = OperatorCommands(by_command=False, flight=PhaseMachine())
    with operator.signals():
        os.kill(os.getpid(), signal.SIGINT)
        with pytest.raises(asyncio.CancelledError):
            await asyncio.sleep(5.0)
    assert operator.interrupted


async def test_who_interrupts_the_writing_of_the_map_is_told_to_wait_and_the_next_time_it_ends() -> None:
    """Protects the map from impatience, and the impatient from a disk that hangs: before, neither was heard."""
    operator = OperatorCommands(True, in_phase(FlightPhase.ENDED))
    written = asyncio.Event()
    told_s: list[str] = []

    async def write() -> str:
        await written.wait()
        return "map"

    async def interrupted(times: int) -> str:
        with operator.signals():
            writing = asyncio.create_task(operator.finish(write(), lambda: told_s.append("a moment")))
            for _ in range(times):
                await asyncio.sleep(0)
                os.kill(os.getpid(), signal.SIGINT)
                await asyncio.sleep(0.01)
            if times < 2:
                written.set()
            return await writing

    with pytest.raises(UnfinishedError, match="its journal is whole"):
        await interrupted(2)
    assert await interrupted(1) == "map"
    assert told_s == ["a moment"] * 2
    assert not operator.interrupted, "the flight had ended by itself"


async def test_what_goes_wrong_while_the_map_is_written_is_said() -> None:
    async def fails() -> None:
        raise OSError("full")

    with pytest.raises(OSError, match="full"):
        await OperatorCommands(True, in_phase(FlightPhase.ENDED)).finish(fails(), lambda: None)
