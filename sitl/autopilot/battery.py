"""A battery that empties with the time in the air."""

from __future__ import annotations

CELLS = 4
_FULL_V, _EMPTY_V = 4.2, 3.4
_IDLE_SHARE = 0.05
"""Of the power of flight, what the electronics need on the ground."""


class Battery:
    """A linear battery.

    Args:
        percent: charge at the start.
        minutes: of flight from full to empty.
    """

    def __init__(self, percent: float = 100.0, minutes: float = 15.0) -> None:
        self.percent = percent
        self._percent_per_s = 100.0 / (60.0 * minutes)

    @property
    def cell_v(self) -> float:
        """Voltage of one cell."""
        return _EMPTY_V + (_FULL_V - _EMPTY_V) * self.percent / 100.0

    @property
    def voltage_v(self) -> float:
        """Voltage of all cells."""
        return CELLS * self.cell_v

    def step(self, dt_s: float, flying: bool) -> None:
        """Drains for ``dt_s``."""
        share = 1.0 if flying else _IDLE_SHARE
        self.percent = max(0.0, self.percent - share * self._percent_per_s * dt_s)
