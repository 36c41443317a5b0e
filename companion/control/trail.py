"""The way back out: where the vehicle came from, followed backward when it has lost the ground. Pure.

Over the edge of a shaft there is no height to hold, and nothing below to land on. Where the vehicle came from there was
ground, and room for the body: so it goes back there, as it stands, without turning round.
"""

from __future__ import annotations

import math
from collections import deque

from companion.model import Pose

STEP_M, STEPS = 0.1, 30
"""A place is kept every decimetre, for three metres."""
BACK_M = 1.0
"""So far it goes back: further than it went on while it braked, and then d_s from where the ground was lost."""
BACK_MPS = 0.2
AHEAD_MPS = 0.08
"""Where the way back leads ahead, as the vehicle has turned meanwhile: slower than what the gate takes for closing. The
place where the ground was lost counts as rock and is right before it, or below; the gate would stop it there."""
THERE_M = 0.12


class Trail:
    """The last metres of the way, and the going back along them."""

    def __init__(self) -> None:
        self._places: deque[tuple[float, float]] = deque(maxlen=STEPS)
        self._from: tuple[float, float] | None = None

    def note(self, pose: Pose) -> None:
        """The vehicle flies here, and all is well."""
        here = pose.x_m, pose.y_m
        if not self._places or math.dist(here, self._places[-1]) >= STEP_M:
            self._places.append(here)

    def begin(self, pose: Pose) -> None:
        """The ground is lost: from now on back, until it has gone `BACK_M`."""
        if self._from is None:
            self._from = pose.x_m, pose.y_m

    def back_mps(self, pose: Pose) -> tuple[float, float] | None:
        """Forward and left; None when it need not go back, has done so, or knows no way further."""
        here = pose.x_m, pose.y_m
        if self._from is None:
            return None
        while self._places and (
            math.dist(here, self._places[-1]) < THERE_M
            or (len(self._places) > 1 and math.dist(here, self._places[-2]) < math.dist(here, self._places[-1]))
        ):
            self._places.pop()
        if not self._places or math.dist(here, self._from) >= BACK_M:
            self._from = None
            return None
        to_x_m, to_y_m = self._places[-1][0] - pose.x_m, self._places[-1][1] - pose.y_m
        bearing_rad = math.atan2(to_y_m, to_x_m) - pose.yaw_rad
        cos, sin = math.cos(bearing_rad), math.sin(bearing_rad)
        speed_mps = BACK_MPS if BACK_MPS * cos <= AHEAD_MPS else AHEAD_MPS / cos
        return speed_mps * cos, speed_mps * sin
