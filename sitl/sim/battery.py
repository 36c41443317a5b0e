"""The battery of a simulated vehicle, as its autopilot tells of it: in whole percents."""

from __future__ import annotations

import math

from companion.config.sim import BatterySettings


class Battery:
    """Drains evenly in flight.

    Args:
        settings: how long it lasts, and what is wrong with it.
    """

    def __init__(self, settings: BatterySettings) -> None:
        self.left_percent = settings.percent
        """The truth."""
        self._settings = settings
        self._flown_s = 0.0

    @property
    def told_percent(self) -> float | None:
        """What the autopilot says; None where the simulation has no battery."""
        return None if self._settings.minutes is None else float(math.floor(self.left_percent))

    @property
    def is_empty(self) -> bool:
        """Whether it has no more to fly with."""
        return self.left_percent <= 0.0

    def step(self, dt_s: float) -> None:
        """It flies for so long."""
        self._flown_s += dt_s
        self.left_percent -= self.percent_per_s * dt_s

    @property
    def percent_per_s(self) -> float:
        """What flying takes now."""
        settings = self._settings
        if settings.minutes is None:
            return 0.0
        is_worn = settings.worn_after_s is not None and self._flown_s >= settings.worn_after_s
        return (settings.worn_factor if is_worn else 1.0) * 100.0 / (60.0 * settings.minutes)
