"""The intermediate target T_m of R2: where it lies, why it is flown to, and when it has been passed."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass

from companion.model import Pose, wrap_rad


class TargetKind(enum.StrEnum):
    """Why the vehicle flies to a target in R2."""

    TANGENT = "tangent"
    """A tangent point, the paper's rule."""
    WALL = "wall"
    """Our extension: after a full turn in R1 without a tangent, the d_s-offset of the nearest wall."""
    OPEN = "open"
    """Our extension: out of a place without room, away from a boundary followed once round, or from nothing."""


@dataclass(frozen=True, slots=True)
class Target:
    """An intermediate target T_m in the world frame, and the line from where it was chosen."""

    x_m: float
    y_m: float
    from_x_m: float
    from_y_m: float
    since_s: float
    timeout_s: float
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


def world_point(pose: Pose, bearing_rad: float, range_m: float) -> tuple[float, float]:
    """A point given in polar coordinates about the vehicle, in the world frame, in m."""
    direction_rad = pose.yaw_rad + bearing_rad
    return pose.x_m + range_m * math.cos(direction_rad), pose.y_m + range_m * math.sin(direction_rad)
