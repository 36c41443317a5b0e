"""How much of the battery will be left at home, by the real way there, the real speed and the measured drain. Pure."""

from __future__ import annotations

from collections import deque

import numpy as np

LANDING_S = 30.0
"""From arriving at home to the ground: turning, settling, sinking from H at the autopilot's landing speed."""

OBSERVED_S, LEAST_S, LEAST_PERCENT = 180.0, 30.0, 2.0
"""The drain is that of the last minutes, once so much time and charge have gone: autopilots tell whole percents."""

SAMPLE_S = 1.0


class Charge:
    """What is left, by whatever can be believed: the smaller of what the percent and the voltage say.

    ArduPilot counts its percent from 100 at each boot, whatever was plugged in; the voltage ends at the same place with
    every battery, which is why it is believed where its end is configured.

    Args:
        low_v: at which the battery counts as empty (``mission.battery_low_v``); None: the voltage is not judged.
    """

    def __init__(self, low_v: float | None) -> None:
        self._low_v = low_v
        self._first_v: float | None = None

    def percent(self, percent: float | None, voltage_v: float | None) -> float | None:
        """From 0 to 100; None while nobody says."""
        by_voltage: float | None = None
        if self._low_v is not None and voltage_v is not None:
            if self._first_v is None and voltage_v > self._low_v:
                self._first_v = voltage_v
            if self._first_v is not None:
                by_voltage = 100.0 * (voltage_v - self._low_v) / (self._first_v - self._low_v)
        known = [value for value in (percent, by_voltage) if value is not None]
        return min(100.0, max(0.0, min(known))) if known else None


class Reserve:
    """Says when it is time to turn back.

    Args:
        share_percent: what shall be left on arrival (``mission.reserve_percent``).

    Attributes:
        left_percent: what would be left at home if it turned back now; None while drain or way are not known.
        drain_percent_per_s: of the last minutes; None while it is not known.
    """

    def __init__(self, share_percent: float) -> None:
        self.left_percent: float | None = None
        self.drain_percent_per_s: float | None = None
        self._share_percent = share_percent
        self._samples: deque[tuple[float, float]] = deque(maxlen=round(OBSERVED_S / SAMPLE_S) + 1)

    def update(self, t_s: float, charge_percent: float | None, way_home_s: float | None) -> None:
        """Take what is known now; called every second or two.

        Args:
            t_s: now.
            charge_percent: what is left, `Charge.percent`.
            way_home_s: how long the way home takes.
        """
        if charge_percent is None:
            self.left_percent = None
            return
        if not self._samples or t_s - self._samples[-1][0] >= SAMPLE_S:
            self._samples.append((t_s, charge_percent))
        self.drain_percent_per_s = self._drain()
        if self.drain_percent_per_s is None or way_home_s is None:
            self.left_percent = None
            return
        self.left_percent = charge_percent - self.drain_percent_per_s * (way_home_s + LANDING_S)

    @property
    def is_due(self) -> bool:
        """Whether less than the reserve would be left at home."""
        return self.left_percent is not None and self.left_percent < self._share_percent

    def _drain(self) -> float | None:
        """Slope of the charge over time; None before enough of both has gone."""
        times_s, percents = np.array(self._samples).T
        if times_s[-1] - times_s[0] < LEAST_S or percents[0] - percents[-1] < LEAST_PERCENT:
            return None
        return max(0.0, -float(np.polyfit(times_s - times_s[0], percents, 1)[0]))
