"""What the transmitter's switch does to a flight: it starts nothing that nobody saw being switched."""

from __future__ import annotations

from typing import Literal

import pytest

from companion.autopilot.rc_switch import Move, Position
from companion.config.mission import RcSwitchSettings
from companion.flight.events import Event, EventEmitter
from companion.flight.mavlink_commands import Refusals
from companion.flight.operator_commands import OperatorCommands, Wish
from companion.flight.phase import FlightPhase, PhaseMachine
from companion.flight.switch_commands import SwitchCommands
from tests.shared.clocks import HandClock

CHECKING, WAITING, TAKING_OFF, EXPLORING, HOMING, LEAVING, ENDED = FlightPhase
LOW, MIDDLE, HIGH = Position
TO_HIGH, TO_MIDDLE, TO_LOW = Move(LOW, HIGH, False), Move(HIGH, MIDDLE, False), Move(HIGH, LOW, False)


class Flight:
    """With a switch."""

    def __init__(
        self, phase: FlightPhase, low: Literal["home", "land", "pause"] = "home", by_command: bool = True
    ) -> None:
        self.phases = PhaseMachine()
        self.phases.phase = phase
        self.operator = OperatorCommands(by_command, self.phases)
        self.told: list[str] = []
        refusals = Refusals(EventEmitter(self._note), HandClock())
        self.switch = SwitchCommands(RcSwitchSettings(channel=7, low=low), self.operator, self.phases, refusals)

    def _note(self, event: Event, details: object) -> None:
        assert event.value.status is not None
        self.told.append(event.value.status.format_map(details))  # type: ignore[arg-type]

    def moves(self, *moves: Move) -> Flight:
        for move in moves:
            self.switch.on_move(move)
        return self

    @property
    def done(self) -> tuple[bool, bool, Wish]:
        """Started, paused, and how it is to go on."""
        return self.operator.start.is_set(), self.phases.paused, self.operator.wish


NOTHING = (False, False, Wish.NOTHING)


def test_switched_on_while_the_start_is_waited_for_it_starts() -> None:
    flight = Flight(WAITING).moves(TO_HIGH)
    assert flight.done == (True, False, Wish.NOTHING)
    assert flight.told == []


@pytest.mark.parametrize("phase", [CHECKING, WAITING])
@pytest.mark.parametrize(
    ("move", "words"),
    [
        (Move(None, HIGH, True), "start refused: switch is on, switch it off"),
        (Move(LOW, HIGH, True), "start refused: switch moved unseen, off and on"),
    ],
)
def test_a_switch_that_is_on_when_it_is_first_heard_or_heard_again_starts_nothing(
    phase: FlightPhase, move: Move, words: str
) -> None:
    """Protects everybody beside the vehicle from a switch that was left on, and from a radio that comes back."""
    flight = Flight(phase).moves(move)
    assert flight.done == NOTHING
    assert flight.told == [words]
    assert len(words) <= 50, "more than that does not fit"
    flight.phases.phase = WAITING
    assert flight.moves(TO_LOW, TO_HIGH).done == (True, False, Wish.NOTHING), "off and on again is a start"


def test_a_start_in_the_middle_of_the_checks_is_refused_and_not_kept() -> None:
    flight = Flight(CHECKING).moves(TO_HIGH)
    assert flight.done == NOTHING
    assert flight.told == ["start refused: it is still being checked"]


def test_where_a_key_starts_the_switch_does_not() -> None:
    flight = Flight(WAITING, by_command=False).moves(TO_HIGH)
    assert flight.done == NOTHING
    assert flight.told == ["start refused: mission.start is not command"]


@pytest.mark.parametrize("phase", [EXPLORING, HOMING])
def test_the_middle_pauses_and_high_goes_on(phase: FlightPhase) -> None:
    flight = Flight(phase).moves(TO_MIDDLE)
    assert flight.done == (False, True, Wish.NOTHING)
    assert flight.moves(Move(MIDDLE, HIGH, False)).done == NOTHING
    assert flight.told == []


def test_what_was_moved_unseen_does_not_go_on() -> None:
    flight = Flight(EXPLORING).moves(TO_MIDDLE, Move(MIDDLE, HIGH, True))
    assert flight.done == (False, True, Wish.NOTHING)
    assert flight.told == ["continue refused: switch moved unseen, off and on"]
    assert len(flight.told[0]) <= 50, "more than that does not fit"


@pytest.mark.parametrize("unseen", [False, True])
@pytest.mark.parametrize(
    ("low", "done"),
    [("home", (False, False, Wish.HOME)), ("land", (False, False, Wish.LAND)), ("pause", (False, True, Wish.NOTHING))],
)
def test_low_does_what_is_configured_also_when_it_was_moved_out_of_reach(
    low: Literal["home", "land", "pause"], done: tuple[bool, bool, Wish], unseen: bool
) -> None:
    assert Flight(EXPLORING, low).moves(Move(HIGH, LOW, unseen)).done == done


@pytest.mark.parametrize("low", ["home", "pause"])
@pytest.mark.parametrize("move", [TO_LOW, TO_MIDDLE])
def test_switched_off_during_the_take_off_the_climb_ends(low: Literal["home", "pause"], move: Move) -> None:
    assert Flight(TAKING_OFF, low).moves(move).done == (False, False, Wish.END)


@pytest.mark.parametrize("phase", [CHECKING, WAITING, LEAVING, ENDED])
@pytest.mark.parametrize("move", [TO_LOW, TO_MIDDLE])
def test_on_the_ground_and_after_a_flight_a_switch_that_goes_off_is_no_order(phase: FlightPhase, move: Move) -> None:
    flight = Flight(phase).moves(move)
    assert flight.done == NOTHING
    assert flight.told == []


def test_a_transmitter_that_is_switched_on_in_flight_changes_nothing() -> None:
    """Its switch may stand anywhere."""
    for after in Position:
        assert Flight(EXPLORING).moves(Move(None, after, False)).done[1:] == (False, Wish.NOTHING)


def test_coming_home_is_not_taken_back() -> None:
    flight = Flight(EXPLORING).moves(TO_LOW)
    flight.phases.phase = HOMING
    assert flight.moves(TO_HIGH).done == (False, False, Wish.HOME)
    assert flight.told == ["start refused: it is on its way home"]
