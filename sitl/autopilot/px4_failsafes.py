"""What PX4 flies when something is missing: the worst of the actions that are asked for, and whether it can be flown.

Those that a person may overrule (transmitter, ground station, battery) hold for COM_FAIL_ACT_T first. An action that
cannot be flown becomes the next harder one: hold, return, land, descend.
"""

from __future__ import annotations

import enum
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

from companion.mavlink.ids import MavSeverity
from sitl.autopilot.events import Event
from sitl.autopilot.state import Behaviour, Mode, State

_CRITICAL, _WARNING, _INFO = 2, 4, 6
_MISSION_COMPUTER_SILENT_S = 10.0


class Action(enum.IntEnum):
    """As PX4 orders and numbers them, the worst last."""

    NONE = 0
    WARN = 1
    POSITION = 2
    HOLD = 5
    RETURN = 6
    LAND = 7
    DESCEND = 8
    DISARM = 9
    TERMINATE = 10


class Cause(enum.IntEnum):
    """As PX4 numbers them."""

    GENERIC = 0
    TRANSMITTER = 1
    GROUND_STATION = 2
    BATTERY_LOW = 3
    BATTERY_CRITICAL = 4
    BATTERY_EMERGENCY = 5


_LINK_LOSS = {1: Action.HOLD, 2: Action.RETURN, 3: Action.LAND, 5: Action.TERMINATE, 6: Action.DISARM}
"""NAV_RCL_ACT and NAV_DLL_ACT."""
_SETPOINT_LOSS = {
    3: Action.RETURN, 4: Action.LAND, 5: Action.HOLD, 6: Action.TERMINATE, 7: Action.DISARM,
}  # fmt: skip
"""COM_OBL_RC_ACT; the pilot's modes are the others."""
_BATTERY = {
    Cause.BATTERY_CRITICAL: {1: Action.RETURN, 2: Action.LAND, 3: Action.RETURN},
    Cause.BATTERY_EMERGENCY: {1: Action.RETURN, 2: Action.LAND, 3: Action.LAND},
}
"""COM_LOW_BAT_ACT."""
_WARNINGS = {
    Cause.BATTERY_LOW: ("commander_failsafe_enter_low_bat", _WARNING),
    Cause.BATTERY_CRITICAL: ("commander_failsafe_enter_crit_bat_warn", _CRITICAL),
    Cause.BATTERY_EMERGENCY: ("commander_failsafe_enter_crit_low_bat_warn", 0),
}
_HARDER = (Action.HOLD, Action.RETURN, Action.LAND, Action.DESCEND)
_FLOWN = {Action.HOLD: "AUTO.LOITER", Action.RETURN: "AUTO.RTL", Action.LAND: "AUTO.LAND", Action.POSITION: "POSCTL"}
_NO_STICKS = 4
"""COM_RC_IN_MODE."""
_HOLD_EXCEPTED, _OFFBOARD_EXCEPTED = 2, 4


class Vehicle(Protocol):
    """What has to be known of the vehicle."""

    @property
    def modes(self) -> Mapping[str, Mode]:
        """By name."""

    @property
    def descend(self) -> Mode:
        """That needs no position."""

    def can_run(self, state: State, mode: Mode) -> bool:
        """Whether a mode can be flown now."""

    def battery_warning(self, state: State) -> int:
        """0: none, 1: low, 2: critical, 3: emergency."""

    def offboard_lost(self, state: State) -> bool:
        """Whether the computer's setpoints, or the position that they need, are missing."""


