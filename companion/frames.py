"""The only file that negates an axis: ENU/FLU (ours) to and from NED/FRD (MAVLink)."""

from __future__ import annotations

import math
from dataclasses import dataclass

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
