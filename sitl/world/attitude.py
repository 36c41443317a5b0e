"""From a quaternion (w, x, y, z) to the angles of Rz(yaw)·Ry(pitch)·Rx(roll), and what follows from these angles."""

from __future__ import annotations

import math
from collections.abc import Sequence

from companion.frames import NedPose
from companion.geometry import rotation

Triple = tuple[float, float, float]


def angles_of(quaternion: Sequence[float]) -> Triple | None:
    """Roll, pitch and yaw in rad; None when the four numbers are no rotation."""
    w, x, y, z = quaternion
    norm = math.sqrt(w * w + x * x + y * y + z * z)
    if not 0.5 < norm < 2.0:  # also refuses NaN
        return None
    w, x, y, z = w / norm, x / norm, y / norm, z / norm
    roll_rad = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch_rad = math.asin(max(-1.0, min(1.0, 2.0 * (w * y - z * x))))
    yaw_rad = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return roll_rad, pitch_rad, yaw_rad


def yaw_rate_of(roll_rad: float, pitch_rad: float, pitch_speed_radps: float, yaw_speed_radps: float) -> float:
    """How fast the heading turns, in rad/s, from the rates about the body's own axes."""
    level = max(math.cos(pitch_rad), 0.1)  # nose straight up or down there is no heading
    return (math.sin(roll_rad) * pitch_speed_radps + math.cos(roll_rad) * yaw_speed_radps) / level


def body_velocity(ned: NedPose) -> Triple:
    """The velocity along the body's forward, right and down axes, in m/s."""
    turn = rotation(ned.yaw_rad, ned.pitch_rad, ned.roll_rad)
    forward, right, down = turn.T @ (ned.v_north_mps, ned.v_east_mps, ned.v_down_mps)
    return float(forward), float(right), float(down)
