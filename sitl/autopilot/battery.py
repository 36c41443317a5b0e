"""The battery: what is left in it, and what the autopilot can measure of that."""

from __future__ import annotations

_FULL_V, _EMPTY_V = 4.2, 3.4
_IDLE_SHARE = 0.05
"""Of the power of flight, what the electronics need on the ground."""


class Battery:
    """A linear battery.

    Args:
        percent: charge at the start.
        minutes: of flight from full to empty.
        cells: in series.
        capacity_mah: from full to empty.
    """

    def __init__(self, percent: float, minutes: float, cells: int, capacity_mah: float) -> None:
        self.percent = percent
        self.cells = cells
        self.measured_v: float | None = None
        """A voltage that somebody sets, of all cells; ``None``: that of the charge."""
        self._capacity_mah = capacity_mah
        self._booted_percent = percent
        self._percent_per_s = 100.0 / (60.0 * minutes)

    @property
    def voltage_v(self) -> float:
        """Voltage of all cells."""
        if self.measured_v is not None:
            return self.measured_v
        return self.cells * (_EMPTY_V + (_FULL_V - _EMPTY_V) * self.percent / 100.0)

    def percent_of(self, voltage_v: float) -> float:
        """The charge that a voltage of all cells speaks of; below 0 and above 100 beyond its ends."""
        return 100.0 * (voltage_v / self.cells - _EMPTY_V) / (_FULL_V - _EMPTY_V)

    @property
    def counted_percent(self) -> float:
        """What is left by the charge drawn since boot, when whatever was in it then was taken for full."""
        return max(0.0, 100.0 - max(0.0, self._booted_percent - self.percent))

    @property
    def used_mah(self) -> float:
        """Drawn since boot."""
        return max(0.0, self._booted_percent - self.percent) / 100.0 * self._capacity_mah

    def boot(self) -> None:
        """The count begins anew."""
        self._booted_percent = self.percent

    def step(self, dt_s: float, flying: bool) -> None:
        """Drains for ``dt_s``."""
        share = 1.0 if flying else _IDLE_SHARE
        self.percent = max(0.0, self.percent - share * self._percent_per_s * dt_s)
