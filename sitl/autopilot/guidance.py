"""From what the active mode does to the velocity that the vehicle is to fly."""

from __future__ import annotations

import math
from dataclasses import replace

from companion.frames import pose_to_ned
from sitl.autopilot.airframe import Motion
from sitl.autopilot.mavlink import ned_velocity
from sitl.autopilot.personality import Personality
from sitl.autopilot.state import Behaviour, State

_STOPPED_MPS = 0.15
_ROLLS_ON = 0.4
"""Share of the time constant: it is braking already when it is that slow."""
_STANDS_MPS = 0.1
_POSITION_GAIN = 0.8
_HOLD_MPS = 1.0
_TOUCH_MPS, _SLOW_BELOW_M = 0.3, 1.0
_BLIND_LAND_MPS = 0.6
_UNBRAKED = 0.95
"""A blind descent hardly brakes: the share of its speed that it goes on wanting."""
_COAST_S = 6.0
"""Level, nothing but the air brakes it: more than 2 m from 0.4 m/s."""
_YAW_GAIN = 0.97
_BACKUP_GAIN = 1.03
"""0.77 m/s were measured for AVOID_BACKUP_SPD 0.75."""
_OBSTACLE_AGE_S = 0.5
_MAX_CLIMB_MPS = 2.0
_HOME_M = 0.5


def motion(personality: Personality, state: State, dt_s: float) -> Motion | None:
    """The demand on the inner loops for the next ``dt_s``; ``None`` when the motors stand still."""
    if not state.armed:
        return None
    wanted = _wanted(personality, state)
    if not state.airframe.on_ground or wanted.vz_mps <= 0.0:
        state.hover_s = 0.0
        return wanted
    # The motors spin up, then they pull ever harder, and only then does it leave the ground.
    if state.t_s - state.armed_s >= personality.spool_s(state):
        state.hover_s += dt_s
    return wanted if state.hover_s >= personality.lift_s(state) else replace(wanted, vz_mps=0.0)


def _wanted(personality: Personality, state: State) -> Motion:
    behaviour, stop_s = personality.active(state), personality.stop_s(state)
    if behaviour is Behaviour.SETPOINTS:
        return _follow(personality, state, stop_s)
    if behaviour is Behaviour.DESCEND:
        pose = state.airframe.pose
        return Motion(_UNBRAKED * pose.vx_mps, _UNBRAKED * pose.vy_mps, -_BLIND_LAND_MPS)
    if behaviour in (Behaviour.HOLD, Behaviour.COAST) and state.airframe.on_ground:
        return Motion()
    vx_mps, vy_mps, vz_mps = _hold(state, personality.numbers.hold_climb_gain, stop_s)
    if behaviour is Behaviour.COAST:
        return Motion(0.0, 0.0, vz_mps, stop_s=_COAST_S)
    if behaviour is Behaviour.RETURN:
        vx_mps, vy_mps, vz_mps = _return(personality, state, (vx_mps, vy_mps))
    elif behaviour is Behaviour.LAND:
        vz_mps = _descent(personality, state)
        vx_mps, vy_mps = _to_landing_place(personality, state) or (vx_mps, vy_mps)
    elif behaviour is Behaviour.TAKEOFF:
        vz_mps = _climb(personality, state)
    if personality.setpoint_mode == state.shown.name:
        vx_mps, vy_mps = _avoided(state, vx_mps, vy_mps)
    true_x_mps, true_y_mps = state.estimator.to_true(vx_mps, vy_mps)
    return Motion(true_x_mps, true_y_mps, vz_mps, stop_s=stop_s, held=True)


