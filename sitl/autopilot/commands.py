"""COMMAND_LONG and COMMAND_INT: what each does, and what it is answered with."""

from __future__ import annotations

import math
from dataclasses import dataclass

from companion.mavlink.ids import MavSeverity
from sitl.autopilot.mavlink import MESSAGE_NAMES, Message
from sitl.autopilot.mavlink import dialect as m
from sitl.autopilot.personality import Personality
from sitl.autopilot.state import State
from sitl.autopilot.streams import Streams
from sitl.autopilot.telemetry import Telemetry

_FORCE = 21196.0
"""Parameter 2 of an arming command that skips the checks."""
_DONE = m.MAV_RESULT_ACCEPTED


@dataclass(slots=True)
class Answer:
    """The result, and messages that were asked for.

    ``received``: it is acknowledged when it has been received, and its result follows.
    """

    result: int
    messages: list[Message]
    reboot: bool = False
    received: bool = False


class Commands:
    """Carries out commands.

    Args:
        personality: which autopilot answers.
        state: what it changes.
        streams: for message intervals.
        telemetry: for messages asked for once.
    """

    def __init__(self, personality: Personality, state: State, streams: Streams, telemetry: Telemetry) -> None:
        self._personality = personality
        self._state = state
        self._streams = streams
        self._telemetry = telemetry

    def do(self, command: int, parameters: list[float], source: int) -> Answer:
        """Carries out one command of component ``source``, with its parameters 1 to 7 (NaN where not given)."""
        if command == m.MAV_CMD_SET_MESSAGE_INTERVAL:
            return Answer(self._set_interval(parameters), [])
        if command == m.MAV_CMD_GET_MESSAGE_INTERVAL:
            return self._get_interval(parameters[0])
        if command == m.MAV_CMD_REQUEST_MESSAGE:
            return self._request(_name(parameters[0]))
        if command == m.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES:
            return self._request("AUTOPILOT_VERSION")
        if command == m.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN:
            if self._state.armed:
                return Answer(self._personality.refuses_reboot, [])
            return Answer(_DONE, [], reboot=parameters[0] == 1.0)
        twice = command == m.MAV_CMD_DO_SET_MODE and self._personality.acknowledges_twice
        return Answer(self._fly(command, parameters, source), [], received=twice)

    def set_mode(self, custom_mode: int | None, source: int | None) -> int:
        """Changes the mode, as component ``source`` asks; the MAV_RESULT."""
        if custom_mode is None:
            return int(m.MAV_RESULT_DENIED)
        mode = self._personality.mode(custom_mode)
        if mode is None:
            return self._personality.unknown_mode(self._state, custom_mode)
        if mode is self._state.mode and self._state.failsafe is None:
            return int(_DONE)
        refusal = self._personality.mode_refusal(self._state, mode)
        if refusal is not None:
            self._personality.tell_mode_refused(self._state, mode, refusal, source)
            return self._personality.refused
        self._state.enter(mode)
        return int(_DONE)

    def _fly(self, command: int, parameters: list[float], source: int) -> int:
        modes, personality = self._personality.modes, self._personality
        if command == m.MAV_CMD_COMPONENT_ARM_DISARM:
            return self._arm(parameters[0], forced=parameters[1] == _FORCE)
        if command == m.MAV_CMD_NAV_TAKEOFF:
            took_off = personality.take_off(self._state, parameters[6])
            return int(_DONE) if took_off else personality.refused
        if command == m.MAV_CMD_NAV_LAND:
            return self.set_mode(modes[personality.land_mode].custom_mode, None)
        if command == m.MAV_CMD_NAV_RETURN_TO_LAUNCH:
            return self.set_mode(modes[personality.return_mode].custom_mode, None)
        if command == m.MAV_CMD_DO_PAUSE_CONTINUE and personality.pauses:
            return self._pause(parameters[0])
        if command == m.MAV_CMD_DO_SET_MODE:
            if not math.isfinite(parameters[0]) or not int(parameters[0]) & m.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
                return int(m.MAV_RESULT_DENIED)
            return self.set_mode(personality.custom_mode(parameters[1], _or_zero(parameters[2])), source)
        return int(m.MAV_RESULT_UNSUPPORTED)

    def _arm(self, wanted: float, forced: bool) -> int:
        state = self._state
        if wanted == 0.0:
            if not state.landed and not forced:
                self._personality.disarming_refused(state)
                return self._personality.refused
            if state.armed:
                state.disarm(self._personality.disarmed_text)
            return int(_DONE)
        if wanted != 1.0:
            return int(m.MAV_RESULT_UNSUPPORTED)
        if state.armed:
            return int(_DONE)
        refusals = self._personality.arming_refusals(state)
        if refusals and (not forced or state.airframe.crashed):
            for refusal in refusals:
                state.say(MavSeverity.CRITICAL, refusal)
            self._personality.tell_arming_refused(state)
            return self._personality.refused
        pose = state.estimator.pose
        state.armed, state.armed_s, state.flown, state.on_ground_s = True, state.t_s, False, 0.0
        state.home_m = pose.x_m, pose.y_m, pose.z_m
        state.settle()
        state.say(MavSeverity.INFO, self._personality.armed_text)
        return int(_DONE)

    def _pause(self, wanted: float) -> int:
        """A ground station's pause: the mode stays, and its setpoints count again on continue."""
        if wanted not in (0.0, 1.0):
            return int(m.MAV_RESULT_DENIED)
        if self._state.mode.name != self._personality.setpoint_mode:
            return int(m.MAV_RESULT_FAILED)
        self._state.paused, self._state.hold_m = wanted == 0.0, None
        return int(_DONE)

    def _set_interval(self, parameters: list[float]) -> int:
        name = _name(parameters[0])
        if name is None or not self._has(name) or not math.isfinite(parameters[1]):
            words = self._personality.no_such_message
            if words is not None and math.isfinite(parameters[0]):
                self._state.say(MavSeverity.INFO, words.format(int(parameters[0]) & 0xFFFFFF))
            return self._personality.refuses_interval
        self._streams.set_interval_us(name, parameters[1], self._state.t_s)
        return int(_DONE)

    def _get_interval(self, number: float) -> Answer:
        name = _name(number)
        if name is None:
            return Answer(int(m.MAV_RESULT_UNSUPPORTED), [])
        interval_us = self._streams.interval_us(name) if self._has(name) else 0
        return Answer(int(_DONE), [m.MAVLink_message_interval_message(int(number), interval_us)])

    def _request(self, name: str | None) -> Answer:
        message = self._telemetry.build(name) if name is not None and self._has(name) else None
        if message is None:
            return Answer(int(m.MAV_RESULT_DENIED), [])
        return Answer(int(_DONE), [message])

    def _has(self, name: str) -> bool:
        return name in self._personality.rates_hz or name in self._personality.on_request


def _name(number: float) -> str | None:
    return MESSAGE_NAMES.get(int(number)) if math.isfinite(number) else None


def _or_zero(value: float) -> float:
    return value if math.isfinite(value) else 0.0
