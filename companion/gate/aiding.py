"""Whether something still tells the autopilot where it is, by its own words: its figures of merit, its GPS. Pure.

An estimator goes on for seconds without: ArduCopter says for 7 s that all is well while it drifts at 0.1 to 0.17 m/s.
What it says first is nothing: its figures of merit stand still, the receiver falls silent.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from companion.mavlink.firmware import AutopilotKind

FIX_3D = 3
"""GPS_FIX_TYPE from which on there is a position."""
FIGURES = {
    AutopilotKind.PX4: ("vel_ratio", "pos_horiz_ratio"),
    AutopilotKind.ARDUPILOT: ("velocity_variance", "pos_horiz_variance"),
}
"""How far the newest measurement was from what the estimator expected, in the message in which each firmware says so:
they change with every measurement that comes."""


class Aiding:
    """Takes what passes through the gate.

    Attributes:
        gps_s: when a position fix last came; -inf: never in this flight.
        gps_fix: the newest GPS_FIX_TYPE.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """A new flight: what never came in it cannot be missed."""
        self.gps_s = -math.inf
        self.gps_fix = 0
        self._figures: tuple[float | None, ...] | None = None
        self._figures_s = self._changed_s = -math.inf

    def on_gps(self, fields: Mapping[str, Any], now_s: float) -> None:
        """One GPS_RAW_INT."""
        self.gps_fix = fields["fix_type"]
        if self.gps_fix >= FIX_3D:
            self.gps_s = now_s

    def on_estimator(self, kind: AutopilotKind, fields: Mapping[str, Any], now_s: float) -> None:
        """One ESTIMATOR_STATUS or EKF_STATUS_REPORT."""
        # PX4 says NaN where nothing is measured; no NaN is equal to another, and each would pass for news.
        figures = tuple(None if math.isnan(fields[name]) else fields[name] for name in FIGURES[kind])
        if figures != self._figures:
            self._figures, self._changed_s = figures, now_s
        self._figures_s = now_s

    def figures_stand_for_s(self) -> float:
        """For how long the estimator's figures of merit have come unchanged."""
        return self._figures_s - self._changed_s if math.isfinite(self._changed_s) else 0.0