@dataclass(slots=True)
class Px4Failsafes:
    """The failsafes of one vehicle, since it booted.

    Args:
        vehicle: whose.
    """

    vehicle: Vehicle
    action: Action = Action.NONE
    _latched: dict[Cause, Action] = field(default_factory=dict)
    _delay_s: float = 0.0
    _taken_over: bool = False
    _intended: Mode | None = None
    _transmitter_lost_at_arming: bool = True
    _warning_at_arming: int = 0
    _was_armed: bool = False

    def step(self, state: State, dt_s: float) -> None:
        """Looks at everything once; changes the mode that is flown, or disarms."""
        self._listen(state)
        self._note_arming(state)
        if not state.armed:
            self.action, self._intended = Action.NONE, state.mode
            self._latched.clear()
            return
        switched, self._intended = self._intended is not state.mode, state.mode
        self._delay_s = max(0.0, self._delay_s - dt_s)
        warned = self._collect(state, switched)
        can_hold = self.vehicle.can_run(state, self.vehicle.modes["AUTO.LOITER"])
        if self.action > Action.HOLD or not can_hold or self._taken_over:
            self._delay_s = 0.0
        selected, delayed, cause = self._select(state, switched)
        if selected > self.action or (warned and selected is not Action.NONE):
            self._announce(state, selected, delayed, cause)
        self.action = selected
        self._fly(state)

    def _listen(self, state: State) -> None:
        parameters = state.parameters
        if state.transmitter_on:
            state.transmitter.heard(state.t_s)
        state.transmitter.silent_for(state.t_s, parameters["COM_RC_LOSS_T"])
        if state.ground_station.silent_for(state.t_s, parameters["COM_DL_LOSS_T"]):
            state.say(MavSeverity.INFO, "Connection to ground station lost\t")
            state.tell(Event("commander_gcs_lost", _WARNING, _INFO))
        if state.companion.silent_for(state.t_s, _MISSION_COMPUTER_SILENT_S):
            state.say(MavSeverity.CRITICAL, "Connection to mission computer lost\t")
            state.tell(Event("commander_mission_comp_lost", _CRITICAL, _CRITICAL))

    def _note_arming(self, state: State) -> None:
        if not state.transmitter.lost:
            self._transmitter_lost_at_arming = False
        if not (state.armed and self._was_armed):
            self._transmitter_lost_at_arming = state.transmitter.lost
            self._warning_at_arming = self.vehicle.battery_warning(state)
        self._was_armed = state.armed

    def _failing_now(self, state: State) -> dict[Cause, Action]:
        """What asks for an action now, besides the mode's own needs."""
        found: dict[Cause, Action] = {}
        parameters, name = state.parameters, state.mode.name
        sticks_missed = state.transmitter.lost and not self._transmitter_lost_at_arming
        sticks_missed = sticks_missed and parameters["COM_RC_IN_MODE"] != _NO_STICKS
        if sticks_missed and not _excepted(int(parameters["COM_RCL_EXCEPT"]), name):
            found[Cause.TRANSMITTER] = _LINK_LOSS.get(int(parameters["NAV_RCL_ACT"]), Action.NONE)
        station_missed = state.ground_station.lost and name != "AUTO.LAND" and parameters["NAV_DLL_ACT"] != 0
        if station_missed and not _excepted(int(parameters["COM_DLL_EXCEPT"]), name):
            found[Cause.GROUND_STATION] = _LINK_LOSS.get(int(parameters["NAV_DLL_ACT"]), Action.NONE)
        warning = self.vehicle.battery_warning(state)
        if warning:
            cause = (Cause.BATTERY_LOW, Cause.BATTERY_CRITICAL, Cause.BATTERY_EMERGENCY)[warning - 1]
            wanted = int(parameters["COM_LOW_BAT_ACT"]) if warning > self._warning_at_arming else 0
            found[cause] = _BATTERY.get(cause, {}).get(wanted, Action.WARN)
        return found

    def _collect(self, state: State, switched: bool) -> bool:
        """Brings the actions that are asked for up to date; whether a new one only warns."""
        now, warned = self._failing_now(state), False
        for cause, action in now.items():
            if cause not in self._latched:
                if action is not Action.WARN and self._delay_s == 0.0:
                    self._delay_s = state.parameters["COM_FAIL_ACT_T"]
                if action >= Action.HOLD:
                    self._taken_over = False
                warned = warned or action is Action.WARN
            self._latched[cause] = action
        for cause in [c for c in self._latched if c not in now]:
            # A link that is back does not give the vehicle back; somebody has to choose a mode.
            if cause >= Cause.BATTERY_LOW or switched or self._taken_over:
                del self._latched[cause]
        return warned

    def _select(self, state: State, switched: bool) -> tuple[Action, Action, Cause]:
        """What is flown, what will be after the delay, and why."""
        cause, selected = max(
            ((cause, action) for cause, action in self._latched.items()),
            key=lambda pair: pair[1],
            default=(Cause.GENERIC, Action.NONE),
        )
        fallback = self._fallback(state, state.mode)
        if fallback > selected:
            cause, selected = Cause.GENERIC, fallback
        delayed = Action.NONE
        waits = self._delay_s > 0.0 and not self._taken_over
        if waits and Action.NONE < selected < Action.DISARM and selected is not Action.HOLD:
            delayed, selected = selected, Action.HOLD
        wants = switched and self.action is selected
        if selected in _HARDER and (wants or self._taken_over):
            self._taken_over, delayed = True, Action.NONE
            selected = max(Action.WARN, fallback)
        else:
            self._taken_over = False
        selected, cause = self._possible(state, selected, cause)
        for name, action in (("AUTO.LAND", Action.RETURN), ("AUTO.RTL", Action.RETURN)):
            # A landing is not turned into a return, a return is not begun anew.
            if state.mode.name == name and action in (selected, delayed) and self.vehicle.can_run(state, state.mode):
                selected, delayed = Action.WARN, Action.NONE
        return selected, delayed, cause

    def _fallback(self, state: State, mode: Mode) -> Action:
        """What the mode itself needs and does not have."""
        if self.vehicle.can_run(state, mode):
            return Action.NONE
        if mode.behaviour is Behaviour.SETPOINTS:
            return _SETPOINT_LOSS.get(int(state.parameters["COM_OBL_RC_ACT"]), Action.POSITION)
        return Action.RETURN

    def _possible(self, state: State, selected: Action, cause: Cause) -> tuple[Action, Cause]:
        modes = self.vehicle.modes
        if selected is Action.POSITION:
            # Measured: without sticks, and with a position, it descends and hardly brakes.
            possible = self.vehicle.can_run(state, modes["POSCTL"])
            return (selected, cause) if possible else (Action.DESCEND, Cause.GENERIC)
        while selected in _FLOWN and not self.vehicle.can_run(state, modes[_FLOWN[selected]]):
            selected, cause = Action(selected + 1), Cause.GENERIC
        return selected, cause

    def _announce(self, state: State, selected: Action, delayed: Action, cause: Cause) -> None:
        mode = state.mode.custom_mode
        if selected is Action.WARN:
            name, level = _WARNINGS.get(cause, ("commander_failsafe_enter_warn", _WARNING))
            arguments = b"" if cause in _WARNINGS else struct.pack("<IB", mode, cause)
            state.tell(Event(name, level, _INFO, arguments))
            return
        if delayed is not Action.NONE:
            seconds = int(self._delay_s + 0.5)
            arguments = struct.pack("<IBHB", mode, delayed, seconds, cause)
            state.say(MavSeverity.CRITICAL, f"Failsafe activated: entering Hold for {seconds} seconds\t")
            state.tell(Event("commander_failsafe_enter_hold", _CRITICAL, _WARNING, arguments))
            return
        state.say(MavSeverity.CRITICAL, "Failsafe activated\t")
        if cause is not Cause.GENERIC:
            arguments = struct.pack("<IBB", mode, selected, cause)
            state.tell(Event("commander_failsafe_enter", _CRITICAL, _WARNING, arguments))
        elif selected is Action.DESCEND:
            arguments = struct.pack("<IB", mode, selected)
            state.tell(Event("commander_failsafe_enter_autopilot_disengaged", _CRITICAL, _WARNING, arguments))
        else:
            arguments = struct.pack("<IB", mode, selected)
            state.tell(Event("commander_failsafe_enter_generic", _CRITICAL, _WARNING, arguments))

    def _fly(self, state: State) -> None:
        if self.action >= Action.DISARM:
            state.disarm("Disarmed by failsafe\t")
        elif self.action is Action.DESCEND:
            state.fall_back(self.vehicle.descend)
        else:
            name = _FLOWN.get(self.action)
            state.fall_back(None if name is None else self.vehicle.modes[name])


def _excepted(bits: int, mode: str) -> bool:
    """Whether COM_RCL_EXCEPT or COM_DLL_EXCEPT names the mode."""
    if mode == "OFFBOARD":
        return bool(bits & _OFFBOARD_EXCEPTED)
    return mode in ("AUTO.LOITER", "AUTO.TAKEOFF") and bool(bits & _HOLD_EXCEPTED)
