"""Messages as simulators send them, written independently of the code that reads them, and a tap on what is sent."""

from __future__ import annotations

import math
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

LAT_DEG, LON_DEG, ALT_M = 47.397742, 8.545594, 489.4
PX4_M_PER_DEG = math.pi / 180.0 * 6_371_000.0
ARDUPILOT_M_PER_DEG = 0.011131884502145034e7
"""LOCATION_SCALING_FACTOR of ArduPilot, for a whole degree."""

Ned = tuple[float, float, float]


def quaternion(yaw_rad: float, pitch_rad: float = 0.0, roll_rad: float = 0.0) -> list[float]:
    """(w, x, y, z) as the product of three turns, one after the other."""

    def times(a: list[float], b: list[float]) -> list[float]:
        return [
            a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
            a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
            a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
            a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
        ]

    turn = [[math.cos(angle / 2), 0.0, 0.0, 0.0] for angle in (yaw_rad, pitch_rad, roll_rad)]
    for axis, angle in ((3, yaw_rad), (2, pitch_rad), (1, roll_rad)):
        turn[3 - axis][axis] = math.sin(angle / 2)
    return times(times(turn[0], turn[1]), turn[2])


def hil(
    ned_m: Ned,
    yaw_rad: float = 0.0,
    velocity_mps: Ned = (0.0, 0.0, 0.0),
    tilt_rad: tuple[float, float] = (0.0, 0.0),
    rates_radps: Ned = (0.0, 0.0, 0.0),
    time_us: int = 0,
) -> Any:
    """HIL_STATE_QUATERNION as PX4 sends it: everything cut off, not rounded, and no stamp. Tilt is (pitch, roll)."""
    north_m, east_m, down_m = ned_m
    lat_deg = LAT_DEG + north_m / PX4_M_PER_DEG
    lon_deg = LON_DEG + east_m / (PX4_M_PER_DEG * math.cos(math.radians(LAT_DEG)))
    return mavlink.MAVLink_hil_state_quaternion_message(
        *(time_us, quaternion(yaw_rad, *tilt_rad), *rates_radps),
        *(int(lat_deg * 1e7), int(lon_deg * 1e7), int((ALT_M - down_m) * 1e3)),
        *(int(speed * 1e2) for speed in velocity_mps),
        *(0, 0, 0, 0, 0),
    )


def sim(ned_m: Ned, yaw_rad: float = 0.0, velocity_mps: Ned = (0.0, 0.0, 0.0)) -> Any:
    """SIM_STATE as ArduPilot sends it: lat and lon in single precision are 1e7 times too large."""
    north_m, east_m, down_m = ned_m
    lat_deg = LAT_DEG + north_m / ARDUPILOT_M_PER_DEG
    lon_deg = LON_DEG + east_m / (ARDUPILOT_M_PER_DEG * math.cos(math.radians(LAT_DEG)))
    return mavlink.MAVLink_sim_state_message(
        *(*quaternion(yaw_rad), 0.0, 0.0, yaw_rad, 0.0, 0.0, -9.81, 0.0, 0.0, 0.0),
        *(lat_deg * 1e7, lon_deg * 1e7, ALT_M - down_m, 0.0, 0.0, *velocity_mps),
        *(int(lat_deg * 1e7), int(lon_deg * 1e7)),
    )


def heartbeat(autopilot: int, armed: bool = False) -> Any:
    """HEARTBEAT of a quadrotor."""
    mode = mavlink.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0
    return mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_QUADROTOR, autopilot, mode, 0, 3, 3)


class Tap:
    """Takes what pymavlink sends, and decodes it again: what the autopilot would read."""

    def __init__(self) -> None:
        self.sender = mavlink.MAVLink(self, 1, 197)
        self.sent: list[Any] = []
        self._reader = mavlink.MAVLink(None)

    def write(self, data: bytes) -> None:
        self.sent.append(self._reader.decode(bytearray(data)))

    def named(self, name: str) -> list[Any]:
        return [message for message in self.sent if message.get_type() == name]
