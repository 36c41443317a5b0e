"""What ArduCopter is set to in SITL, the types of it, and what it sends."""

from __future__ import annotations

from collections.abc import Mapping

from sitl.autopilot.parameters import Kind

EXTERNAL, GPS = 6, 3
"""EK3_SRC1_..."""

PARAMETERS: Mapping[str, float] = {
    "ARMING_CHECK": 1,
    "AVOID_BACKUP_SPD": 0.75,
    "AVOID_ENABLE": 3,
    "AVOID_MARGIN": 2.0,
    "BATT_CAPACITY": 3300,
    "BATT_CRT_VOLT": 0.0,
    "BATT_FS_CRT_ACT": 0,
    "BATT_FS_LOW_ACT": 0,
    "BATT_LOW_TIMER": 10,
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
    "FS_DR_ENABLE": 2,
    "FS_EKF_ACTION": 1,
    "FS_EKF_THRESH": 0.8,
    "FS_GCS_ENABLE": 0,
    "FS_GCS_TIMEOUT": 5.0,
    "FS_OPTIONS": 16,
    "FS_THR_ENABLE": 1,
    "FS_VIBE_ENABLE": 1,
    "GPS1_TYPE": 1,
    "GUID_OPTIONS": 0,
    "GUID_TIMEOUT": 3.0,
    "LAND_SPEED": 50,
    "MAV_SYSID": 1,
    "PRX1_TYPE": 0,
    "PSC_JERK_XY": 5.0,
    "RNGFND1_ORIENT": 25,
    "RNGFND1_TYPE": 0,
    "RTL_ALT": 1500,
    "SCR_ENABLE": 0,
    "VISO_TYPE": 0,
    "WPNAV_ACCEL": 250.0,
    "WPNAV_SPEED": 1000.0,
}
KINDS: Mapping[str, Kind] = {
    "ARMING_CHECK": Kind.INT32,
    "BATT_CAPACITY": Kind.INT32,
    "FS_OPTIONS": Kind.INT32,
    "GUID_OPTIONS": Kind.INT32,
    "LAND_SPEED": Kind.INT16,
    "MAV_SYSID": Kind.INT16,
    "RTL_ALT": Kind.INT32,
}
"""Of the integers that are not the usual 8 bits."""
NO_GPS_PARAMETERS: Mapping[str, float] = {
    "COMPASS_ENABLE": 0,
    "COMPASS_USE": 0,
    "COMPASS_USE2": 0,
    "COMPASS_USE3": 0,
    "EK3_SRC1_POSXY": EXTERNAL,
    "EK3_SRC1_POSZ": EXTERNAL,
    "EK3_SRC1_VELXY": EXTERNAL,
    "EK3_SRC1_VELZ": EXTERNAL,
    "EK3_SRC1_YAW": EXTERNAL,
    "GPS1_TYPE": 0,
    "VISO_TYPE": 1,
}
RATES_HZ: Mapping[str, float] = {"HEARTBEAT": 1.0}
ON_REQUEST = frozenset(
    {
        "ATTITUDE", "ATTITUDE_QUATERNION", "LOCAL_POSITION_NED", "GLOBAL_POSITION_INT", "DISTANCE_SENSOR",
        "SIM_STATE", "VFR_HUD", "GPS_RAW_INT", "EXTENDED_SYS_STATE", "EKF_STATUS_REPORT", "BATTERY_STATUS",
        "HOME_POSITION", "GPS_GLOBAL_ORIGIN", "AUTOPILOT_VERSION", "SYS_STATUS", "RC_CHANNELS",
        "MISSION_CURRENT",
    }
)  # fmt: skip
