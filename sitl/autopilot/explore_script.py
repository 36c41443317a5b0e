"""What `ground-stations/explore.lua` makes of ArduCopter: the mode Explore, which asks the companion to start.

The stub has it while its parameter SCR_ENABLE is 1. The script's auxiliary function it does not have.
"""

from __future__ import annotations

import math

from companion.mavlink.ids import MavSeverity
from sitl.autopilot.mavlink import Message
from sitl.autopilot.mavlink import dialect as m
from sitl.autopilot.state import Behaviour, Mode, State

EXPLORE = Mode("EXPLORE", 101, Behaviour.SETPOINTS)
COMPANION = 191
HEARD_S, AGAIN_S, ANSWER_S = 3.0, 0.5, 3.0
_RESULTS = {1: "not now", 2: "denied", 3: "unsupported", 4: "failed"}


def refusal(state: State) -> str | None:
    """Why the mode cannot be taken now."""
    if not _runs(state):
        return f"No such mode {EXPLORE.custom_mode}"
    heard_s = state.companion.heard_s
    there = heard_s is not None and state.t_s - heard_s < HEARD_S
    return None if there and not state.armed else "Mode change to Explore failed: init failed"


class ExploreScript:
    """The script of one vehicle, since it booted.

    Args:
        state: of the vehicle, whose mode it goes back to when nothing comes of it.
        system_id: of the vehicle.
    """

    def __init__(self, state: State, system_id: int) -> None:
        self._state = state
        self._system_id = system_id
        self._last = state.mode
        self._before = state.mode
        self._asked_s: float | None = None  # since when an answer is waited for
        self._sent_s = -math.inf

    def step(self) -> None:
        """Looks once at the mode, and at how long it has been waiting."""
        state = self._state
        if state.mode is EXPLORE and self._last is not EXPLORE:
            self._before, self._asked_s = self._last, state.t_s
        self._last = state.mode
        if self._asked_s is None:
            return
        if state.t_s - self._asked_s > ANSWER_S:
            self._answered("the companion is not heard")
        elif state.t_s - self._sent_s > AGAIN_S:
            self._sent_s = state.t_s
            asked = (self._system_id, COMPANION, m.MAV_CMD_MISSION_START, 0, *[0.0] * 7)
            state.later.append((state.t_s, m.MAVLink_command_long_message(*asked)))

    def acknowledged(self, message: Message) -> None:
        """A COMMAND_ACK has come."""
        ours = message.get_srcComponent() == COMPANION and message.command == m.MAV_CMD_MISSION_START
        if ours and self._asked_s is not None and message.result != m.MAV_RESULT_IN_PROGRESS:
            accepted = message.result == m.MAV_RESULT_ACCEPTED
            self._answered(None if accepted else _RESULTS.get(message.result, "refused"))

    def _answered(self, problem: str | None) -> None:
        self._asked_s = None
        if problem is None:
            self._state.say(MavSeverity.NOTICE, "Explore: started")
            return
        self._state.say(MavSeverity.WARNING, f"Explore: start: {problem}")
        if self._state.mode is EXPLORE:
            self._state.say(MavSeverity.WARNING, "Explore: back to the mode before")
            self._state.enter(self._before)


def _runs(state: State) -> bool:
    return "SCR_ENABLE" in state.parameters and state.parameters["SCR_ENABLE"] == 1
