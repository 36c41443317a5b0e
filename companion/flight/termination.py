"""Reasons to end a flight, the gravest first."""

from __future__ import annotations

import enum
from dataclasses import dataclass

from companion.autopilot.vehicle_state import VehicleState
from companion.config.mission import MissionSettings
from companion.config.settings import Settings

BATTERY_SILENT_S = 30.0
"""A battery that was known and has not been for this long may be empty."""

SAG_S = 5.0
"""A voltage must stay low for this long: a take-off or a gust pulls it down for a second or two."""

MAP_SILENT_S = 60.0
"""A map that says nothing for this long will not come back by itself; it is what the flight is for."""


class Termination(enum.StrEnum):
    """Reason for which the exploring ended."""

    COMPLETE = "complete"
    """Nothing is left that the vehicle knows of and can get to: `companion.control.completion`."""
    STOPPED = "stopped"
    """A person asked for it."""
    FAILSAFE = "autopilot failsafe took over"
    """Its heartbeat says so: hands off."""
    PILOT = "pilot took over"
    """The mode was changed, and by no failsafe that the autopilot tells of: hands off."""
    DISARMED = "disarmed in flight"
    GATE_LOST = "gate lost"
    """The safety gate died, and with it the way to the autopilot: no manoeuvre is possible."""
    GATE = "gate took over"
    """The safety gate holds or lands the vehicle: hands off."""
    LINK = "autopilot lost"
    BATTERY = "battery low"
    MAP = "map lost"
    """Its process hangs, or died more often than it is started again."""
    INPUTS = "inputs lost"
    """No fresh inputs for longer than ``mission.input_timeout_s``."""
    TIME = "time limit"

    @property
    def as_it_should(self) -> bool:
        """Whether the mission did what it was sent for, or what a person asked of it."""
        return self in (Termination.COMPLETE, Termination.STOPPED)

    @property
    def hands_off(self) -> bool:
        """Whether the vehicle is no longer ours to end the flight of."""
        return self in (
            Termination.GATE_LOST,
            Termination.GATE,
            Termination.FAILSAFE,
            Termination.PILOT,
            Termination.DISARMED,
        )


@dataclass(frozen=True, slots=True)
class Conditions:
    """Conditions on which it depends whether a flight goes on.

    Attributes:
        vehicle: the autopilot's last word.
        taken_over: whether a person or a failsafe of the autopilot has the vehicle, so that its mode is not ours.
        by_failsafe: whether the autopilot says that it was its failsafe that took it.
        gate_took_over: whether the gate says that it holds or lands, so that such a mode is its doing.
        gate_lost: whether the gate is gone.
        stop_asked: whether a person asked for the end.
        complete: whether the mission is done, as `Completion` says.
        flown_s: time since the take-off.
        blind_s: time since inputs were last fresh.
        awake_s: time since this application last stood still: what it did not hear before, it may have slept through.
        battery_silent_s: time since the battery's charge was last known; 0 when it never was.
        map_silent_s: time since the process of the map was last heard.
    """

    vehicle: VehicleState
    taken_over: bool
    by_failsafe: bool
    gate_took_over: bool
    gate_lost: bool
    stop_asked: bool
    complete: bool
    flown_s: float
    blind_s: float
    awake_s: float
    battery_silent_s: float
    map_silent_s: float


def termination(now: Conditions, settings: Settings) -> Termination | None:
    """The reason to end the exploring, the gravest first; None to go on."""
    vehicle, mission = now.vehicle, settings.mission
    reasons = (
        (Termination.GATE_LOST, now.gate_lost),
        (Termination.GATE, now.gate_took_over and now.taken_over),
        # Before the link: who has the vehicle keeps it, and whatever else is wrong, nothing is ordered.
        (Termination.DISARMED, not vehicle.armed),
        (Termination.FAILSAFE, now.taken_over and now.by_failsafe),
        (Termination.PILOT, now.taken_over),
        (Termination.LINK, min(vehicle.heartbeat_age_s, now.awake_s) > settings.safety.stale.heartbeat_s),
        (Termination.BATTERY, _battery_low(vehicle, mission)),
        (Termination.BATTERY, now.battery_silent_s > BATTERY_SILENT_S),
        (Termination.INPUTS, now.blind_s > mission.input_timeout_s),
        (Termination.MAP, now.map_silent_s > MAP_SILENT_S),
        (Termination.STOPPED, now.stop_asked),
        (Termination.COMPLETE, now.complete),
        (Termination.TIME, now.flown_s > mission.time_limit_s),
    )
    return next((reason for reason, holds in reasons if holds), None)


def _battery_low(vehicle: VehicleState, mission: MissionSettings) -> bool:
    """By percent, by the autopilot's own judgement, or by a voltage that stays low, or is low in a failsafe of its."""
    percent, charge = vehicle.battery_percent, vehicle.charge_state
    return (
        (percent is not None and percent < mission.battery_low_percent)
        or (charge is not None and charge.is_low)
        or vehicle.low_voltage_s > (0.0 if vehicle.critical else SAG_S)
    )
