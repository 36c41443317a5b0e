"""What comes nearer than the position says: by the distances that a sensor measures."""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

from companion.model import wrap_rad
from companion.sides import NOTHING_NEAR, Side

WINDOW_S, LEAST_S, LEAST_LOOKS = 0.8, 0.3, 4
"""A drift is told from so many looks at least, over so much time: with 2 cm of noise it is right to 0.05 m/s."""
NEAR_M = 3.0
"""What is further away does not matter yet, and is measured with more noise."""
STEP_M = 0.25
"""Two looks that differ by more saw two things, or the position leapt: an edge came in between."""
TURNED_RAD = 0.06
"""A wall that is seen askew seems to come nearer when the vehicle turns: after more than this nothing is told."""
FASTEST_MPS, ROUGH_M = 0.7, 0.05
"""No position of ours errs faster, and what drifts does so steadily: else another surface came into the beam."""
STALE_S = 0.5


class _Look(NamedTuple):
    t_s: float
    distance_m: float
    yaw_rad: float
    place_m: float
    """Where what was seen stands, on a line towards it, by the vehicle's own position: the same as long as that is
    right."""


class Approach:
    """The newest distances of one sensor to one side of the body.

    Args:
        towards_rad: the bearing of that side.
    """

    def __init__(self, towards_rad: float) -> None:
        self._towards_rad = towards_rad
        self._looks: deque[_Look] = deque()
        self._at_m = (0.0, 0.0)
        self._drift_mps = 0.0

    def see(self, t_s: float, distance_m: float, at_m: tuple[float, float], yaw_rad: float) -> None:
        """One look; the same one again, or an older one, says nothing.

        Args:
            t_s: when it was made.
            distance_m: to what is nearest there; infinite when nothing is.
            at_m: where the vehicle was then, in the world frame.
            yaw_rad: its heading.
        """
        looks = self._looks
        if looks and t_s <= looks[-1].t_s:
            return
        if not (all(map(math.isfinite, (t_s, yaw_rad, *at_m))) and 0.0 <= distance_m <= NEAR_M):
            looks.clear()
        else:
            direction_rad = yaw_rad + self._towards_rad
            moved_m = 0.0
            if looks:
                moved_m = (at_m[0] - self._at_m[0]) * math.cos(direction_rad)
                moved_m += (at_m[1] - self._at_m[1]) * math.sin(direction_rad)
                moved_m += looks[-1].place_m - looks[-1].distance_m
                if abs(distance_m + moved_m - looks[-1].place_m) > STEP_M:
                    looks.clear()
                    moved_m = 0.0
            looks.append(_Look(t_s, distance_m, yaw_rad, distance_m + moved_m))
            while t_s - looks[0].t_s > WINDOW_S or abs(wrap_rad(yaw_rad - looks[0].yaw_rad)) > TURNED_RAD:
                looks.popleft()
        self._at_m = at_m
        self._drift_mps = self._slope_mps()

    def side(self, t_s: float, towards_mps: float) -> Side:
        """What there is at ``t_s``: it is taken to have come nearer since the last look.

        Args:
            t_s: now.
            towards_mps: how fast the vehicle flies to that side now, by its own velocity.
        """
        if not self._looks or not 0.0 <= (age_s := t_s - self._looks[-1].t_s) <= STALE_S:
            return NOTHING_NEAR
        closing_mps = towards_mps + max(0.0, self._drift_mps)
        return Side(max(0.0, self._looks[-1].distance_m - max(0.0, closing_mps) * age_s), closing_mps)

    def _slope_mps(self) -> float:
        """The least squares' slope, toward the vehicle; 0 when it cannot be told, or is none of a drift."""
        looks = self._looks
        if len(looks) < LEAST_LOOKS or looks[-1].t_s - looks[0].t_s < LEAST_S:
            return 0.0
        mean_s = sum(look.t_s for look in looks) / len(looks)
        mean_m = sum(look.place_m for look in looks) / len(looks)
        spread = sum((look.t_s - mean_s) ** 2 for look in looks)
        slope_mps = sum((look.t_s - mean_s) * (look.place_m - mean_m) for look in looks) / spread
        off_m = max(abs(look.place_m - mean_m - slope_mps * (look.t_s - mean_s)) for look in looks)
        return -slope_mps if abs(slope_mps) <= FASTEST_MPS and off_m <= ROUGH_M else 0.0


def nearest_of(approaches: list[Approach], t_s: float, towards_mps: float) -> Side:
    """What several sensors say of one side: the least distance, and the fastest that comes nearer."""
    seen = [side for approach in approaches if (side := approach.side(t_s, towards_mps)) != NOTHING_NEAR]
    if not seen:
        return NOTHING_NEAR
    return Side(min(side.distance_m for side in seen), max(side.closing_mps for side in seen))
