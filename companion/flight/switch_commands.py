"""What the pilot's switch asks of a flight: high explores or goes on, the middle pauses, low is as configured."""

from __future__ import annotations

from companion.autopilot.rc_switch import Move, Position
from companion.config.mission import RcSwitchSettings
from companion.flight.mavlink_commands import Refusals
from companion.flight.operator_commands import OperatorCommands
from companion.flight.phase import FlightPhase, PhaseMachine
from companion.link.words import Command

ON_ALREADY = "switch is on, switch it off"
MOVED_UNSEEN = "switch moved unseen, off and on"


class SwitchCommands:
    """Hands each move of the switch on as a command.

    To start, or to go on, takes a move that was seen: a switch that stands high when it is first heard, or when the
    transmitter is heard again, moves nothing. What stops may have been moved unseen.

    Args:
        settings: what low asks for.
        operator: does what is asked for.
        flight: knows the phase.
        refusals: tells the pilot why nothing happens.
    """

    def __init__(
        self, settings: RcSwitchSettings, operator: OperatorCommands, flight: PhaseMachine, refusals: Refusals
    ) -> None:
        self._low = Command(settings.low)
        self._operator = operator
        self._flight = flight
        self._refusals = refusals

    def on_move(self, move: Move) -> None:
        """The switch has come to stand elsewhere."""
        if move.after is Position.HIGH:
            self._explore(move)
        elif move.before is not None and FlightPhase.TAKING_OFF <= self._flight.phase < FlightPhase.LEAVING:
            self._ask(self._low if move.after is Position.LOW else Command.PAUSE)

    def _explore(self, move: Move) -> None:
        asked = Command.CONTINUE if self._flight.paused else Command.START
        if move.before is None:
            self._refusals.tell(asked.value, ON_ALREADY)
        elif move.unseen:
            self._refusals.tell(asked.value, MOVED_UNSEEN)
        else:
            self._ask(asked)

    def _ask(self, command: Command) -> None:
        if command is Command.HOME and self._flight.phase is FlightPhase.TAKING_OFF:
            # Home is below: the climb ends.
            command = Command.PAUSE
        answer = self._operator.ask(command)
        if not answer.accepted:
            self._refusals.tell(command.value, answer.reason)
