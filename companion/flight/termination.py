"""Reasons to end the exploring, and the way home after it, the gravest first. Pure."""

from __future__ import annotations

import enum
from dataclasses import dataclass

from companion.autopilot.vehicle_state import VehicleState
from companion.config.mission import MissionSettings
from companion.config.settings import Settings
from companion.mavlink.ids import MavChargeState

BATTERY_SILENT_S = 30.0
"""A battery that was known and has not been for this long may be empty."""

SAG_S = 5.0
"""A voltage must stay low for this long: a take-off or a gust pulls it down for a second or two."""

MAP_SILENT_S = 60.0
"""A map that says nothing for this long will not come back by itself; it is what the flight is for."""


class Termination(enum.StrEnum):
    """Reason for which the exploring, or the way home, ended."""

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
    RESERVE = "battery needed for the way home"
    """Less than ``mission.reserve_percent`` would be left at home if it turned back any later."""
    TIME = "time limit"
    HOME = "home"
    """The way home has ended where it should."""
    CLOSED = "way home closed"
    """None was found, and it has come as near to home as it gets."""

    @property
    def as_it_should(self) -> bool:
        """Whether the mission did what it was sent for, or what a person asked of it."""
        return self in (Termination.COMPLETE, Termination.STOPPED, Termination.HOME)

    @property
    def leaves_a_way_home(self) -> bool:
        """Whether the vehicle still has all that it needs to come home; whether the battery lasts is another thing."""
        return self in (
            Termination.COMPLETE,
            Termination.STOPPED,
            Termination.BATTERY,
            Termination.RESERVE,
            Termination.MAP,
            Termination.TIME,
        )

    @property
    def in_brief(self) -> str:
        """For a pilot's display, where numbers have to stand beside it."""
        return "reserve" if self is Termination.RESERVE else self.value

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
        stop_asked: whether a person asked for the end, whichever.
        landing_asked: whether a person asked for the landing here.
        complete: whether the mission is done, as `Completion` says.
        flown_s: time since the take-off.
        blind_s: time since inputs were last fresh.
        awake_s: time since this application last stood still: what it did not hear before, it may have slept through.
        battery_silent_s: time since the battery's charge was last known; 0 when it never was.
        map_silent_s: time since the process of the map was last heard.
        charge_percent: what is left of the battery, by `Charge`; None while nobody says.
        reserve_due: whether the reserve says that it is time to turn back.
        is_home: whether the vehicle has come home and stands there, or where it lands in its place.
        way_closed: whether that is as near to home as it gets.
    """

    vehicle: VehicleState
    taken_over: bool
    by_failsafe: bool
    gate_took_over: bool
    gate_lost: bool
    stop_asked: bool
    landing_asked: bool
    complete: bool
    flown_s: float
    blind_s: float
    awake_s: float
    battery_silent_s: float
    map_silent_s: float
    charge_percent: float | None
    reserve_due: bool
    is_home: bool
    way_closed: bool


def termination(now: Conditions, settings: Settings) -> Termination | None:
    """The reason to end the exploring, the gravest first; None to go on."""
    mission = settings.mission
    reasons = (
        *_not_ours(now, settings),
        (Termination.BATTERY, _battery_low(now.vehicle, mission)),
        (Termination.BATTERY, now.battery_silent_s > BATTERY_SILENT_S),
        (Termination.INPUTS, now.blind_s > mission.input_timeout_s),
        (Termination.MAP, now.map_silent_s > MAP_SILENT_S),
        (Termination.STOPPED, now.stop_asked),
        (Termination.COMPLETE, now.complete),
        (Termination.RESERVE, now.reserve_due and mission.end_action == "home"),
        (Termination.TIME, now.flown_s > mission.time_limit_s),
    )
    return next((reason for reason, holds in reasons if holds), None)


def homing_end(now: Conditions, settings: Settings, limit_s: float) -> Termination | None:
    """The reason to end the way home, the gravest first; None to go on.

    Args:
        now: conditions, whose ``flown_s`` counts from where it turned back.
        settings: of the flight.
        limit_s: so long it may take.
    """
    reasons = (
        *_not_ours(now, settings),
        (Termination.BATTERY, is_spent(now, settings)),
        (Termination.INPUTS, now.blind_s > settings.mission.input_timeout_s),
        (Termination.STOPPED, now.landing_asked),
        (Termination.CLOSED, now.is_home and now.way_closed),
        (Termination.HOME, now.is_home),
        (Termination.TIME, now.flown_s > limit_s),
    )
    return next((reason for reason, holds in reasons if holds), None)


def not_ours(now: Conditions, settings: Settings) -> Termination | None:
    """Who else has the vehicle, or why nobody can reach it; None: it is ours to land."""
    return next((reason for reason, holds in _not_ours(now, settings) if holds), None)


def is_spent(now: Conditions, settings: Settings) -> bool:
    """Whether no more than a landing is left in the battery, so that nothing is flown to any more."""
    vehicle, charge = now.vehicle, now.vehicle.charge_state
    by_autopilot = charge is not None and charge.is_low and (charge is not MavChargeState.LOW or vehicle.critical)
    return by_autopilot or (now.charge_percent is not None and now.charge_percent < settings.spent_percent)


def _not_ours(now: Conditions, settings: Settings) -> tuple[tuple[Termination, bool], ...]:
    """Who else has the vehicle, or why nobody can reach it."""
    vehicle = now.vehicle
    return (
        (Termination.GATE_LOST, now.gate_lost),
        (Termination.GATE, now.gate_took_over and now.taken_over),
        # Before the link: who has the vehicle keeps it, and whatever else is wrong, nothing is ordered.
        (Termination.DISARMED, not vehicle.armed),
        (Termination.FAILSAFE, now.taken_over and now.by_failsafe),
        (Termination.PILOT, now.taken_over),
        (Termination.LINK, min(vehicle.heartbeat_age_s, now.awake_s) > settings.safety.stale.heartbeat_s),
    )


def _battery_low(vehicle: VehicleState, mission: MissionSettings) -> bool:
    """By percent, by the autopilot's own judgement, or by a voltage that stays low, or is low in a failsafe of its."""
    percent, charge = vehicle.battery_percent, vehicle.charge_state
    return (
        (percent is not None and percent < mission.battery_low_percent)
        or (charge is not None and charge.is_low)
        or vehicle.low_voltage_s > (0.0 if vehicle.critical else SAG_S)
    )
