"""What is left of the battery, how far home is, and what will be left there: kept up to date while it flies."""

from __future__ import annotations

import math

from companion.autopilot.vehicle_state import VehicleState
from companion.config.settings import Settings
from companion.control.homing.reserve import LEAST_MPS, Charge, Reserve
from companion.model import Pose

PERIOD_S = 1.0
"""Time between two looks: the length of the way costs some milliseconds of the loop that steers."""

UNKNOWN_PERCENT = "battery not known"


class Prospect:
    """The prospect of coming home, from one look after the other.

    Args:
        settings: of the flight.

    Attributes:
        charge_percent: what is left; None while nobody says.
        way_m: length of the way home; None where no way is known.
        flown_m: how far it has flown, by its own account.
    """

    def __init__(self, settings: Settings) -> None:
        self.charge_percent: float | None = None
        self.way_m: float | None = None
        self.flown_m = 0.0
        self._charge = Charge(settings.mission.battery_low_v)
        # What the gate lands with is never flown home with.
        self._reserve = Reserve(max(settings.mission.reserve_percent, settings.safety.battery_percent))
        self._began_s: float | None = None
        self._next_s = -math.inf
        self._last: Pose | None = None

    def is_due(self, now_s: float) -> bool:
        """Whether `look` has something to find out."""
        return now_s >= self._next_s

    def look(self, now_s: float, vehicle: VehicleState, pose: Pose | None, way_m: float | None) -> None:
        """Take what is known now.

        Args:
            now_s: the time.
            vehicle: the autopilot's last word.
            pose: of now; None while none is known.
            way_m: length of the way home; None where no way is known.
        """
        self._began_s = now_s if self._began_s is None else self._began_s
        self._next_s = now_s + PERIOD_S
        if pose is not None and pose.is_finite_in_plane:
            if self._last is not None:
                self.flown_m += math.hypot(pose.x_m - self._last.x_m, pose.y_m - self._last.y_m)
            self._last = pose
        self.charge_percent = self._charge.percent(vehicle.battery_percent, vehicle.voltage_v)
        self.way_m = way_m
        self._reserve.update(now_s, self.charge_percent, way_m, self.flown_m)

    @property
    def left_percent(self) -> float | None:
        """What would be left at home, landed, if it went there now; None while that is not known."""
        return self._reserve.left_percent

    @property
    def should_turn_back(self) -> bool:
        """Whether less than the reserve would be left if it turned back any later."""
        return self._reserve.is_due

    def longest_way_s(self, now_s: float, factor: float, more_s: float) -> float:
        """So long the way home may take: its time at the speed flown so far, by a factor, and some more.

        Where no way is known it is the one that was flown.
        """
        flown_s = 0.0 if self._began_s is None else now_s - self._began_s
        speed_mps = max(LEAST_MPS, self.flown_m / flown_s if flown_s > 0.0 else 0.0)
        return factor * (self.flown_m if self.way_m is None else self.way_m) / speed_mps + more_s

    def in_words(self) -> str:
        """For the pilot: how far, and what will be left, as far as it is known."""
        way = "way not known" if self.way_m is None else f"{self.way_m:.0f} m"
        if self.left_percent is not None:
            return f"{way}, {max(0.0, self.left_percent):.0f} % will be left"
        return f"{way}, {UNKNOWN_PERCENT if self.charge_percent is None else f'battery {self.charge_percent:.0f} %'}"
