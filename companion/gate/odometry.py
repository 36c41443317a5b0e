"""Whether the odometry that passes through the gate is still worth to be believed. Pure.

An autopilot believes what it is told. Told the same place again and again, both ran away at 1.5 m/s and more while they
said to stand; told of a leap that nobody had announced, PX4 flew after it. Without odometry they brake, and land.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

FASTEST_MPS = 3.0
"""No vehicle of ours flies faster: what is further away than this leads is a leap."""

Place = tuple[float, float, float]


class Odometry:
    """Takes ODOMETRY and VISION_POSITION_ESTIMATE on their way to the autopilot.

    Args:
        jump_m: a place this far beyond where any flight leads is a leap, unless the tracker says that it begins anew.

    Attributes:
        fresh_s: when one last came that can be believed; -inf: none in this flight.
    """

    def __init__(self, jump_m: float) -> None:
        self._jump_m = jump_m
        self.reset()

    def reset(self) -> None:
        """A new flight: what never came in it cannot be missed."""
        self.fresh_s = -math.inf
        self._places_m: dict[str, Place] = {}
        self._frame = 0
        self._came_s = -math.inf
        self._repeats = self._leapt = False

    @property
    def believed(self) -> bool:
        """Whether the newest can be: it says something new, and leads from where the one before it was."""
        return not (self._repeats or self._leapt)

    def on_place(self, name: str, fields: Mapping[str, Any], now_s: float) -> None:
        """One of them came; one that is no number is as one that did not. A tracker may say the same in each way."""
        x_m, y_m, z_m = fields["x"], fields["y"], fields["z"]
        place_m: Place = (x_m, y_m, z_m)
        frame: int = fields["reset_counter"]
        if not all(map(math.isfinite, place_m)):
            self._repeats = True
            return
        before_m = self._places_m.get(name)
        if before_m is not None:
            self._repeats = place_m == before_m
            far_m = self._jump_m + FASTEST_MPS * (now_s - self._came_s)
            # A leap is not over with the next one: the tracker is lost until it says so itself.
            self._leapt = frame == self._frame and (self._leapt or math.dist(place_m, before_m) > far_m)
        self._places_m[name], self._frame, self._came_s = place_m, frame, now_s
        if self.believed:
            self.fresh_s = now_s
