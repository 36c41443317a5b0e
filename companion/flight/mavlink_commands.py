"""The commands of ground stations over MAVLink: obeyed, acknowledged, and refused in words that the pilot sees."""

from __future__ import annotations

import contextlib
import math
from typing import Any

from companion.autopilot.interface import Link, LinkError, Message
from companion.autopilot.vehicle_state import integer, number
from companion.clock import Clock
from companion.flight.events import Event, EventEmitter
from companion.flight.operator_commands import OperatorCommands
from companion.link.words import Answer, Command
from companion.mavlink.ids import MavCmd, MavComponent, MavResult

LARGEST_COMMAND = 65535
TOLD_AGAIN_S = 1.0
"""A refusal is told once in so long: a ground station that gets no answer in time asks again."""

_COMMANDS: dict[int, Command] = {
    MavCmd.MISSION_START: Command.START,
    MavCmd.NAV_RETURN_TO_LAUNCH: Command.HOME,
    MavCmd.NAV_LAND: Command.LAND,
}
_PAUSES = {0.0: Command.PAUSE, 1.0: Command.CONTINUE}
"""By parameter 1 of DO_PAUSE_CONTINUE."""


class Refusals:
    """Tells operator and pilot what was refused and why, each of them once a second at most.

    Args:
        events: where they are told.
    """

    def __init__(self, events: EventEmitter, clock: Clock) -> None:
        self._events = events
        self._clock = clock
        self._told_s: dict[tuple[str, str], float] = {}  # the words of this program only, so bounded

    def tell(self, what: str, reason: str) -> None:
        """``what`` was asked for and is not done, because of ``reason``."""
        now_s = self._clock.now_s()
        if now_s - self._told_s.get((what, reason), -math.inf) >= TOLD_AGAIN_S:
            self._told_s[what, reason] = now_s
            self._events.emit(Event.COMMAND_REFUSED, what=what, reason=reason)


class MavlinkCommands:
    """Obeys COMMAND_LONG and COMMAND_INT to this component, from whomever they come.

    Args:
        operator: does what is asked for.
        link: on which they come, and are acknowledged.
        refusals: tells what was refused.
    """

    def __init__(self, operator: OperatorCommands, link: Link, refusals: Refusals) -> None:
        self._operator = operator
        self._link = link
        self._refusals = refusals
        for name in ("COMMAND_LONG", "COMMAND_INT"):
            link.events(name, self._on_command, anyone=True)

    def _on_command(self, message: Message) -> None:
        command = integer(message, "command")
        ours = (integer(message, "target_system"), integer(message, "target_component"))
        if (
            ours != (self._link.system_id, MavComponent.ONBOARD_COMPUTER)
            or command is None
            or not 0 <= command <= LARGEST_COMMAND
        ):
            return
        answer: dict[str, Any] = {
            "command": command,
            "result": self._obey(command, number(message, "param1")),
            "progress": 0,
            "result_param2": 0,
            "target_system": message.system_id,
            "target_component": message.component_id,
        }
        # A ground station that is gone when the answer leaves has its order all the same.
        with contextlib.suppress(LinkError):
            self._link.send("COMMAND_ACK", answer)

    def _obey(self, command: int, parameter: float) -> int:
        if command == MavCmd.DO_PAUSE_CONTINUE:
            asked = _PAUSES.get(parameter)
            if asked is None:
                self._refusals.tell("pause", "parameter 1 is neither 0 nor 1")
                return MavResult.DENIED
        else:
            asked = _COMMANDS.get(command)
            if asked is None:
                # Ground stations ask every component for what only some have: nobody asked this one for anything.
                return MavResult.UNSUPPORTED
        answer = self._operator.ask(asked)
        return MavResult.ACCEPTED if answer.accepted else self._refused(asked, answer)

    def _refused(self, asked: Command, answer: Answer) -> int:
        self._refusals.tell(asked.value, answer.reason)
        never = asked is Command.START and not self._operator.by_command
        return MavResult.DENIED if never else MavResult.TEMPORARILY_REJECTED
