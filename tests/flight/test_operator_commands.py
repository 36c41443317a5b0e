"""Who may start and stop a flight."""

from __future__ import annotations

import asyncio
import math
import os
import signal
from pathlib import Path
from typing import Any

import pytest

from companion.errors import InputError
from companion.flight.operator_commands import OperatorCommands, UnfinishedError, Wish
from companion.flight.phase import FlightPhase, PhaseMachine
from companion.link.words import Answer, Command
from companion.mavlink.ids import MavCmd
from tests.autopilot.fake_link import FakeLink
from tests.shared.clocks import HandClock

OURS = {"target_system": 1, "target_component": 191}


def in_phase(phase: FlightPhase) -> PhaseMachine:
    machine = PhaseMachine()
    machine.phase = phase
    return machine


def told(
    *commands: dict[str, Any], by_command: bool = True, phase: FlightPhase = FlightPhase.WAITING
) -> tuple[OperatorCommands, FakeLink]:
    """The operator's commands after a ground station (255, 190) has sent these."""
    link = FakeLink(HandClock())
    operator = OperatorCommands(by_command, in_phase(phase))
    operator.listen(link)
    for fields in commands:
        link.deliver("COMMAND_LONG", {**OURS, "param1": 0.0, **fields}, system_id=255, component_id=190)
    return operator, link


def answers(link: FakeLink) -> list[int]:
    return [fields["result"] for fields in link.sent_named("COMMAND_ACK")]


def test_a_ground_station_starts() -> None:
    operator, link = told({"command": MavCmd.MISSION_START})
    assert operator.start.is_set()
    assert answers(link) == [0]
    (answer,) = link.sent_named("COMMAND_ACK")
    assert (answer["target_system"], answer["target_component"]) == (255, 190)


def test_a_start_counts_only_where_it_was_configured() -> None:
    """With `start: key` somebody stands beside the vehicle: nobody else may start it."""
    operator, link = told({"command": MavCmd.MISSION_START}, by_command=False)
    assert not operator.start.is_set()
    assert answers(link) == [2]


CHECKING, WAITING, TAKING_OFF, EXPLORING, HOMING, LEAVING, ENDED = FlightPhase
HOME, LAND = {"command": MavCmd.NAV_RETURN_TO_LAUNCH}, {"command": MavCmd.NAV_LAND}
PAUSE = {"command": MavCmd.DO_PAUSE_CONTINUE}
CONTINUE = {"command": MavCmd.DO_PAUSE_CONTINUE, "param1": 1.0}
ACCEPTED, NOT_NOW = 0, 1


@pytest.mark.parametrize("by_command", [True, False])
@pytest.mark.parametrize(
    ("order", "accepted"),
    [
        (HOME, {EXPLORING: Wish.HOME, HOMING: Wish.HOME}),
        (LAND, {TAKING_OFF: Wish.LAND, EXPLORING: Wish.LAND, HOMING: Wish.LAND}),
        (PAUSE, {TAKING_OFF: Wish.END, EXPLORING: Wish.NOTHING, HOMING: Wish.NOTHING}),
        (CONTINUE, {EXPLORING: Wish.NOTHING, HOMING: Wish.NOTHING}),
    ],
)
def test_what_a_ground_station_may_order_when(
    order: dict[str, Any], accepted: dict[FlightPhase, Wish], by_command: bool
) -> None:
    """Protects the meaning of the answer: what cannot be done now is not accepted, and changes nothing later."""
    for phase in FlightPhase:
        operator, link = told(order, by_command=by_command, phase=phase)
        assert answers(link) == [ACCEPTED if phase in accepted else NOT_NOW], phase
        assert operator.wish is accepted.get(phase, Wish.NOTHING), phase
        assert operator.stop.is_set() is (operator.wish is not Wish.NOTHING)


def test_a_pause_ends_with_continue() -> None:
    flight = in_phase(EXPLORING)
    link = FakeLink(HandClock())
    OperatorCommands(by_command=True, flight=flight).listen(link)
    paused = []
    for order in (CONTINUE, PAUSE, PAUSE, CONTINUE):
        link.deliver("COMMAND_LONG", {**OURS, "param1": 0.0, **order}, system_id=255)
        paused.append(flight.paused)
    assert paused == [False, True, True, False]
    assert answers(link) == [ACCEPTED] * 4


