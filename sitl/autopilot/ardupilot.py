"""ArduCopter as it was measured: 4.7-dev of October 2025 in SITL."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

from companion.mavlink.ids import MavSeverity
from sitl.autopilot.mavlink import Message
from sitl.autopilot.mavlink import dialect as m
from sitl.autopilot.parameters import Encoding, Kind
from sitl.autopilot.personality import Numbers, Personality
from sitl.autopilot.state import Behaviour, Mode, State

_HOLDING = {"STABILIZE": 0, "ALT_HOLD": 2, "LOITER": 5, "POSHOLD": 16}
_MODES = {name: Mode(name, number, Behaviour.HOLD) for name, number in _HOLDING.items()} | {
    "GUIDED": Mode("GUIDED", 4, Behaviour.SETPOINTS),
    "RTL": Mode("RTL", 6, Behaviour.LAND, armable=False),
    "LAND": Mode("LAND", 9, Behaviour.LAND, armable=False),
    "BRAKE": Mode("BRAKE", 17, Behaviour.HOLD, armable=False),
}
_WITHOUT_POSITION = ("STABILIZE", "ALT_HOLD", "LAND")
_READY_EXTERNAL_S = 20.0
"""From the first external navigation until it arms."""
_LOST_S = 8.0
"""Without external navigation nothing happens for so long."""
_LIFTED_M = 0.3
_EXTERNAL, _GPS = 6, 3


class _ArduPilot(Personality):
    name = "ardupilot"
    autopilot = m.MAV_AUTOPILOT_ARDUPILOTMEGA
    encoding = Encoding.C_CAST
    integer = Kind.INT16
    encoding_capability = m.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST
    version = 4 << 24 | 7 << 16
    # From 0.42 m/s it stands 1.1 to 1.2 s after the time-out, 0.33 m on.
    numbers = Numbers(1.87, 0.7, 0.84, 0.03, 0.1, 1.6, 0.55)
    ready_s = 37.0
    modes = _MODES
    boot_mode = "STABILIZE"
    hold_mode = "BRAKE"
    land_mode = "LAND"
    pilot_mode = "LOITER"
    setpoint_mode = "GUIDED"
    parameters: ClassVar[Mapping[str, float]] = {
        "ARMING_CHECK": 1,
        "AVOID_BACKUP_SPD": 0.75,
        "AVOID_ENABLE": 3,
        "AVOID_MARGIN": 2.0,
        "BATT_FS_CRT_ACT": 0,
        "BATT_FS_LOW_ACT": 0,
        "BATT_LOW_VOLT": 10.5,
        "BATT_MONITOR": 4,
        "COMPASS_ENABLE": 1,
        "COMPASS_USE": 1,
        "COMPASS_USE2": 1,
        "COMPASS_USE3": 1,
        "DISARM_DELAY": 10,
        "EK3_ENABLE": 1,
        "EK3_SRC1_POSXY": 3,
        "EK3_SRC1_POSZ": 1,
        "EK3_SRC1_VELXY": 3,
        "EK3_SRC1_VELZ": 3,
        "EK3_SRC1_YAW": 1,
        "FENCE_ENABLE": 0,
        "FRAME_CLASS": 1,
        "FS_EKF_ACTION": 1,
        "FS_EKF_THRESH": 0.8,
        "FS_GCS_ENABLE": 0,
        "FS_OPTIONS": 16,
        "FS_THR_ENABLE": 1,
        "GPS1_TYPE": 1,
        "GUID_OPTIONS": 0,
        "GUID_TIMEOUT": 3.0,
        "LAND_SPEED": 50,
        "MAV_SYSID": 1,
        "PRX1_TYPE": 0,
        "RNGFND1_ORIENT": 25,
        "RNGFND1_TYPE": 0,
        "VISO_TYPE": 0,
        "WPNAV_SPEED": 1000.0,
    }
    no_gps_parameters: ClassVar[Mapping[str, float]] = {
        "COMPASS_ENABLE": 0,
        "COMPASS_USE": 0,
        "COMPASS_USE2": 0,
        "COMPASS_USE3": 0,
        "EK3_SRC1_POSXY": _EXTERNAL,
        "EK3_SRC1_POSZ": _EXTERNAL,
        "EK3_SRC1_VELXY": _EXTERNAL,
        "EK3_SRC1_VELZ": _EXTERNAL,
        "EK3_SRC1_YAW": _EXTERNAL,
        "GPS1_TYPE": 0,
        "VISO_TYPE": 1,
    }
    rates_hz: ClassVar[Mapping[str, float]] = {"HEARTBEAT": 1.0, "SYS_STATUS": 2.0}
    on_request = frozenset(
        {
            "ATTITUDE", "ATTITUDE_QUATERNION", "LOCAL_POSITION_NED", "GLOBAL_POSITION_INT", "DISTANCE_SENSOR",
            "SIM_STATE", "VFR_HUD", "GPS_RAW_INT", "EXTENDED_SYS_STATE", "EKF_STATUS_REPORT", "BATTERY_STATUS",
            "HOME_POSITION", "GPS_GLOBAL_ORIGIN", "AUTOPILOT_VERSION",
        }
    )  # fmt: skip
    refuses_interval = m.MAV_RESULT_DENIED
    refused = m.MAV_RESULT_FAILED
    refuses_reboot = m.MAV_RESULT_FAILED
    velocity_frames = frozenset({m.MAV_FRAME_LOCAL_NED, m.MAV_FRAME_BODY_NED, m.MAV_FRAME_BODY_OFFSET_NED})
    hovering_frames = frozenset({m.MAV_FRAME_BODY_FRD})
    sync_period_s = 10.0
    synchronises_odometry = False
    acknowledges_set_mode = True
    position_before_fix = False

    def custom_mode(self, main: float, sub: float) -> int | None:  # noqa: ARG002
        return int(main) if 0.0 <= main < 256.0 else None

    def gps_used(self, state: State) -> bool:
        parameters = state.parameters
        return state.gps_present and parameters["GPS1_TYPE"] != 0 and parameters["EK3_SRC1_POSXY"] == _GPS

    def position_valid(self, state: State) -> bool:
        if self.gps_used(state):
            return state.since_boot_s >= 0.6 * self.ready_s * state.hurry
        if state.origin is None or state.parameters["EK3_SRC1_POSXY"] != _EXTERNAL:
            return False
        fed_speed_s = state.estimator.fed_speed_s
        by_speed = state.parameters["EK3_SRC1_VELXY"] == _EXTERNAL
        if by_speed and (fed_speed_s is None or state.t_s - fed_speed_s >= _LOST_S):
            return False
        return state.estimator.alone_s(state.t_s) < _LOST_S

    def takes_odometry(self, state: State, message: Message) -> bool | None:
        if state.parameters["VISO_TYPE"] == 0:
            return None
        if message.get_type() == "VISION_POSITION_ESTIMATE":
            return True
        frames = (message.frame_id, message.child_frame_id)
        return False if frames == (m.MAV_FRAME_LOCAL_FRD, m.MAV_FRAME_BODY_FRD) else None

    def height_from_odometry(self, state: State) -> bool:
        return state.parameters["EK3_SRC1_POSZ"] == _EXTERNAL

    def arming_refusal(self, state: State) -> str | None:
        if not state.shown.armable:
            return f"Arm: {state.shown.name} mode not armable"
        if state.parameters["ARMING_CHECK"] == 0:
            return None
        by_gps = self.gps_used(state)
        ready_s = self.ready_s if by_gps else _READY_EXTERNAL_S
        fed_s = state.estimator.fed_since_s
        since_s = state.since_boot_s if by_gps else -1.0 if fed_s is None else state.t_s - fed_s
        if state.since_boot_s < 0.25 * ready_s * state.hurry:
            return "Arm: Gyros inconsistent"
        if state.origin is None or since_s < 0.6 * ready_s * state.hurry:
            return "Arm: AHRS: waiting for home"
        if since_s < ready_s * state.hurry or not self.position_valid(state):
            return "Arm: Need Position Estimate"
        return None

    def mode_refusal(self, state: State, mode: Mode) -> str | None:
        if mode.name in _WITHOUT_POSITION or self.position_valid(state) or not state.armed:
            return None
        return f"Mode change to {mode.name} failed: requires position"

    def on_setpoint(self, state: State) -> None:
        if not state.armed or state.shown.behaviour is not Behaviour.SETPOINTS:
            return
        # A velocity ends the take-off: on the ground that means it never begins.
        state.takeoff_s = None
        if state.airframe.height_m < _LIFTED_M:
            state.takeoff_suppressed = True

    def take_off(self, state: State, altitude_m: float) -> str | None:
        if not state.armed or state.mode.name != "GUIDED" or state.flying:
            return "Takeoff refused"
        if not math.isfinite(altitude_m) or altitude_m <= 0.0:
            return "Takeoff refused"
        if not state.takeoff_suppressed:
            state.takeoff_s, state.takeoff_from_m = state.t_s, state.estimator.pose.z_m
            state.takeoff_height_m = altitude_m
        return None

    def active(self, state: State) -> Behaviour:
        behaviour = state.shown.behaviour
        if behaviour is Behaviour.LAND and not self.position_valid(state):
            return Behaviour.DESCEND
        if behaviour is not Behaviour.SETPOINTS:
            return behaviour
        if state.takeoff_s is not None:
            return Behaviour.TAKEOFF
        fresh = state.target_age_s() < state.parameters["GUID_TIMEOUT"]
        return Behaviour.SETPOINTS if fresh and state.airframe.height_m >= _LIFTED_M else Behaviour.HOLD

    def supervise(self, state: State) -> None:
        if not state.armed:
            return
        pose, to_m = state.estimator.pose, state.takeoff_from_m + state.takeoff_height_m
        if state.takeoff_s is not None and pose.z_m >= to_m - 0.05:
            state.takeoff_s = None
            state.hold_m = (pose.x_m, pose.y_m, to_m)
        needs_position = state.mode.name not in _WITHOUT_POSITION
        if state.flying and needs_position and not self.position_valid(state):
            state.say(MavSeverity.CRITICAL, "EKF variance")
            state.enter(self.modes["LAND"])
        landing = state.flown and state.shown.behaviour is Behaviour.LAND
        limit_s = 1.5 if landing else state.parameters["DISARM_DELAY"]
        if limit_s > 0.0 and state.on_ground_s > limit_s:
            state.disarm("Disarming motors")


ARDUPILOT = _ArduPilot()
"""The ArduCopter personality."""
