"""Where on its way out the vehicle is, though its position has drifted since: by the walls that it sees. Pure."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from companion.control.homing.keyframes import Keyframe, Keyframes, walls_m
from companion.control.homing.matching import Match, match
from companion.control.known_ground import Place
from companion.control.recognition import DRIFT_SHARE, MOST_M
from companion.model import Measurement, Pose, wrap_rad

PERIOD_S = 0.5
"""Time between two comparisons: meanwhile the position drifts by a centimetre."""

NEAR_M, SPAN_M = 5.0, 12.0
"""Looks are compared with that were made so near, on one piece of the way that is no longer than that."""

LOOK_M = 6.0
"""Walls in view further than that are not compared: the noise of depth grows with the square of the distance."""

LEAST_POINTS, LEAST_SHARE = 30, 0.55
"""A place is recognised by so many points of walls, so much of which lies on known walls."""

CLEARLY_SHARE, CLEARLY_BY = 0.4, 0.1
"""Where walls tell a place so clearly, less of them is enough: the way out saw it from elsewhere, and noise takes its
part. Of 133 comparisons with the oldest looks in four missions, the 20 that were as clear were right to 0.11 m."""

REACH_M, REACH_RAD = 0.3, math.radians(4.0)
"""So far it may be off at each comparison, and by the drift of the way since walls last told the place."""

TOLD_BY, CLOSE_BY_M = 0.05, 0.4
"""Walls tell a place when so much less of them agrees beside it; along a smooth drift they do not. What they tell to be
further off has to be told clearly: somewhere along metres of rough walls a little more agrees by chance."""


class Alignment:
    """From the position as the autopilot has it now to where that place was on the way out.

    The oldest looks that are near count: with each that is recognised the vehicle is where it is by the position of a
    time when that had drifted less, at last by that of the start.

    Args:
        keyframes: the looks of the way out.
    """

    def __init__(self, keyframes: Keyframes) -> None:
        self._keyframes = keyframes
        self._turn_rad, self._x_m, self._y_m, self._z_m = 0.0, 0.0, 0.0, 0.0
        self._reference_way_m = self._told_way_m = keyframes.way_m
        self._next_s = -math.inf
        self._last: Pose | None = None
        self._since_m = 0.0
        self.matches = 0
        """How often a place was recognised."""

    @property
    def unsure_m(self) -> float:
        """How far it may be off, beside what it says itself: by the drift of all the way since walls last told a place.

        And of the way out from home to that place, which is how far apart the two were known to be then.
        """
        return DRIFT_SHARE * (self._told_way_m + self._since_m)

    def pose(self, pose: Pose) -> Pose:
        """Where the vehicle is, by the position of the way out."""
        cos, sin = math.cos(self._turn_rad), math.sin(self._turn_rad)
        return replace(
            pose,
            x_m=cos * pose.x_m - sin * pose.y_m + self._x_m,
            y_m=sin * pose.x_m + cos * pose.y_m + self._y_m,
            z_m=pose.z_m + self._z_m,
            yaw_rad=wrap_rad(pose.yaw_rad + self._turn_rad),
            vx_mps=cos * pose.vx_mps - sin * pose.vy_mps,
            vy_mps=sin * pose.vx_mps + cos * pose.vy_mps,
        )

    def update(self, measurement: Measurement, pose: Pose, t_s: float) -> bool:
        """Compare what is in view with what was; whether the vehicle turned out to be elsewhere.

        Args:
            measurement: of now.
            pose: by the autopilot's position.
            t_s: now; more often than `PERIOD_S` nothing is compared.
        """
        if self._last is not None:
            self._since_m += math.hypot(pose.x_m - self._last.x_m, pose.y_m - self._last.y_m)
        self._last = pose
        if t_s < self._next_s or measurement.h_m is None:
            return False
        self._next_s = t_s + PERIOD_S
        here = self.pose(pose)
        look_m = walls_m(measurement, here)
        look_m = look_m[np.hypot(look_m[:, 0] - here.x_m, look_m[:, 1] - here.y_m) < LOOK_M]
        near = self._keyframes.near(Place.under(here, measurement.h_m), NEAR_M)
        if len(look_m) < LEAST_POINTS or not near:
            return False
        for piece in self._pieces(near):
            drifted_m = DRIFT_SHARE * (abs(self._told_way_m - piece[0].way_m) + self._since_m)
            reach_m = min(REACH_M + drifted_m, MOST_M)
            known_m = np.concatenate([look.walls_m for look in piece])
            if len(known_m) == 0:
                continue
            found = match(look_m, (here.x_m, here.y_m), known_m, reach_m, REACH_RAD)
            if found.share >= LEAST_SHARE or (found.share >= CLEARLY_SHARE and found.better_by >= CLEARLY_BY):
                is_close_by = math.hypot(found.x_m, found.y_m) <= CLOSE_BY_M
                is_told = found.better_by >= (TOLD_BY if is_close_by else CLEARLY_BY)
                self._take(found if is_told else found.across(), piece, here, measurement.h_m)
                if is_told:
                    # Along a smooth drift nobody knows it, and all that it drifted since it was told counts on.
                    self._told_way_m, self._since_m = self._reference_way_m, 0.0
                return True
        return False

    def _pieces(self, near: list[Keyframe]) -> list[list[Keyframe]]:
        """The oldest piece of the way out that is near, then that on which the vehicle was last."""
        oldest = [look for look in near if look.way_m <= near[0].way_m + SPAN_M]
        present = [look for look in near if abs(look.way_m - self._reference_way_m) <= SPAN_M / 2.0]
        return [oldest] if not present or present[0] is oldest[0] else [oldest, present]

    def _take(self, found: Match, piece: list[Keyframe], here: Pose, h_m: float) -> None:
        cos, sin = math.cos(found.turn_rad), math.sin(found.turn_rad)
        x_m, y_m = self._x_m - here.x_m, self._y_m - here.y_m
        self._x_m = cos * x_m - sin * y_m + here.x_m + found.x_m
        self._y_m = sin * x_m + cos * y_m + here.y_m + found.y_m
        self._turn_rad = wrap_rad(self._turn_rad + found.turn_rad)
        at_x_m, at_y_m = here.x_m + found.x_m, here.y_m + found.y_m
        nearest = min(piece, key=lambda look: math.hypot(look.place.x_m - at_x_m, look.place.y_m - at_y_m))
        if math.hypot(nearest.place.x_m - at_x_m, nearest.place.y_m - at_y_m) <= 1.5:
            self._z_m += nearest.place.ground_m - (here.z_m - h_m)
        self._reference_way_m = nearest.way_m
        self.matches += 1
