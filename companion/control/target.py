"""The intermediate target T_m of R2: where it lies, why it is flown to, and when it has been passed."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass

from companion.model import Pose, wrap_rad

NEARER_M = 0.1
"""What counts as having come nearer: more than an estimate wanders while the vehicle stands."""


class TargetKind(enum.StrEnum):
    """Why the vehicle flies to a target in R2."""

    TANGENT = "tangent"
    """A tangent point, the paper's rule."""
    WALL = "wall"
    """Our extension: after a full turn in R1 without a tangent, the d_s-offset of the nearest wall."""
    KNOWN = "known"
    """A place on known ground, on the way to what has not been seen."""
    OPEN = "open"
    """Our extension: out of a place without room, away from a boundary followed once round, or from nothing."""


@dataclass(frozen=True, slots=True)
class Target:
    """An intermediate target T_m in the world frame, and the line from where it was chosen.

    Attributes:
        x_m, y_m: where it is.
        from_x_m, from_y_m: where it was chosen.
        kind: why it is flown to.
    """

    x_m: float
    y_m: float
    from_x_m: float
    from_y_m: float
    kind: TargetKind

    def bearing_rad(self, pose: Pose) -> float:
        """Where it lies from the vehicle, in [-π, π)."""
        return wrap_rad(math.atan2(self.y_m - pose.y_m, self.x_m - pose.x_m) - pose.yaw_rad)

    def is_reached(self, pose: Pose, radius_m: float) -> bool:
        """Whether the vehicle is within that radius of it, or has passed it beside."""
        to_go_x_m, to_go_y_m = self.x_m - pose.x_m, self.y_m - pose.y_m
        along_x_m, along_y_m = self.x_m - self.from_x_m, self.y_m - self.from_y_m
        passed = to_go_x_m * along_x_m + to_go_y_m * along_y_m <= 0.0
        return passed or math.hypot(to_go_x_m, to_go_y_m) < radius_m


class Progress:
    """Whether a target is still coming nearer: slowly is well, not at all is not.

    Args:
        patience_s: so long nothing need have brought it nearer.
    """

    def __init__(self, patience_s: float) -> None:
        self._patience_s = patience_s
        self._least_m = math.inf
        self._since_s = -math.inf

    def begin(self, target: Target, t_s: float) -> None:
        """A new target, chosen at ``t_s``."""
        self._least_m = math.hypot(target.x_m - target.from_x_m, target.y_m - target.from_y_m)
        self._since_s = t_s

    def has_ended(self, target: Target, pose: Pose, t_s: float) -> bool:
        """Whether it has not come nearer for too long; called with every pose on the way to it."""
        to_go_m = math.hypot(target.x_m - pose.x_m, target.y_m - pose.y_m)
        if to_go_m < self._least_m - NEARER_M:
            self._least_m, self._since_s = to_go_m, t_s
        return t_s - self._since_s > self._patience_s


def world_point(pose: Pose, bearing_rad: float, range_m: float) -> tuple[float, float]:
    """A point given in polar coordinates about the vehicle, in the world frame, in m."""
    direction_rad = pose.yaw_rad + bearing_rad
    return pose.x_m + range_m * math.cos(direction_rad), pose.y_m + range_m * math.sin(direction_rad)
