"""The only file that negates an axis: ENU/FLU (ours) to and from NED/FRD (MAVLink), and from axes of images."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.model import Pose, Setpoint, wrap_rad


@dataclass(frozen=True, slots=True)
class NedPose:
    """A pose in MAVLink's frames: north-east-down, yaw clockwise from north, attitude forward-right-down."""

    t_s: float
    north_m: float
    east_m: float
    down_m: float
    roll_rad: float
    pitch_rad: float
    yaw_rad: float
    v_north_mps: float
    v_east_mps: float
    v_down_mps: float
    yaw_rate_radps: float


@dataclass(frozen=True, slots=True)
class BodyVelocity:
    """The velocity fields of SET_POSITION_TARGET_LOCAL_NED in a body frame: forward-right-down, yaw clockwise."""

    vx_mps: float
    vy_mps: float
    vz_mps: float
    yaw_rate_radps: float


def pose_to_ned(pose: Pose) -> NedPose:
    """ENU/FLU to NED/FRD. East and north swap, up turns down, and yaw counts from north instead of east."""
    return NedPose(
        t_s=pose.t_s,
        north_m=pose.y_m,
        east_m=pose.x_m,
        down_m=-pose.z_m,
        roll_rad=pose.roll_rad,
        pitch_rad=-pose.pitch_rad,
        yaw_rad=wrap_rad(math.pi / 2.0 - pose.yaw_rad),
        v_north_mps=pose.vy_mps,
        v_east_mps=pose.vx_mps,
        v_down_mps=-pose.vz_mps,
        yaw_rate_radps=-pose.yaw_rate_radps,
    )


def pose_from_ned(ned: NedPose) -> Pose:
    """NED/FRD to ENU/FLU, the inverse of `pose_to_ned`."""
    return Pose(
        t_s=ned.t_s,
        x_m=ned.east_m,
        y_m=ned.north_m,
        z_m=-ned.down_m,
        yaw_rad=wrap_rad(math.pi / 2.0 - ned.yaw_rad),
        roll_rad=ned.roll_rad,
        pitch_rad=-ned.pitch_rad,
        vx_mps=ned.v_east_mps,
        vy_mps=ned.v_north_mps,
        vz_mps=-ned.v_down_mps,
        yaw_rate_radps=-ned.yaw_rate_radps,
    )


def setpoint_to_frd(setpoint: Setpoint) -> BodyVelocity:
    """A setpoint as MAVLink's body velocity: climbing is a negative vz, to the left a negative vy and yaw rate."""
    return BodyVelocity(
        vx_mps=setpoint.speed_mps,
        vy_mps=-setpoint.lateral_mps,
        vz_mps=-setpoint.climb_mps,
        yaw_rate_radps=-setpoint.yaw_rate_radps,
    )


def bearing_from_frd(clockwise_rad: float) -> float:
    """A bearing about the vehicle as MAVLink counts it, clockwise from the heading, as ours in [-π, π)."""
    return wrap_rad(-clockwise_rad)


_X, _Y, _Z = np.eye(3)
_EAST_NORTH = {"x": (_Y, _Z), "y": (_X, -_Z), "z": (_X, _Y), "-x": (_Y, -_Z), "-y": (_X, _Z), "-z": (_X, -_Y)}
"""Which axes of a world go on as east and north when the named one is up; x stays east where it can."""

AXES = tuple(_EAST_NORTH)
"""What may be up in the worlds of others."""


def z_up(up: str) -> NDArray[np.float64]:
    """The (3, 3) rotation after which the axis ``up``, one of `AXES`, of another's world is z."""
    east, north = _EAST_NORTH[up]
    return np.stack([east, north, np.cross(east, north)])


def flu_of_optical(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """The (3, 3) rotation of a camera's forward-left-up frame, from that of its optical frame: right, down, forward."""
    right, down, forward = rotation.T
    return np.stack([forward, -right, -down], axis=1)
