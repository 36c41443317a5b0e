"""From what the active mode does to the velocity that the vehicle is to fly."""

from __future__ import annotations

import math

from companion.frames import pose_to_ned
from sitl.autopilot.airframe import Motion
from sitl.autopilot.mavlink import ned_velocity
from sitl.autopilot.personality import Personality
from sitl.autopilot.state import Behaviour, State

_STOPPED_MPS = 0.15
_POSITION_GAIN = 0.8
_CLIMB_GAIN = 0.4
_HOLD_MPS = 1.0
_LAND_MPS, _TOUCH_MPS, _SLOW_BELOW_M = 0.6, 0.3, 1.0
_UNBRAKED = 0.95
"""A blind descent hardly brakes: the share of its speed that it goes on wanting."""
_YAW_GAIN = 0.97
_BACKUP_GAIN = 1.03
"""0.77 m/s were measured for AVOID_BACKUP_SPD 0.75."""
_OBSTACLE_AGE_S = 0.5
_MAX_CLIMB_MPS = 2.0


def motion(personality: Personality, state: State) -> Motion | None:
    """The demand on the inner loops now; ``None`` when the motors stand still."""
    if not state.armed:
        return None
    behaviour = personality.active(state)
    if behaviour is Behaviour.SETPOINTS:
        return _follow(personality, state)
    if behaviour is Behaviour.DESCEND:
        pose = state.airframe.pose
        return Motion(_UNBRAKED * pose.vx_mps, _UNBRAKED * pose.vy_mps, -_LAND_MPS)
    if behaviour is Behaviour.HOLD and state.airframe.on_ground:
        return Motion()
    vx_mps, vy_mps, vz_mps = _hold(state)
    if behaviour is Behaviour.LAND:
        vz_mps = -(_LAND_MPS if state.airframe.height_m > _SLOW_BELOW_M else _TOUCH_MPS)
    elif behaviour is Behaviour.TAKEOFF:
        vz_mps = _climb(personality, state)
    if personality.setpoint_mode == state.shown.name:
        vx_mps, vy_mps = _avoided(state, vx_mps, vy_mps)
    true_x_mps, true_y_mps = state.estimator.to_true(vx_mps, vy_mps)
    return Motion(true_x_mps, true_y_mps, vz_mps, held=True)


def _hold(state: State) -> tuple[float, float, float]:
    """Brakes, and once it stands, stays there, by the estimate."""
    pose = state.estimator.pose
    if state.hold_m is None:
        if math.sqrt(pose.vx_mps**2 + pose.vy_mps**2 + pose.vz_mps**2) > _STOPPED_MPS:
            return 0.0, 0.0, 0.0
        state.hold_m = (pose.x_m, pose.y_m, pose.z_m)
    x_m, y_m, z_m = state.hold_m
    vx_mps, vy_mps = _POSITION_GAIN * (x_m - pose.x_m), _POSITION_GAIN * (y_m - pose.y_m)
    vz_mps = max(-_HOLD_MPS, min(_HOLD_MPS, _CLIMB_GAIN * (z_m - pose.z_m)))
    share = min(1.0, _HOLD_MPS / max(math.hypot(vx_mps, vy_mps), 1e-9))
    return vx_mps * share, vy_mps * share, vz_mps


def _climb(personality: Personality, state: State) -> float:
    """Vertical velocity of a take-off: nothing while the motors spin up, then steady, then ever slower."""
    if state.takeoff_s is None or state.t_s - state.takeoff_s < personality.numbers.spool_s:
        return 0.0
    missing_m = state.takeoff_from_m + state.takeoff_height_m - state.estimator.pose.z_m
    top_mps = max(personality.numbers.climb_mps, state.takeoff_height_m / 5.0)
    return max(-_HOLD_MPS, min(min(top_mps, _MAX_CLIMB_MPS), 2.0 * missing_m))


def _follow(personality: Personality, state: State) -> Motion:
    target = state.target
    if target is None:
        return Motion()
    state.hold_m = None
    gain = personality.numbers.velocity_gain
    vx_mps, vy_mps = _avoided(state, gain * target.vx_mps, gain * target.vy_mps)
    true_x_mps, true_y_mps = state.estimator.to_true(vx_mps, vy_mps)
    vz_mps = max(-_MAX_CLIMB_MPS, min(_MAX_CLIMB_MPS, gain * target.vz_mps))
    return Motion(true_x_mps, true_y_mps, vz_mps, _YAW_GAIN * target.yaw_rate_radps)


def _avoided(state: State, vx_mps: float, vy_mps: float) -> tuple[float, float]:
    """ArduPilot's avoidance: no nearer than the margin, and out of it backwards. PX4 has none in offboard."""
    obstacles, parameters = state.obstacles, state.parameters
    if obstacles is None or "AVOID_ENABLE" not in parameters or not int(parameters["AVOID_ENABLE"]) & 2:
        return vx_mps, vy_mps
    if parameters["PRX1_TYPE"] != 2 or state.airframe.on_ground or state.t_s - obstacles.t_s > _OBSTACLE_AGE_S:
        return vx_mps, vy_mps
    if obstacles.range_m >= parameters["AVOID_MARGIN"]:
        return vx_mps, vy_mps
    towards = body_velocity(state, math.cos(obstacles.bearing_rad), math.sin(obstacles.bearing_rad))
    approach_mps = vx_mps * towards[0] + vy_mps * towards[1]
    wanted_mps = min(approach_mps, -_BACKUP_GAIN * max(0.0, parameters["AVOID_BACKUP_SPD"]))
    change_mps = wanted_mps - approach_mps
    return vx_mps + change_mps * towards[0], vy_mps + change_mps * towards[1]


def body_velocity(state: State, forward_mps: float, right_mps: float) -> tuple[float, float]:
    """A body velocity in the frame of the estimate, east and north: turned by the yaw alone."""
    yaw_rad = pose_to_ned(state.estimator.pose).yaw_rad
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    velocity = ned_velocity(c * forward_mps - s * right_mps, s * forward_mps + c * right_mps, 0.0, 0.0)
    return velocity.vx_mps, velocity.vy_mps
