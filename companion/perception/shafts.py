"""Where there was no ground below: the edge of a shaft, or of a scan. It counts as rock from then on.

The camera looks over it and sees free space, so no look forgets it, unlike the points of the scan memory.
"""

from __future__ import annotations

import math

import numpy as np

from companion.model import HIT, Pose, Scan

APART_M = 0.2
MOST = 256
"""Places that are kept, the newest."""


class Shafts:
    """Places in the odometry's frame.

    Args:
        max_distance_m: further away they do not matter.
    """

    def __init__(self, max_distance_m: float) -> None:
        self._max_distance_m = max_distance_m
        self._places_m = np.empty((0, 2))

    def mark(self, pose: Pose) -> None:
        """There is no ground below this place."""
        if not pose.is_finite_in_plane:
            return
        here = np.array([[pose.x_m, pose.y_m]])
        if len(self._places_m) == 0 or np.hypot(*(self._places_m - here).T).min() >= APART_M:
            self._places_m = np.vstack([self._places_m, here])[-MOST:]

    def recall(self, scan: Scan, pose: Pose) -> None:
        """Put them into ``scan`` as obstacles, in place; they are not fresh."""
        if len(self._places_m) == 0 or not pose.is_finite_in_plane:
            return
        dx_m, dy_m = (self._places_m - [pose.x_m, pose.y_m]).T
        distances_m = np.hypot(dx_m, dy_m)
        bins = scan.bearings_rad.size
        bearings_rad = np.mod(np.arctan2(dy_m, dx_m) - pose.yaw_rad + math.pi, 2.0 * math.pi)
        at = np.minimum(bins - 1, (bearings_rad * bins / (2.0 * math.pi)).astype(np.int64))
        for b, distance_m in zip(at.tolist(), distances_m.tolist(), strict=True):
            if distance_m <= self._max_distance_m and (scan.state[b] != HIT or distance_m < scan.ranges_m[b]):
                scan.ranges_m[b], scan.state[b], scan.fresh[b] = distance_m, HIT, False
