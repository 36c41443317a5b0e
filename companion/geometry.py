"""Rotations between the camera, the body and the world, in the conventions of `companion.model`."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from companion.model import Camera, Pose

_VERTICAL = 1e-7
"""What looks within this of the vertical, in rad, has no heading that could be told from rounding."""


def rotation(yaw_rad: float, pitch_rad: float, roll_rad: float) -> NDArray[np.float64]:
    """The (3, 3) matrix Rz(yaw)·Ry(pitch)·Rx(roll), from a rotated forward-left-up frame to the frame about it."""
    cy, sy = math.cos(yaw_rad), math.sin(yaw_rad)
    cp, sp = math.cos(pitch_rad), math.sin(pitch_rad)
    cr, sr = math.cos(roll_rad), math.sin(roll_rad)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def quaternion(yaw_rad: float, pitch_rad: float, roll_rad: float) -> tuple[float, float, float, float]:
    """The unit quaternion (w, x, y, z) of the same rotation, in MAVLink's order."""
    cy, sy = math.cos(yaw_rad / 2.0), math.sin(yaw_rad / 2.0)
    cp, sp = math.cos(pitch_rad / 2.0), math.sin(pitch_rad / 2.0)
    cr, sr = math.cos(roll_rad / 2.0), math.sin(roll_rad / 2.0)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


def angles_of(quaternion: Sequence[float]) -> tuple[float, float, float] | None:
    """Yaw, pitch and roll in rad of a quaternion (w, x, y, z), as `angles_of_rotation` has them.

    None when the four numbers are no rotation.
    """
    matrix = rotation_of(quaternion)
    return None if matrix is None else angles_of_rotation(matrix)


def rotation_of(quaternion: Sequence[float]) -> NDArray[np.float64] | None:
    """The (3, 3) matrix of a quaternion (w, x, y, z); None when the four numbers are no rotation."""
    norm = math.sqrt(sum(part * part for part in quaternion))
    if not 0.5 < norm < 2.0:  # also refuses NaN
        return None
    w, x, y, z = (part / norm for part in quaternion)
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )


def angles_of_rotation(matrix: NDArray[np.float64]) -> tuple[float, float, float]:
    """Yaw, pitch and roll in rad of a (3, 3) rotation matrix: the inverse of `rotation`, also straight up and down.

    There only the sum or the difference of yaw and roll means something, and roll is 0.
    """
    level = math.hypot(matrix[0, 0], matrix[1, 0])
    pitch_rad = math.atan2(-matrix[2, 0], level)
    if level < _VERTICAL:
        return math.atan2(-matrix[0, 1], matrix[1, 1]), pitch_rad, 0.0
    return math.atan2(matrix[1, 0], matrix[0, 0]), pitch_rad, math.atan2(matrix[2, 1], matrix[2, 2])


def camera_to_world(camera: Camera, pose: Pose) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Rotation (3, 3) and position (3,) of the camera's forward-left-up frame in the world."""
    body = rotation(pose.yaw_rad, pose.pitch_rad, pose.roll_rad)
    mount = np.array([camera.mount_x_m, camera.mount_y_m, camera.mount_z_m])
    position = np.array([pose.x_m, pose.y_m, pose.z_m]) + body @ mount
    return body @ rotation(camera.mount_yaw_rad, camera.mount_pitch_rad, 0.0), position


def camera_to_level(camera: Camera, pose: Pose) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The same, into the levelled body frame: origin at the vehicle, x along the heading, z against gravity."""
    tilt = rotation(0.0, pose.pitch_rad, pose.roll_rad)
    mount = np.array([camera.mount_x_m, camera.mount_y_m, camera.mount_z_m])
    return tilt @ rotation(camera.mount_yaw_rad, camera.mount_pitch_rad, 0.0), tilt @ mount


def pixel_tangents(camera: Camera, pool: int = 1) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Left and up components of pixel rays per unit of depth: (width/pool,), (height/pool,).

    With ``pool`` > 1 for the centres of pool x pool blocks of pixels.
    """
    u = (np.arange(camera.width_px // pool) + 0.5) * pool - 0.5
    v = (np.arange(camera.height_px // pool) + 0.5) * pool - 0.5
    return np.asarray((camera.cx_px - u) / camera.fx_px), np.asarray((camera.cy_px - v) / camera.fy_px)
