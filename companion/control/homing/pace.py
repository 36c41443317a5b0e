"""How long a way takes, by the speed that was really flown on such ways. Pure."""

from __future__ import annotations

import math

from companion.control.informed import Route
from companion.control.parameters import Parameters
from companion.model import Pose

LEAST_S, FIRST_SHARE = 10.0, 0.7
"""Straights of so long tell how fast they are flown; before that this share of the speed asked for is counted on."""

TURN_SHARE = 0.6
"""Of the largest yaw rate, which a turn on the spot takes in the mean."""

SETTLE_S = 6.0
"""For coming to stand at home."""

FORGETS_S = 300.0
"""What was flown so long ago counts a third of what is flown now."""


class Pace:
    """The speed on straights, as it was really flown.

    Args:
        parameters: the law's settings.
    """

    def __init__(self, parameters: Parameters) -> None:
        self._first_mps = FIRST_SHARE * parameters.speed_mps
        self._turn_radps = TURN_SHARE * parameters.max_yaw_rate_radps
        self._last: Pose | None = None
        self._time_s, self._flown_m, self._weighed = 0.0, 0.0, 0.0

    @property
    def speed_mps(self) -> float:
        """Of the straights so far, by the way and not by the time: on a long way little time goes into starting."""
        known = self._time_s >= LEAST_S and self._flown_m > 0.0
        return self._weighed / self._flown_m if known else self._first_mps

    def note(self, pose: Pose, straight: bool) -> None:
        """With every pose; whether it flies straight to somewhere."""
        last, self._last = self._last, pose
        if not straight or last is None or not 0.0 < pose.t_s - last.t_s < 1.0:
            return
        step_s, step_m = pose.t_s - last.t_s, math.hypot(pose.vx_mps, pose.vy_mps) * (pose.t_s - last.t_s)
        keep = math.exp(-step_s / FORGETS_S)
        self._time_s = keep * self._time_s + step_s
        self._flown_m = keep * self._flown_m + step_m
        self._weighed = keep * self._weighed + step_m * step_m / step_s

    def takes_s(self, route: Route) -> float:
        """How long a way takes."""
        return route.length_m / max(self.speed_mps, 1e-3) + route.turn_rad / self._turn_radps + SETTLE_S
