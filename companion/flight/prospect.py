"""What is left of the battery, how far home is, and what will be left there: kept up to date while it flies."""

from __future__ import annotations

import math

from companion.autopilot.vehicle_state import VehicleState
from companion.config.settings import Settings
from companion.control.homing.homing import WayHome, longest_s
from companion.control.homing.reserve import Charge, Reserve

PERIOD_S = 1.0
"""Time between two looks: the length of the way costs some milliseconds of the loop that steers."""

UNKNOWN_PERCENT = "battery not known"


class Prospect:
    """The prospect of coming home, from one look after the other.

    Args:
        settings: of the flight.

    Attributes:
        charge_percent: what is left; None while nobody says.
        way: the way home; None where none is known.
    """

    def __init__(self, settings: Settings) -> None:
        self.charge_percent: float | None = None
        self.way: WayHome | None = None
        self._charge = Charge(settings.mission.battery_low_v)
        self._reserve = Reserve(settings.turning_percent)
        self._began_s: float | None = None
        self._next_s = -math.inf

    def is_due(self, now_s: float) -> bool:
        """Whether `look` has something to find out."""
        return now_s >= self._next_s

    def look(self, now_s: float, vehicle: VehicleState, way: WayHome | None) -> None:
        """Take what is known now.

        Args:
            now_s: the time.
            vehicle: the autopilot's last word.
            way: the way home; None where none is known.
        """
        self._began_s = now_s if self._began_s is None else self._began_s
        self._next_s = now_s + PERIOD_S
        self.charge_percent = self._charge.percent(vehicle.battery_percent, vehicle.voltage_v)
        self.way = way
        self._reserve.update(now_s, self.charge_percent, None if way is None else way.time_s)

    @property
    def left_percent(self) -> float | None:
        """What would be left at home, landed, if it went there now; None while that is not known."""
        return self._reserve.left_percent

    @property
    def should_turn_back(self) -> bool:
        """Whether less than the reserve would be left if it turned back any later."""
        return self._reserve.is_due

    def longest_way_s(self, now_s: float) -> float:
        """So long the way home may take; where none is known the time that was flown is what is reckoned for it."""
        if self.way is not None:
            return self.way.longest_s
        return longest_s(0.0 if self._began_s is None else now_s - self._began_s)

    def in_words(self) -> str:
        """For the pilot: how far, and what will be left, as far as it is known."""
        way = "way not known" if self.way is None else f"{self.way.length_m:.0f} m"
        if self.left_percent is not None:
            return f"{way}, {max(0.0, self.left_percent):.0f} % will be left"
        return f"{way}, {UNKNOWN_PERCENT if self.charge_percent is None else f'battery {self.charge_percent:.0f} %'}"
