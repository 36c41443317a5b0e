"""Rotations between the camera, the body and the world, in the conventions of `companion.model`."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from companion.model import Camera, Pose


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
    """The quaternion (w, x, y, z) of the same rotation."""
    cy, sy = math.cos(yaw_rad / 2.0), math.sin(yaw_rad / 2.0)
    cp, sp = math.cos(pitch_rad / 2.0), math.sin(pitch_rad / 2.0)
    cr, sr = math.cos(roll_rad / 2.0), math.sin(roll_rad / 2.0)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


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
