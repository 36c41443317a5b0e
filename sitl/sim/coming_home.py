"""The way home after the exploring, in the simulated mine: flown by the same navigator, and judged by the truth."""

from __future__ import annotations

import math
from dataclasses import dataclass

from companion.config.settings import Settings
from companion.control.homing.homing import WayHome
from companion.control.homing.reserve import LANDING_S
from companion.model import Pose
from companion.pipeline import Order
from sitl.sim.flight import Flight

ARRIVED_M = 0.5
"""A vehicle has come home when it truly stands so near to where it started."""


@dataclass(frozen=True, slots=True)
class Turned:
    """How a vehicle stood when it turned back."""

    began_s: float
    path_m: float
    way: WayHome | None
    promised_percent: float | None


@dataclass(frozen=True, slots=True)
class Came:
    """How it stood when its way home had ended; what is left of the battery is that after the landing."""

    pose: Pose
    path_m: float
    to_go_m: float
    left_percent: float


class ComingHome:
    """The way home of one vehicle, from the moment when it turns back.

    Args:
        flight: the vehicle.
        start: where it truly started.
        settings: the whole configuration.
    """

    def __init__(self, flight: Flight, start: Pose, settings: Settings) -> None:
        self._flight = flight
        self._start = start
        self._settings = settings
        t_s, path_m = flight.vehicle.pose.t_s, flight.vehicle.path_m
        self._began = Turned(
            began_s=t_s,
            path_m=path_m,
            way=flight.way_home(anew=True),
            promised_percent=flight.reserve.left_percent,
        )
        flight.order = Order.HOME
        self.ended_because = "home not known" if flight.navigator.homing.home is None else ""
        """Empty while it flies."""
        self._came: Came | None = None

    def look(self) -> bool:
        """Whether the way home has ended; called after every tick."""
        if self.ended_because:
            return True
        flight, began = self._flight, self._began
        if flight.touched:
            self.ended_because = "contact"
        elif flight.blind_s > self._settings.mission.input_timeout_s:
            self.ended_because = "inputs lost"
        elif flight.battery.is_empty:
            self.ended_because = "battery empty"
        elif flight.navigator.is_home:
            self.ended_because = "way home closed" if flight.navigator.homing.is_closed else "home"
        elif _is_critical(flight, self._settings):
            self.ended_because = "landed on the way: battery"
        elif flight.vehicle.pose.t_s - began.began_s > self._limit_s():
            self.ended_because = "landed on the way: time"
        if self.ended_because:
            self._land()
        return bool(self.ended_because)

    def stop(self, why: str) -> None:
        """All ways home end here."""
        if not self.ended_because:
            self.ended_because = why
            self._land()

    def _land(self) -> None:
        flight = self._flight
        to_go_m = flight.navigator.homing.off_home_m(flight.home_pose())
        left_percent = flight.battery.left_percent - LANDING_S * flight.battery.percent_per_s
        self._came = Came(flight.vehicle.pose, flight.vehicle.path_m, to_go_m, left_percent)

    def score(self) -> dict[str, object]:
        """The figures of ``home`` in `summary.json`."""
        if self._came is None:
            return {"ended_because": self.ended_because, "arrived": False}
        flight, began, came = self._flight, self._began, self._came
        off_m = math.dist((came.pose.x_m, came.pose.y_m), (self._start.x_m, self._start.y_m))
        has_battery = flight.battery.told_percent is not None
        return {
            "ended_because": self.ended_because,
            "arrived": self.ended_because == "home" and off_m <= ARRIVED_M,
            "off_m": round(off_m, 3),
            "off_by_its_own_account_m": _rounded(came.to_go_m),
            "off_unsure_m": round(flight.navigator.homing.unsure_m, 3),
            "time_s": round(came.pose.t_s - began.began_s, 2),
            "way_m": None if began.way is None else round(began.way.length_m, 2),
            "promised_s": None if began.way is None else round(began.way.time_s, 1),
            "flown_m": round(came.path_m - began.path_m, 2),
            "lands_elsewhere": flight.navigator.homing.lands_elsewhere,
            "places_recognised": flight.navigator.homing.matches,
            "promised_percent": None if began.promised_percent is None else round(began.promised_percent, 1),
            "came_percent": round(came.left_percent, 1) if has_battery else None,
        }

    def _limit_s(self) -> float:
        way, limit_s = self._began.way, self._settings.mission.time_limit_s
        return limit_s if way is None else min(limit_s, way.longest_s)


def _is_critical(flight: Flight, settings: Settings) -> bool:
    told_percent = flight.battery.told_percent
    return told_percent is not None and told_percent < settings.spent_percent


def _rounded(value: float) -> float | None:
    return round(value, 3) if math.isfinite(value) else None
