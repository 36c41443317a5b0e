"""What the autopilot says of itself: one message of each kind, built from its state."""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from dataclasses import replace

from companion.frames import NedPose, pose_to_ned
from companion.geometry import quaternion
from companion.model import Pose
from sitl.autopilot.mavlink import Message
from sitl.autopilot.mavlink import dialect as m
from sitl.autopilot.origin import GlobalPosition, to_global
from sitl.autopilot.personality import Personality
from sitl.autopilot.state import Behaviour, State

_SENSORS = (
    m.MAV_SYS_STATUS_SENSOR_3D_GYRO
    | m.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    | m.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE
    | m.MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS
    | m.MAV_SYS_STATUS_SENSOR_BATTERY
    | m.MAV_SYS_STATUS_AHRS
)
_PREARM = m.MAV_SYS_STATUS_PREARM_CHECK
_RANGE_CM = (10, 5000)
_INT16 = 32767
_GRAVITY_MPS2 = 9.81
_AIDED_S = 0.3
_LOST_RATIO = 1.5
_MOST_CHANNELS, _RSSI_UNKNOWN = 18, 255
_NO_COVARIANCE = [math.nan] + [0.0] * 20


class Telemetry:
    """Builds messages.

    Args:
        personality: which autopilot it is.
        state: what it knows; read at every call.
        system_id: its number, which also makes its hardware number.
    """

    def __init__(self, personality: Personality, state: State, system_id: int) -> None:
        self._personality = personality
        self._state = state
        self._system_id = system_id
        self._builders: dict[str, Callable[[], Message | None]] = {
            "HEARTBEAT": self._heartbeat,
            "SYS_STATUS": self._sys_status,
            "ATTITUDE": self._attitude,
            "ATTITUDE_QUATERNION": self._attitude_quaternion,
            "LOCAL_POSITION_NED": self._local_position,
            "GLOBAL_POSITION_INT": self._global_position,
            "DISTANCE_SENSOR": self._distance,
            "HIL_STATE_QUATERNION": self._hil_state,
            "SIM_STATE": self._sim_state,
            "VFR_HUD": self._vfr_hud,
            "GPS_RAW_INT": self._gps_raw,
            "EXTENDED_SYS_STATE": self._extended,
            "ESTIMATOR_STATUS": self._estimator_status,
            "EKF_STATUS_REPORT": self._ekf_report,
            "BATTERY_STATUS": self._battery,
            "HOME_POSITION": self._home,
            "GPS_GLOBAL_ORIGIN": self._origin,
            "AUTOPILOT_VERSION": self._version,
            "ODOMETRY": self._odometry,
            "HIGHRES_IMU": self._imu,
            "RC_CHANNELS": self._channels,
            "MISSION_CURRENT": lambda: m.MAVLink_mission_current_message(0),
        }
        self._ratios = (0.1, 0.1)
        self._rng = random.Random(system_id)  # noqa: S311 - noise
        self._noisy_s = math.nan
        self._noisy: tuple[Pose, NedPose]

    def build(self, name: str) -> Message | None:
        """The message of that name now, or ``None`` when the autopilot has nothing to say in it."""
        return self._builders[name]()

    @property
    def _boot_ms(self) -> int:
        return round(self._state.since_boot_s * 1e3)

    def _estimate(self) -> tuple[Pose, NedPose]:
        """One draw of noise a step: all messages of a step tell of the same estimate."""
        if self._noisy_s != self._state.t_s:
            self._noisy_s = self._state.t_s
            pose = self._state.estimator.noisy()
            self._noisy = pose, pose_to_ned(pose)
        return self._noisy

    def _globe(self) -> tuple[GlobalPosition, float] | None:
        """Where on the globe the estimate is, and the altitude of home in mm."""
        state = self._state
        if state.origin is None or not self._personality.global_position(state):
            return None
        pose = self._estimate()[0]
        return to_global(pose.x_m, pose.y_m, pose.z_m, state.origin), state.origin[2]

    def _heartbeat(self) -> Message:
        state, personality = self._state, self._personality
        armed = m.MAV_MODE_FLAG_SAFETY_ARMED if state.armed else 0
        return m.MAVLink_heartbeat_message(
            m.MAV_TYPE_QUADROTOR, personality.autopilot, personality.base_mode(state) | armed,
            state.shown.custom_mode, personality.system_status(state), 3,
        )  # fmt: skip

    def _sys_status(self) -> Message:
        state = self._state
        present = _SENSORS | _PREARM
        if state.gps_present:
            present |= m.MAV_SYS_STATUS_SENSOR_GPS
        healthy = present
        if not state.armed and self._personality.arming_refusals(state):
            healthy &= ~_PREARM
        if not self._personality.position_valid(state):
            healthy &= ~m.MAV_SYS_STATUS_AHRS
        percent = int(self._personality.battery_percent(state))
        receiver = m.MAV_SYS_STATUS_SENSOR_RC_RECEIVER if self._personality.shows_receiver(state) else 0
        present |= receiver
        healthy |= 0 if state.transmitter.lost else receiver
        voltage_mv = round(state.battery.voltage_v * 1e3)
        return m.MAVLink_sys_status_message(present, present, healthy, 250, voltage_mv, 1500, percent, 0, 0, 0, 0, 0, 0)

    def _attitude(self) -> Message:
        ned = self._estimate()[1]
        return m.MAVLink_attitude_message(
            self._boot_ms, ned.roll_rad, ned.pitch_rad, ned.yaw_rad, 0.0, 0.0, ned.yaw_rate_radps
        )

    def _attitude_quaternion(self) -> Message:
        ned = self._estimate()[1]
        q = quaternion(ned.yaw_rad, ned.pitch_rad, ned.roll_rad)
        return m.MAVLink_attitude_quaternion_message(self._boot_ms, *q, 0.0, 0.0, ned.yaw_rate_radps)

    def _local_position(self) -> Message | None:
        if not self._personality.position_before_fix and not self._personality.position_valid(self._state):
            return None
        ned = self._estimate()[1]
        return m.MAVLink_local_position_ned_message(
            self._boot_ms, ned.north_m, ned.east_m, ned.down_m, ned.v_north_mps, ned.v_east_mps, ned.v_down_mps
        )

    def _global_position(self) -> Message | None:
        globe = self._globe()
        if globe is None:
            return None
        (lat_e7, lon_e7, alt_mm), home_mm = globe
        ned = self._estimate()[1]
        place = lat_e7, lon_e7, alt_mm, round(alt_mm - home_mm)
        return m.MAVLink_global_position_int_message(self._boot_ms, *place, *_cmps(ned), _compass_cdeg(ned.yaw_rad))

    def _distance(self) -> Message | None:
        parameters = self._state.parameters
        if "RNGFND1_TYPE" in parameters and parameters["RNGFND1_TYPE"] == 0:
            return None
        pose, height_m = self._state.airframe.pose, self._state.airframe.height_m
        along_m = height_m / max(0.1, math.cos(pose.roll_rad) * math.cos(pose.pitch_rad))
        reading_cm = max(_RANGE_CM[0], min(_RANGE_CM[1], round(100.0 * along_m)))
        return m.MAVLink_distance_sensor_message(
            self._boot_ms, *_RANGE_CM, reading_cm, m.MAV_DISTANCE_SENSOR_LASER, 0, m.MAV_SENSOR_ROTATION_PITCH_270, 0
        )

    def _truth(self) -> tuple[NedPose, GlobalPosition]:
        true = self._state.airframe.pose
        return pose_to_ned(true), to_global(true.x_m, true.y_m, true.z_m)

    def _hil_state(self) -> Message:
        ned, globe = self._truth()
        q = quaternion(ned.yaw_rad, ned.pitch_rad, ned.roll_rad)
        return m.MAVLink_hil_state_quaternion_message(
            round(self._state.since_boot_s * 1e6), q, 0.0, 0.0, ned.yaw_rate_radps, *globe, *_cmps(ned),
            0, 0, 0, 0, -1000,
        )  # fmt: skip

    def _sim_state(self) -> Message:
        ned, (lat_e7, lon_e7, alt_mm) = self._truth()
        return m.MAVLink_sim_state_message(
            *quaternion(ned.yaw_rad, ned.pitch_rad, ned.roll_rad), ned.roll_rad, ned.pitch_rad, ned.yaw_rad,
            0.0, 0.0, -9.81, 0.0, 0.0, ned.yaw_rate_radps, lat_e7 * 1e-7, lon_e7 * 1e-7, alt_mm * 1e-3,
            0.0, 0.0, ned.v_north_mps, ned.v_east_mps, ned.v_down_mps, lat_e7, lon_e7,
        )  # fmt: skip

    def _vfr_hud(self) -> Message:
        pose, ned = self._estimate()
        speed_mps = math.hypot(pose.vx_mps, pose.vy_mps)
        return m.MAVLink_vfr_hud_message(
            speed_mps, speed_mps, _compass_cdeg(ned.yaw_rad) // 100, 50 if self._state.flying else 0, pose.z_m,
            pose.vz_mps,
        )  # fmt: skip

    def _gps_raw(self) -> Message:
        state, pose = self._state, self._estimate()[0]
        without = m.GPS_FIX_TYPE_NO_FIX if self._personality.gps_set_up(state) else m.GPS_FIX_TYPE_NO_GPS
        fix = m.GPS_FIX_TYPE_3D_FIX if state.gps_present else without
        start = state.estimator.origin
        true = replace(pose, x_m=pose.x_m + start.x_m, y_m=pose.y_m + start.y_m, z_m=pose.z_m + start.z_m)
        where = to_global(true.x_m, true.y_m, true.z_m) if state.gps_present else (0, 0, 0)
        speed_cmps = round(100.0 * math.hypot(pose.vx_mps, pose.vy_mps))
        return m.MAVLink_gps_raw_int_message(
            round(state.since_boot_s * 1e6), fix, *where, 70, 90, min(_INT16, speed_cmps), 65535,
            12 if state.gps_present else 0,
        )  # fmt: skip

    def _extended(self) -> Message:
        state = self._state
        landed = m.MAV_LANDED_STATE_IN_AIR
        if state.landed:
            landed = m.MAV_LANDED_STATE_ON_GROUND
        elif state.shown.behaviour in (Behaviour.LAND, Behaviour.DESCEND):
            landed = m.MAV_LANDED_STATE_LANDING
        elif state.takeoff_s is not None:
            landed = m.MAV_LANDED_STATE_TAKEOFF
        return m.MAVLink_extended_sys_state_message(m.MAV_VTOL_STATE_UNDEFINED, landed)

    def _test_ratios(self) -> tuple[float, float]:
        """Of velocity and position: well below 1 and never twice the same while aided.

        Without aid ArduPilot repeats the last ones until it knows that it is lost; PX4's grow.
        """
        alone_s = self._state.estimator.alone_s(self._state.t_s)
        if alone_s < _AIDED_S:
            self._ratios = (0.1 + self._rng.uniform(-0.05, 0.05), 0.1 + self._rng.uniform(-0.05, 0.05))
            return self._ratios
        if not self._personality.position_before_fix:
            return self._ratios if self._personality.position_valid(self._state) else (_LOST_RATIO, _LOST_RATIO)
        ratio = min(3.0, 0.1 + 0.15 * alone_s)
        return ratio, ratio

    def _estimator_status(self) -> Message:
        velocity, position = self._test_ratios()
        flags = self._personality.estimator_flags(self._state)
        return m.MAVLink_estimator_status_message(
            round(self._state.since_boot_s * 1e6), flags, velocity, position, 0.1, 0.1, 0.1, 0.0, 0.1 + position, 0.1
        )

    def _ekf_report(self) -> Message:
        velocity, position = self._test_ratios()
        flags = self._personality.estimator_flags(self._state)
        return m.MAVLink_ekf_status_report_message(flags, velocity, position, 0.1, 0.05, 0.0)

    def _battery(self) -> Message:
        state, battery = self._state, self._state.battery
        cell_mv = round(battery.voltage_v / battery.cells * 1e3)
        volts = [cell_mv] * battery.cells + [65535] * (10 - battery.cells)
        percent = int(self._personality.battery_percent(state))
        charge_state = m.MAV_BATTERY_CHARGE_STATE_OK + self._personality.battery_warning(state)
        return m.MAVLink_battery_status_message(
            0, 1, 1, 2500, volts, 1500, round(battery.used_mah), -1, percent, 0, charge_state
        )

    def _home(self) -> Message | None:
        origin = self._state.origin
        if origin is None or not self._personality.global_position(self._state):
            return None
        return m.MAVLink_home_position_message(*origin, 0.0, 0.0, 0.0, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0)

    def _origin(self) -> Message | None:
        origin = self._state.origin
        return None if origin is None else m.MAVLink_gps_global_origin_message(*origin)

    def _version(self) -> Message:
        capabilities = (
            m.MAV_PROTOCOL_CAPABILITY_MAVLINK2
            | m.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
            | m.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
            | m.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
            | self._personality.encoding_capability
        )
        version = self._personality.version
        return m.MAVLink_autopilot_version_message(
            capabilities, version, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, self._system_id
        )

    def _channels(self) -> Message | None:
        """What a receiver that has lost its transmitter puts out is nothing on PX4, and the last on ArduPilot."""
        state = self._state
        if not self._personality.shows_receiver(state):
            return None
        absent = [self._personality.no_channel_us] * (_MOST_CHANNELS - len(state.channels_us))
        return m.MAVLink_rc_channels_message(
            self._boot_ms, len(state.channels_us), *state.channels_us, *absent, _RSSI_UNKNOWN
        )

    def _imu(self) -> Message:
        pose = self._state.airframe.pose
        g = _GRAVITY_MPS2
        felt_mps2 = g * math.tan(-pose.pitch_rad), g * math.tan(pose.roll_rad), -g
        return m.MAVLink_highres_imu_message(
            round(self._state.since_boot_s * 1e6), *felt_mps2, 0.0, 0.0, -pose.yaw_rate_radps, 0.2, 0.0, 0.4,
            1013.25 - 0.12 * pose.z_m, 0.0, pose.z_m, 25.0, 0x1FFF,
        )  # fmt: skip

    def _odometry(self) -> Message:
        ned = self._estimate()[1]
        c, s = math.cos(ned.yaw_rad), math.sin(ned.yaw_rad)
        forward_mps = c * ned.v_north_mps + s * ned.v_east_mps
        right_mps = c * ned.v_east_mps - s * ned.v_north_mps
        return m.MAVLink_odometry_message(
            round(self._state.since_boot_s * 1e6), m.MAV_FRAME_LOCAL_NED, m.MAV_FRAME_BODY_FRD,
            ned.north_m, ned.east_m, ned.down_m, quaternion(ned.yaw_rad, ned.pitch_rad, ned.roll_rad),
            forward_mps, right_mps, ned.v_down_mps, 0.0, 0.0, ned.yaw_rate_radps, _NO_COVARIANCE, _NO_COVARIANCE,
            0, m.MAV_ESTIMATOR_TYPE_AUTOPILOT, 100,
        )  # fmt: skip


def _cmps(ned: NedPose) -> list[int]:
    """The velocity in whole cm/s."""
    return [
        max(-_INT16, min(_INT16, round(100.0 * v_mps))) for v_mps in (ned.v_north_mps, ned.v_east_mps, ned.v_down_mps)
    ]


def _compass_cdeg(yaw_rad: float) -> int:
    return round(math.degrees(yaw_rad) * 100.0) % 36000
