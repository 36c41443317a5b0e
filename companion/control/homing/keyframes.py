"""What is remembered of the way: a look at the walls every metre or so, by which a place is recognised later. Pure.

The position drifts, so what was seen at the beginning of a flight does not lie where the same rock is seen at its end.
Each look is true about the place where it was made; so places are recognised by the looks made there, not by numbers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.control.known_ground import Place
from companion.control.recognition import LEVEL_M
from companion.model import HIT, Measurement, Pose, wrap_rad

STEP_M, TURN_RAD = 1.0, math.radians(40.0)
"""A look is kept after so long a way, or so wide a turn: the camera sees a quarter of what is about."""

SEEN_M = 8.0
"""Walls are kept as far as this: further ones are seen at a slant, and noisy."""

LEVEL_SLOPE = 0.1
"""Ground that rises by more is not landed on where there is a choice."""

MOST = 2048
"""So many looks are kept. Then every other one goes, and they are kept half as often."""

Points = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Keyframe:
    """One look.

    Attributes:
        place: where it was made.
        way_m: how far the vehicle had flown by then.
        walls_m: (n, 2) points of walls in view or remembered, where they lay by the position of then.
        lands: whether the ground there is level, and wide enough to land on.
    """

    place: Place
    way_m: float
    walls_m: Points
    lands: bool


class Keyframes:
    """The looks of one flight, in the order in which they were made.

    Args:
        room_m: a place to land on has nothing nearer than this.
    """

    def __init__(self, room_m: float) -> None:
        self._room_m = room_m
        self.way_m = 0.0
        """How far the vehicle has flown."""
        self._frames: list[Keyframe] = []
        self._places_m = np.zeros((0, 3))
        self._last: Pose | None = None
        self._kept: Pose | None = None
        self._kept_way_m = 0.0
        self._step_m = STEP_M

    @property
    def all(self) -> tuple[Keyframe, ...]:
        """Every look that is kept, oldest first."""
        return tuple(self._frames)

    def fly(self, pose: Pose) -> None:
        """The vehicle has flown here."""
        if self._last is not None:
            self.way_m += math.hypot(pose.x_m - self._last.x_m, pose.y_m - self._last.y_m)
        self._last = pose

    def see(self, measurement: Measurement, pose: Pose) -> None:
        """Keep this look, where the last one that was kept was made far enough away or in another direction."""
        if measurement.scan is None or measurement.h_m is None:
            return
        kept = self._kept
        if (
            kept is not None
            and self.way_m - self._kept_way_m < self._step_m
            and abs(wrap_rad(pose.yaw_rad - kept.yaw_rad)) < TURN_RAD
        ):
            return
        self._kept, self._kept_way_m = pose, self.way_m
        self._frames.append(self._look(measurement, pose))
        if len(self._frames) > MOST:
            self._frames = self._frames[::2]
            self._step_m *= 2.0

    def _look(self, measurement: Measurement, pose: Pose) -> Keyframe:
        slope, d_m = measurement.ground_slope, measurement.d_m
        lands = slope is not None and abs(slope) <= LEVEL_SLOPE and (d_m is None or d_m >= self._room_m)
        here = Place.under(pose, measurement.h_m)
        return Keyframe(here, self.way_m, walls_m(measurement, pose), lands and not measurement.over_shaft)

    def place_after(self, way_m: float) -> Place | None:
        """Where the vehicle was after so much of its way out; None where it did not fly as far."""
        return next((look.place for look in self._frames if look.way_m >= way_m), None)

    def near(self, place: Place, within_m: float) -> list[Keyframe]:
        """The looks made within so much of a place, on its level, oldest first."""
        if len(self._places_m) != len(self._frames):
            self._places_m = np.array([(f.place.x_m, f.place.y_m, f.place.ground_m) for f in self._frames])
        if not self._frames:
            return []
        off_m = np.hypot(self._places_m[:, 0] - place.x_m, self._places_m[:, 1] - place.y_m)
        level = np.abs(self._places_m[:, 2] - place.ground_m) <= LEVEL_M
        return [self._frames[k] for k in np.flatnonzero((off_m <= within_m) & level)]


def walls_m(measurement: Measurement, pose: Pose) -> Points:
    """(n, 2) the walls that are seen or remembered from a pose, in the world's frame."""
    scan = measurement.scan
    if scan is None:
        return np.zeros((0, 2))
    hit = (scan.state == HIT) & (scan.ranges_m < SEEN_M)
    direction_rad = pose.yaw_rad + scan.bearings_rad[hit]
    ranges_m = scan.ranges_m[hit]
    return np.stack([pose.x_m + ranges_m * np.cos(direction_rad), pose.y_m + ranges_m * np.sin(direction_rad)], axis=1)
