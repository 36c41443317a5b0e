"""PX4 as it was measured: main of August 2025 with its built-in simulator SIH."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

from companion.mavlink.ids import MavSeverity
from sitl.autopilot.mavlink import Message
from sitl.autopilot.mavlink import dialect as m
from sitl.autopilot.origin import ORIGIN_ALT_M
from sitl.autopilot.parameters import Encoding, Kind
from sitl.autopilot.personality import Numbers, Personality
from sitl.autopilot.state import Behaviour, Mode, State

_NAMES = {
    "MANUAL": (1, 0, Behaviour.HOLD),
    "ALTCTL": (2, 0, Behaviour.HOLD),
    "POSCTL": (3, 0, Behaviour.HOLD),
    "AUTO.TAKEOFF": (4, 2, Behaviour.TAKEOFF),
    "AUTO.LOITER": (4, 3, Behaviour.HOLD),
    "AUTO.RTL": (4, 5, Behaviour.LAND),
    "AUTO.LAND": (4, 6, Behaviour.LAND),
    "OFFBOARD": (6, 0, Behaviour.SETPOINTS),
}
_MODES = {
    name: Mode(name, main << 16 | sub << 24, behaviour, behaviour is not Behaviour.LAND)
    for name, (main, sub, behaviour) in _NAMES.items()
}
_DESCEND = Mode("AUTO.LAND", _MODES["AUTO.LAND"].custom_mode, Behaviour.DESCEND, armable=False)
"""Shown like a landing, but nothing holds the position."""

_ORIGIN_WAIT_S = 5.0
_EV_POSITION, _EV_YAW = 1, 8
_SHORT_OF_HEIGHT_M = 0.6
"""The take-off is over this far below the height that was asked for."""
_VISUAL = (
    m.MAV_ESTIMATOR_TYPE_UNKNOWN,
    m.MAV_ESTIMATOR_TYPE_NAIVE,
    m.MAV_ESTIMATOR_TYPE_VISION,
    m.MAV_ESTIMATOR_TYPE_VIO,
)
_UNHEALTHY = "Arming denied: Resolve system health failures first"


class _Px4(Personality):
    name = "px4"
    autopilot = m.MAV_AUTOPILOT_PX4
    encoding = Encoding.BYTEWISE
    integer = Kind.INT32
    encoding_capability = m.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
    version = 1 << 24 | 16 << 16
    # 0.42 m/s for 0.5 commanded; from there below 0.1 m/s in 0.75 s and 0.15 m.
    numbers = Numbers(6.0, 1.5, 0.84, 0.03, 0.35, 1.5, 0.5)
    ready_s = 6.0
    modes = _MODES
    boot_mode = hold_mode = "AUTO.LOITER"
    land_mode = "AUTO.LAND"
    pilot_mode = "POSCTL"
    setpoint_mode = "OFFBOARD"
    parameters: ClassVar[Mapping[str, float]] = {
        "BAT_CRIT_THR": 0.07,
        "BAT_LOW_THR": 0.15,
        "COM_ARM_WO_GPS": 1,
        "COM_DISARM_LAND": 2.0,
        "COM_DISARM_PRFLT": 10.0,
        "COM_DLL_EXCEPT": 0,
        "COM_LOW_BAT_ACT": 0,
        "COM_OBL_RC_ACT": 0,
        "COM_OF_LOSS_T": 1.0,
        "COM_RCL_EXCEPT": 0,
        "COM_RC_IN_MODE": 3,
        "COM_RC_OVERRIDE": 1,
        "CP_DIST": -1.0,
        "EKF2_EV_CTRL": 0,
        "EKF2_EV_DELAY": 0.0,
        "EKF2_GPS_CTRL": 7,
        "EKF2_HGT_REF": 1,
        "EKF2_MAG_TYPE": 0,
        "EKF2_NOAID_TOUT": 5_000_000,
        "GF_ACTION": 2,
        "MAV_SYS_ID": 1,
        "MAV_TYPE": 2,
        "MIS_TAKEOFF_ALT": 2.5,
        "MPC_LAND_SPEED": 0.7,
        "MPC_XY_VEL_MAX": 12.0,
        "MPC_Z_VEL_MAX_DN": 1.5,
        "MPC_Z_VEL_MAX_UP": 3.0,
        "NAV_DLL_ACT": 0,
        "NAV_RCL_ACT": 2,
        "SYS_AUTOSTART": 10040,
        "SYS_HAS_GPS": 1,
        "SYS_HAS_MAG": 1,
    }
    no_gps_parameters: ClassVar[Mapping[str, float]] = {
        "COM_ARM_WO_GPS": 1,
        "EKF2_EV_CTRL": 15,
        "EKF2_GPS_CTRL": 0,
        "EKF2_HGT_REF": 3,
        "EKF2_MAG_TYPE": 5,
        "SYS_HAS_GPS": 0,
        "SYS_HAS_MAG": 0,
    }
    rates_hz: ClassVar[Mapping[str, float]] = {
        "HEARTBEAT": 1.0,
        "SYS_STATUS": 2.0,
        "ATTITUDE": 99.0,
        "LOCAL_POSITION_NED": 30.0,
        "GLOBAL_POSITION_INT": 30.0,
        "DISTANCE_SENSOR": 10.0,
        "HIL_STATE_QUATERNION": 50.0,
        "VFR_HUD": 10.0,
        "GPS_RAW_INT": 2.0,
        "EXTENDED_SYS_STATE": 2.0,
        "ESTIMATOR_STATUS": 1.0,
        "BATTERY_STATUS": 0.5,
        "HOME_POSITION": 0.5,
    }
    on_request = frozenset({"ODOMETRY", "GPS_GLOBAL_ORIGIN", "AUTOPILOT_VERSION", "ATTITUDE_QUATERNION"})
    refuses_interval = m.MAV_RESULT_DENIED
    refused = m.MAV_RESULT_TEMPORARILY_REJECTED
    refuses_reboot = m.MAV_RESULT_DENIED
    velocity_frames = frozenset({m.MAV_FRAME_LOCAL_NED, m.MAV_FRAME_BODY_NED})
    hovering_frames: frozenset[int] = frozenset()
    sync_period_s = 0.1
    synchronises_odometry = True
    acknowledges_set_mode = False
    position_before_fix = True

    def custom_mode(self, main: float, sub: float) -> int | None:
        if not (0.0 <= main < 256.0 and 0.0 <= sub < 256.0):
            return None
        return int(main) << 16 | int(sub) << 24

    def gps_used(self, state: State) -> bool:
        parameters = state.parameters
        return state.gps_present and parameters["SYS_HAS_GPS"] != 0 and parameters["EKF2_GPS_CTRL"] != 0

    def position_valid(self, state: State) -> bool:
        if self.gps_used(state):
            return state.since_boot_s >= 0.5 * self.ready_s * state.hurry
        wanted = _EV_POSITION | _EV_YAW
        if int(state.parameters["EKF2_EV_CTRL"]) & wanted != wanted:
            return False
        # Dead reckoning ends a little before the time that the parameter says.
        blind_s = max(0.1, state.parameters["EKF2_NOAID_TOUT"] * 1e-6 - 0.25)
        return state.estimator.alone_s(state.t_s) < blind_s

    def takes_odometry(self, state: State, message: Message) -> bool | None:
        if int(state.parameters["EKF2_EV_CTRL"]) == 0:
            return None
        if message.get_type() == "VISION_POSITION_ESTIMATE":
            return True
        if message.estimator_type not in _VISUAL:
            return None
        return {m.MAV_FRAME_LOCAL_NED: True, m.MAV_FRAME_LOCAL_FRD: False}.get(message.frame_id)

    def height_from_odometry(self, state: State) -> bool:
        return int(state.parameters["EKF2_HGT_REF"]) == 3

    def can_hold(self, state: State) -> bool:
        """Hold wants to know where on the globe it is, and that axes fed from outside are north and east."""
        if not self.position_valid(state):
            return False
        if self.gps_used(state):
            return True
        return state.estimator.ned and state.t_s - state.origin_s >= _ORIGIN_WAIT_S * state.hurry

    def arming_refusal(self, state: State) -> str | None:
        if state.since_boot_s < self.ready_s * state.hurry or not state.shown.armable:
            return _UNHEALTHY
        if not self.gps_used(state) and state.parameters["COM_ARM_WO_GPS"] == 0:
            return "Preflight Fail: GPS fix required"
        return None if self.mode_refusal(state, state.mode) is None else _UNHEALTHY

    def mode_refusal(self, state: State, mode: Mode) -> str | None:
        if mode.behaviour is Behaviour.SETPOINTS:
            possible = self.position_valid(state) and state.streaming()
        elif mode.behaviour is Behaviour.HOLD:
            possible = mode.name in ("MANUAL", "ALTCTL") or self.can_hold(state)
        else:
            possible = mode.behaviour is not Behaviour.TAKEOFF or self.position_valid(state)
        return None if possible else f"Switching to {mode.name} currently not available"

    def on_setpoint(self, state: State) -> None:
        """Nothing: PX4 looks at the age of the setpoints only."""

    def take_off(self, state: State, altitude_m: float) -> str | None:
        mode = self.modes["AUTO.TAKEOFF"]
        refusal = self.mode_refusal(state, mode)
        if refusal is not None:
            return refusal
        state.enter(mode)
        state.takeoff_height_m = state.parameters["MIS_TAKEOFF_ALT"]
        if math.isfinite(altitude_m):
            ground_m = state.airframe.pose.z_m - state.airframe.height_m
            state.takeoff_height_m = max(0.0, altitude_m - ORIGIN_ALT_M - ground_m)
        return None

    def supervise(self, state: State) -> None:
        if not state.armed:
            return
        self._watch_takeoff(state)
        if state.flying and not self.position_valid(state):
            state.fall_back(_DESCEND, "Failsafe: position lost, descending")
        elif state.mode.behaviour is Behaviour.SETPOINTS:
            self._watch_setpoints(state)
        elif state.failsafe is not None:
            state.failsafe = None
        limit_s = state.parameters["COM_DISARM_LAND" if state.flown else "COM_DISARM_PRFLT"]
        if limit_s > 0.0 and state.on_ground_s > limit_s + (1.0 if state.flown else 0.0):
            state.disarm("Disarmed by landing" if state.flown else "Disarmed by auto preflight disarming")

    def _watch_takeoff(self, state: State) -> None:
        if state.shown.behaviour is not Behaviour.TAKEOFF:
            return
        if state.takeoff_s is None:
            state.takeoff_s, state.takeoff_from_m = state.t_s, state.estimator.pose.z_m
        pose, to_m = state.estimator.pose, state.takeoff_from_m + state.takeoff_height_m
        over = pose.z_m >= to_m - min(_SHORT_OF_HEIGHT_M, 0.5 * state.takeoff_height_m)
        # Without a hold to go to it stays in take-off, at the height that was asked for.
        if over and self.can_hold(state):
            state.enter(self.modes[self.hold_mode])
            state.hold_m = (pose.x_m, pose.y_m, to_m)

    def _watch_setpoints(self, state: State) -> None:
        since_s = 0.0 if state.target is None else state.target.t_s
        # 0.03 to 0.12 s late, differently each time, and the same again in a repeated run.
        late_s = 0.03 + 0.09 * ((since_s * 7.31) % 1.0)
        if state.target_age_s() < state.parameters["COM_OF_LOSS_T"]:
            if state.failsafe is not None:
                state.say(MavSeverity.INFO, "Offboard control signal regained")
            state.failsafe = None
        elif state.target_age_s() >= state.parameters["COM_OF_LOSS_T"] + late_s and state.failsafe is None:
            self._lose_setpoints(state)

    def _lose_setpoints(self, state: State) -> None:
        action = int(state.parameters["COM_OBL_RC_ACT"])
        if action in (6, 7):
            state.disarm("Failsafe: no offboard signal, terminated")
            return
        wanted = {3: "AUTO.RTL", 4: "AUTO.LAND", 5: "AUTO.LOITER"}.get(action, "POSCTL")
        if wanted == "AUTO.LOITER" and not self.can_hold(state):
            wanted = "AUTO.LAND"
        mode = _DESCEND if wanted == "POSCTL" and not state.transmitter else self.modes[wanted]
        state.fall_back(mode, "Failsafe activated: no offboard signal")


PX4 = _Px4()
"""The PX4 personality."""
