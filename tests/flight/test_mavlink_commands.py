"""What a ground station may order over MAVLink, and how it is answered."""

from __future__ import annotations

import math
from typing import Any

import pytest

from companion.autopilot.status_reporter import TEXT_PERIOD_S, StatusReporter
from companion.flight.events import EventEmitter, status_text
from companion.flight.mavlink_commands import TOLD_AGAIN_S, MavlinkCommands, Refusals
from companion.flight.operator_commands import OperatorCommands, Wish
from companion.flight.phase import FlightPhase, PhaseMachine
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
    clock = HandClock()
    link = FakeLink(clock)
    operator = OperatorCommands(by_command, in_phase(phase))
    MavlinkCommands(operator, link, Refusals(EventEmitter(), clock))
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
    clock = HandClock()
    link = FakeLink(clock)
    MavlinkCommands(OperatorCommands(by_command=True, flight=flight), link, Refusals(EventEmitter(), clock))
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
    clock = HandClock()
    link = FakeLink(clock)
    operator = OperatorCommands(by_command=True, flight=in_phase(EXPLORING))
    MavlinkCommands(operator, link, Refusals(EventEmitter(), clock))
    link.gone = True
    link.deliver("COMMAND_LONG", {**OURS, "command": MavCmd.NAV_LAND, "param1": 0.0}, system_id=255)
    assert operator.wish is Wish.LAND


# A refusal reaches the screen.


class Screen:
    """A ground station, and what its pilot reads."""

    def __init__(self, phase: FlightPhase, by_command: bool = True) -> None:
        self.clock = HandClock()
        self.link = FakeLink(self.clock)
        self.reporter = StatusReporter(self.link, self.clock)
        events = EventEmitter(status_text(self.reporter))
        operator = OperatorCommands(by_command, in_phase(phase))
        MavlinkCommands(operator, self.link, Refusals(events, self.clock))

    def asks(self, order: dict[str, Any], later_s: float = TEXT_PERIOD_S + TOLD_AGAIN_S) -> Screen:
        self.link.deliver("COMMAND_LONG", {**OURS, "param1": 0.0, **order}, system_id=255, component_id=190)
        self.reporter.tick()
        self.clock.advance(later_s)
        return self

    @property
    def shows(self) -> list[tuple[str, int]]:
        self.clock.advance(TEXT_PERIOD_S)
        self.reporter.tick()
        return [(text["text"], text["severity"]) for text in self.link.sent_named("STATUSTEXT")]


@pytest.mark.parametrize(
    ("order", "phase", "by_command", "words"),
    [
        ({"command": MavCmd.MISSION_START}, CHECKING, True, "start refused: it is still being checked"),
        ({"command": MavCmd.MISSION_START}, WAITING, False, "start refused: mission.start is not command"),
        ({"command": MavCmd.MISSION_START}, ENDED, True, "start refused: its flight is over"),
        (HOME, WAITING, True, "home refused: it stands and waits"),
        (HOME, TAKING_OFF, True, "home refused: it is taking off"),
        (LAND, LEAVING, True, "land refused: its autopilot lands or holds it"),
        (CONTINUE, WAITING, True, "continue refused: it stands and waits"),
        (PAUSE | {"param1": 2.0}, EXPLORING, True, "pause refused: parameter 1 is neither 0 nor 1"),
    ],
)
def test_what_is_refused_is_said_with_its_reason(
    order: dict[str, Any], phase: FlightPhase, by_command: bool, words: str
) -> None:
    assert Screen(phase, by_command).asks(order).shows == [(words, 4)]


def test_who_asks_again_is_answered_again_but_not_a_ground_station_that_repeats_itself() -> None:
    screen = Screen(WAITING).asks(HOME)
    assert len(screen.asks(HOME).shows) == 2, "a person who presses a button again waits for a word"
    for _ in range(100):
        screen.asks(HOME, later_s=0.001)
    screen.clock.advance(TEXT_PERIOD_S)
    assert len(screen.shows) == 3, "what comes a hundred times in a moment is said once"


def test_what_ground_stations_ask_of_every_component_is_not_said() -> None:
    """REQUEST_MESSAGE, and whatever else they find out by trying."""
    screen = Screen(WAITING).asks({"command": 512})
    assert screen.shows == []
    assert answers(screen.link) == [3]
