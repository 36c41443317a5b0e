"""How near to each other the vehicles of one mine truly come."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations

from companion.control.separation import Spacing
from companion.model import Pose
from sitl.scene.fellows import Body


class Encounters:
    """Watches every pair of vehicles.

    Args:
        body: of each.
        spacing: how far from each other they are to be.
    """

    def __init__(self, body: Body, spacing: Spacing) -> None:
        self.least_apart_m = math.inf
        """From middle to middle."""
        self.too_near_s = 0.0
        """How long any two were nearer than they are to be, in the plane and in height; each pair counts."""
        self.collisions = 0
        """How often two bodies came to touch."""
        self._body = body
        self._spacing = spacing
        self._touching: set[tuple[int, int]] = set()

    def look(self, poses: Sequence[Pose], dt_s: float) -> None:
        """They truly are there, for so long."""
        for pair in combinations(range(len(poses)), 2):
            one, other = poses[pair[0]], poses[pair[1]]
            up_m, beside_m = abs(one.z_m - other.z_m), math.hypot(one.x_m - other.x_m, one.y_m - other.y_m)
            self.least_apart_m = min(self.least_apart_m, math.hypot(up_m, beside_m))
            if up_m < self._spacing.apart_m and beside_m < self._spacing.keep_m:
                self.too_near_s += dt_s
            if not self._body.touches(one, other):
                self._touching.discard(pair)
            elif pair not in self._touching:
                self._touching.add(pair)
                self.collisions += 1