def _hold(state: State, climb_gain: float, stop_s: float) -> tuple[float, float, float]:
    """Brakes, and once it nearly stands, stays where it will, by the estimate."""
    pose = state.estimator.pose
    if state.hold_m is None:
        if math.sqrt(pose.vx_mps**2 + pose.vy_mps**2 + pose.vz_mps**2) > _STOPPED_MPS:
            return 0.0, 0.0, 0.0
        rolls_s = _ROLLS_ON * stop_s
        state.hold_m = (pose.x_m + rolls_s * pose.vx_mps, pose.y_m + rolls_s * pose.vy_mps, pose.z_m)
    vx_mps, vy_mps = _towards(state, state.hold_m[0], state.hold_m[1], _HOLD_MPS)
    vz_mps = max(-_HOLD_MPS, min(_HOLD_MPS, climb_gain * (state.hold_m[2] - pose.z_m)))
    return vx_mps, vy_mps, vz_mps


def _towards(state: State, x_m: float, y_m: float, most_mps: float) -> tuple[float, float]:
    """The velocity to a place in the frame of the estimate."""
    pose = state.estimator.pose
    vx_mps, vy_mps = _POSITION_GAIN * (x_m - pose.x_m), _POSITION_GAIN * (y_m - pose.y_m)
    share = min(1.0, most_mps / max(math.hypot(vx_mps, vy_mps), 1e-9))
    return vx_mps * share, vy_mps * share


def _descent(personality: Personality, state: State) -> float:
    return -(personality.numbers.land_mps if state.airframe.height_m > _SLOW_BELOW_M else _TOUCH_MPS)


def _to_landing_place(personality: Personality, state: State) -> tuple[float, float] | None:
    place = personality.lands_at(state)
    return None if place is None else _towards(state, *place)


def _return(personality: Personality, state: State, held_mps: tuple[float, float]) -> tuple[float, float, float]:
    """Climbs, flies home, lands there."""
    pose, (home_x_m, home_y_m, home_z_m) = state.estimator.pose, state.home_m
    above_m, climb_mps = personality.return_climb(state)
    missing_m = home_z_m + above_m - pose.z_m
    if missing_m > _HOME_M and not state.returning_home:
        return *held_mps, climb_mps
    state.returning_home = True
    if math.hypot(home_x_m - pose.x_m, home_y_m - pose.y_m) < _HOME_M:
        return *_towards(state, home_x_m, home_y_m, _HOLD_MPS), _descent(personality, state)
    return *_towards(state, home_x_m, home_y_m, personality.return_mps(state)), max(-_HOLD_MPS, min(0.0, missing_m))


def _climb(personality: Personality, state: State) -> float:
    """Vertical velocity of a take-off: steady, then ever slower."""
    if state.takeoff_s is None:
        return 0.0
    numbers = personality.numbers
    missing_m = state.takeoff_from_m + state.takeoff_height_m - state.estimator.pose.z_m
    top_mps = max(numbers.climb_mps, state.takeoff_height_m / 5.0)
    return max(-_HOLD_MPS, min(min(top_mps, _MAX_CLIMB_MPS), numbers.climb_approach * missing_m))


def _follow(personality: Personality, state: State, stop_s: float) -> Motion:
    target = state.target
    if target is None:
        return Motion()
    state.hold_m = None
    gain = personality.numbers.velocity_gain
    vx_mps, vy_mps = _avoided(state, gain * target.vx_mps, gain * target.vy_mps)
    true_x_mps, true_y_mps = state.estimator.to_true(vx_mps, vy_mps)
    vz_mps = max(-_MAX_CLIMB_MPS, min(_MAX_CLIMB_MPS, target.vz_mps))
    yaw_rate_radps = _YAW_GAIN * target.yaw_rate_radps
    speed_mps = math.hypot(target.vx_mps, target.vy_mps)
    if speed_mps > _STANDS_MPS:
        state.went = target.vx_mps / speed_mps, target.vy_mps / speed_mps
        return Motion(true_x_mps, true_y_mps, vz_mps, yaw_rate_radps, stop_s)
    creep = state.estimator.turned(*(personality.numbers.creep_mps * way for way in state.went))
    return Motion(true_x_mps, true_y_mps, vz_mps, yaw_rate_radps, stop_s, creep)


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
