"""Once round a boundary: whether the vehicle is back where it began to follow the wall."""

from __future__ import annotations

import math

from companion.model import Pose, wrap_rad

LAP_M = 8.0
"""A closed boundary is longer than this: shorter ones are turns on the spot, which have a rule of their own."""

LAP_SETTLED_M = 2.0
"""A lap begins this far into R3, when the vehicle flies along the wall that it came to."""

LAP_CLOSED_M, LAP_CLOSED_RAD = 1.0, math.radians(60.0)
"""The vehicle has come round when it is as near as this to where it began to follow, heading the same way."""


class LapCounter:
    """Tells when the boundary has been followed once round.

    Our extension: a boundary that meets no tangent would be followed for ever, always the same way round, and what the
    camera sees only in the other direction never comes into view. So a whole lap is a decision as well.
    """

    def __init__(self) -> None:
        self._start: Pose | None = None
        self._last: Pose | None = None
        self._flown_m = 0.0

    def begin(self) -> None:
        """Forget the lap under way: the next pose is the first of another."""
        self._start = None

    def has_come_round(self, pose: Pose) -> bool:
        """Whether a lap ends at this pose, which begins the next; called with every pose in R3."""
        if self._start is None or self._last is None:
            self._start, self._flown_m = pose, 0.0
        else:
            self._flown_m += math.hypot(pose.x_m - self._last.x_m, pose.y_m - self._last.y_m)
        self._last = pose
        if self._flown_m < LAP_SETTLED_M:
            # It comes to the wall at any angle, and will not pass here like that again.
            self._start = pose
            return False
        apart_m = math.hypot(pose.x_m - self._start.x_m, pose.y_m - self._start.y_m)
        turned_rad = abs(wrap_rad(pose.yaw_rad - self._start.yaw_rad))
        if self._flown_m < LAP_M or apart_m > LAP_CLOSED_M or turned_rad > LAP_CLOSED_RAD:
            return False
        self._start, self._flown_m = pose, LAP_SETTLED_M
        return True