def test_of_several_orders_the_nearer_landing_counts() -> None:
    """Protects from an order that a later one takes back: who is landed by a person is not sent home by Ctrl-C."""
    assert told(HOME, LAND, phase=EXPLORING)[0].wish is Wish.LAND
    assert told(LAND, HOME, phase=EXPLORING)[0].wish is Wish.LAND


def test_a_start_before_its_time_is_refused() -> None:
    """Kept until the map has been loaded, it would let the vehicle take off when nobody expects it any more."""
    operator, link = told({"command": MavCmd.MISSION_START}, phase=FlightPhase.CHECKING)
    assert not operator.start.is_set()
    assert answers(link) == [1]


@pytest.mark.parametrize("elsewhere", [{"target_system": 2}, {"target_component": 1}, {"target_component": None}])
def test_commands_to_others_are_not_ours(elsewhere: dict[str, Any]) -> None:
    operator, link = told({"command": MavCmd.MISSION_START, **elsewhere})
    assert not operator.start.is_set()
    assert answers(link) == []


@pytest.mark.parametrize("parameter", [0.5, -1.0, math.nan, None, "0"])
def test_a_pause_that_is_neither_on_nor_off_is_denied(parameter: object) -> None:
    operator, link = told({"command": MavCmd.DO_PAUSE_CONTINUE, "param1": parameter}, phase=EXPLORING)
    assert not operator.stop.is_set()
    assert answers(link) == [2]


def test_other_commands_are_answered_as_unsupported() -> None:
    _, link = told({"command": 400}, {"command": None})
    assert answers(link) == [3], "what has no number cannot be answered"


def test_a_ground_station_that_is_gone_has_its_order_all_the_same() -> None:
    link = FakeLink(HandClock())
    operator = OperatorCommands(by_command=True, flight=in_phase(EXPLORING))
    operator.listen(link)
    link.gone = True
    link.deliver("COMMAND_LONG", {**OURS, "command": MavCmd.NAV_LAND, "param1": 0.0}, system_id=255)
    assert operator.wish is Wish.LAND


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


def obeyed(
    command: Command, phase: FlightPhase, by_command: bool = True
) -> tuple[Answer, OperatorCommands, PhaseMachine]:
    """What becomes of a command in a phase."""
    flight = in_phase(phase)
    operator = OperatorCommands(by_command, flight)
    return operator.obey(command), operator, flight


def test_a_stop_brakes_whatever_steers() -> None:
    """Protects the one button that must not fail: it is never a question of the phase while we steer."""
    for phase in (EXPLORING, HOMING):
        answer, operator, flight = obeyed(Command.STOP, phase)
        assert answer.accepted
        assert flight.paused, "the next tick brakes"
        assert operator.wish is Wish.NOTHING, "a person decides how it goes on"
    answer, operator, _ = obeyed(Command.STOP, TAKING_OFF)
    assert answer.accepted
    assert operator.stop.is_set(), "the climb ends"


def test_a_stop_on_the_ground_takes_the_start_back() -> None:
    answer, operator, _ = obeyed(Command.START, WAITING)
    assert answer.accepted
    assert operator.obey(Command.STOP).accepted
    assert not operator.start.is_set()
    answer, operator, _ = obeyed(Command.STOP, CHECKING)
    assert answer.accepted
    assert operator.stop.is_set(), "nothing takes off after it"


def test_what_the_autopilot_ends_it_is_told_to_stop_itself() -> None:
    answer, operator, _ = obeyed(Command.STOP, LEAVING)
    assert not answer.accepted
    assert "autopilot" in answer.reason
    assert not operator.stop.is_set()


@pytest.mark.parametrize("command", list(Command))
def test_each_refusal_says_why(command: Command) -> None:
    for phase in FlightPhase:
        answer, _, _ = obeyed(command, phase, by_command=False)
        assert bool(answer.reason) is not answer.accepted


@pytest.mark.parametrize("command", list(Command))
def test_asked_twice_it_is_done_once(command: Command) -> None:
    for phase in FlightPhase:
        first, operator, flight = obeyed(command, phase)
        state = (operator.wish, operator.start.is_set(), operator.stop.is_set(), flight.paused)
        assert operator.obey(command) == first
        assert (operator.wish, operator.start.is_set(), operator.stop.is_set(), flight.paused) == state
