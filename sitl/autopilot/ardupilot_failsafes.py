"""What ArduCopter does when something is missing: each of its failsafes changes the mode once, when it triggers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

from companion.mavlink.ids import MavSeverity
from sitl.autopilot.state import Behaviour, Mode, State

LOST_S = 7.1
"""For so long after its aiding has stopped the estimator says that all is well."""
_LANE_SWITCH_S, _VARIANCE_S = 7.9, 8.0
_RADIO_SILENT_S = 0.5
_RADIO = {1: "RTL", 2: "RTL", 3: "LAND", 4: "RTL", 5: "LAND"}
"""FS_THR_ENABLE; without SmartRTL, which needs a path that was flown."""
_STATION = {1: "RTL", 3: "RTL", 4: "LAND", 5: "LAND"}
"""FS_GCS_ENABLE."""
_BATTERY = {1: "LAND", 2: "RTL", 3: "RTL", 4: "LAND"}
"""BATT_FS_LOW_ACT, BATT_FS_CRT_ACT."""
_CONTINUE_GUIDED, _CONTINUE_LANDING, _CONTINUE_PILOT = 4, 8, 16
"""FS_OPTIONS."""
_LEVELS = ("low", "critical")
NEEDS_NO_POSITION = ("STABILIZE", "ALT_HOLD", "LAND")


class Vehicle(Protocol):
    """What has to be known of the vehicle."""

    @property
    def modes(self) -> Mapping[str, Mode]:
        """By name."""

    def position_valid(self, state: State) -> bool:
        """Whether the estimator has a horizontal position."""


@dataclass(slots=True)
class ArduPilotFailsafes:
    """The failsafes of one vehicle, since it booted.

    Args:
        vehicle: whose.
    """

    vehicle: Vehicle
    _triggered: set[str] = field(default_factory=set)
    _had_position: bool = False
    _lane_switched: bool = False
    _below_s: list[float] = field(default_factory=lambda: [0.0, 0.0])

    def step(self, state: State, dt_s: float) -> None:
        """Looks at everything once; changes the mode."""
        self._radio(state)
        self._station(state)
        self._battery(state, dt_s)
        self._estimator(state)
        state.critical = bool(self._triggered)
        state.battery_level = sum(name in self._triggered for name in _LEVELS)

    def _radio(self, state: State) -> None:
        if state.transmitter_on:
            state.transmitter.heard(state.t_s)
            if "radio" in self._triggered:
                self._triggered.discard("radio")
                state.say(MavSeverity.WARNING, "Radio Failsafe Cleared")
        if not state.transmitter.silent_for(state.t_s, _RADIO_SILENT_S):
            return
        self._triggered.add("radio")
        if not state.armed:
            return
        guided = state.mode.behaviour is Behaviour.SETPOINTS and int(state.parameters["FS_OPTIONS"]) & _CONTINUE_GUIDED
        if guided:
            state.say(MavSeverity.WARNING, "Radio Failsafe - Continuing Guided Mode")
        else:
            self._act(state, "Radio", _RADIO.get(int(state.parameters["FS_THR_ENABLE"])))

    def _station(self, state: State) -> None:
        parameters = state.parameters
        if not state.ground_station.lost:
            self._triggered.discard("station")
        lost = state.ground_station.silent_for(state.t_s, parameters["FS_GCS_TIMEOUT"])
        if not lost or not state.armed or parameters["FS_GCS_ENABLE"] == 0:
            return
        self._triggered.add("station")
        pilots = state.mode.behaviour is not Behaviour.SETPOINTS and state.mode.armable
        if pilots and int(parameters["FS_OPTIONS"]) & _CONTINUE_PILOT:
            state.say(MavSeverity.WARNING, "GCS Failsafe - Continuing Pilot Control")
        else:
            self._act(state, "GCS", _STATION.get(int(parameters["FS_GCS_ENABLE"])))

    def _battery(self, state: State, dt_s: float) -> None:
        """By voltage alone: what it counts begins at 100 % whatever is in the battery."""
        if not state.armed:
            return
        battery, parameters = state.battery, state.parameters
        for i, limit in enumerate(("BATT_LOW_VOLT", "BATT_CRT_VOLT")):
            below = 0.0 < battery.voltage_v < parameters[limit]
            self._below_s[i] = self._below_s[i] + dt_s if below else 0.0
            level = _LEVELS[i]
            if self._below_s[i] <= parameters["BATT_LOW_TIMER"] or level in self._triggered:
                continue
            self._triggered |= set(_LEVELS[: i + 1])
            text = f"Battery 1 is {level} {battery.voltage_v:.2f}V used {battery.used_mah:.0f} mAh"
            state.say(MavSeverity.WARNING, text)
            self._act(state, "Battery", _BATTERY.get(int(parameters[f"BATT_FS_{('LOW', 'CRT')[i]}_ACT"])))

    def _estimator(self, state: State) -> None:
        if self.vehicle.position_valid(state):
            self._had_position, self._lane_switched = True, False
            self._triggered.discard("estimator")
            return
        alone_s = state.estimator.alone_s(state.t_s)
        if not self._had_position or "estimator" in self._triggered:
            return
        if alone_s >= _LANE_SWITCH_S and not self._lane_switched:
            self._lane_switched = True
            state.say(MavSeverity.CRITICAL, "EKF3 lane switch 1")
            state.say(MavSeverity.WARNING, "EKF primary changed:1")
        if alone_s < _VARIANCE_S:
            return
        self._triggered.add("estimator")
        state.say(MavSeverity.CRITICAL, "EKF variance")
        action = int(state.parameters["FS_EKF_ACTION"])
        if not state.armed:
            return
        state.say(MavSeverity.CRITICAL, "EKF Failsafe")
        if action == 3 or (action in (1, 2) and state.mode.name not in NEEDS_NO_POSITION):
            state.enter(self.vehicle.modes["ALT_HOLD" if action == 2 else "LAND"])

    def _act(self, state: State, what: str, mode: str | None) -> None:
        """Takes the mode, once it has said why; on the ground it disarms instead, and a landing may go on."""
        if state.landed:
            state.say(MavSeverity.WARNING, f"{what} Failsafe - Disarming")
            state.disarm("Disarming motors")
            return
        if state.mode.name == "LAND" and mode and int(state.parameters["FS_OPTIONS"]) & _CONTINUE_LANDING:
            state.say(MavSeverity.WARNING, f"{what} Failsafe - Continuing Landing")
            return
        state.say(MavSeverity.WARNING, f"{what} Failsafe")
        if mode == "RTL" and not self.vehicle.position_valid(state):
            mode = "LAND"
        if mode is not None and state.mode.name != mode:
            state.enter(self.vehicle.modes[mode])
