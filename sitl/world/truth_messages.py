"""What the simulators say of where the vehicle truly is, as a pose in metres from the first message."""

from __future__ import annotations

import enum
import math
from dataclasses import astuple, dataclass
from typing import Any

from companion.clock import ClockAlignment
from companion.frames import NedPose
from companion.geometry import angles_of

Triple = tuple[float, float, float]

PX4_EARTH_M = 6_371_000.0
ARDUPILOT_EARTH_M = 6_378_100.0
"""The radius with which each autopilot makes metres of degrees. With the other's, both would disagree with us by 0.1 %
of the way, which bends a map that is made of their positions and our depth."""

GRID_M = 1e-7 * math.pi / 180.0 * ARDUPILOT_EARTH_M
"""The grid of latitude and longitude in messages: 1.1 cm."""

LOCAL_PAIR_S = 0.1
"""ATTITUDE may be this much older than the LOCAL_POSITION_NED that it is paired with."""

LARGEST_DELAY_S = 0.05
"""A truth message is never believed to be older than this. Loopback takes a millisecond; what looks like more is a
simulator that could not keep up with real time and whose clock has fallen behind."""


TAU_S = 0.5
"""How long the velocity is believed before the position has its way."""

GAP_S = 0.5
"""After a silence this long the filter starts anew at the position."""


class TruthKind(enum.StrEnum):
    """Which message is taken for the truth."""

    AUTO = "auto"
    HIL = "hil"
    SIM = "sim"
    LOCAL = "local"


MESSAGES = {
    TruthKind.HIL: ("HIL_STATE_QUATERNION",),
    TruthKind.SIM: ("SIM_STATE",),
    TruthKind.LOCAL: ("LOCAL_POSITION_NED", "ATTITUDE"),
    TruthKind.AUTO: ("HIL_STATE_QUATERNION", "SIM_STATE"),
}


@dataclass(frozen=True, slots=True)
class Fix:
    """Latitude and longitude in degrees, altitude in m."""

    latitude_deg: float
    longitude_deg: float
    altitude_m: float


class TruthReader:
    """Makes poses of truth messages.

    HIL_STATE_QUATERNION (PX4) and SIM_STATE (ArduPilot) give latitude and longitude on a grid of 1.1 cm; rendered from
    there, the walls would jump by as much at every step. `PositionFilter` fills in between with the velocity.

    Time: a stamp of the simulator is moved to our clock by the least delay seen. PX4 sends 0 for a stamp and SIM_STATE
    has none: then it is the time of arrival, which loopback delays by about a millisecond.

    Args:
        kind: which message is the truth; AUTO stays with whichever comes first.
    """

    def __init__(self, kind: TruthKind) -> None:
        self.kind = kind
        self.origin: Fix | None = None
        """Where the vehicle was first, on the globe; None with local positions."""
        self.refused = 0
        self.alignment = ClockAlignment()
        self._filter = PositionFilter((GRID_M, GRID_M, 0.001))
        self._attitude: tuple[float, Any] | None = None
        self._last_s = -math.inf

    def on_message(self, message: Any, received_s: float) -> NedPose | None:
        """The true pose that a message tells, relative to the first; None for any other, and for what makes no sense.

        Args:
            message: as pymavlink decodes it.
            received_s: when it arrived.
        """
        name = message.get_type()
        if name not in MESSAGES[self.kind]:
            return None
        if self.kind is TruthKind.AUTO:
            self.kind = TruthKind.HIL if name == "HIL_STATE_QUATERNION" else TruthKind.SIM
        if name == "HIL_STATE_QUATERNION":
            pose = self._hil(message, received_s)
        elif name == "SIM_STATE":
            pose = self._sim(message, received_s)
        elif name == "ATTITUDE":
            self._attitude = (message.time_boot_ms * 1e-3, message)
            return None
        else:
            pose = self._local(message, received_s)
        if pose is None or not all(map(math.isfinite, astuple(pose))):
            self.refused += 1
            return None
        if pose.t_s <= self._last_s:  # two in one instant, or the alignment has just found a shorter delay
            return None
        self._last_s = pose.t_s
        return pose

    def _hil(self, message: Any, received_s: float) -> NedPose | None:
        angles = angles_of(message.attitude_quaternion)
        fix = Fix(message.lat * 1e-7, message.lon * 1e-7, message.alt * 1e-3)
        velocity = (message.vx * 0.01, message.vy * 0.01, message.vz * 0.01)
        t_s = self._stamp(message.time_usec * 1e-6, received_s)
        rates = (message.pitchspeed, message.yawspeed)
        return self._globe(t_s, angles, fix, velocity, rates, PX4_EARTH_M)

    def _sim(self, message: Any, received_s: float) -> NedPose | None:
        # Its lat and lon are single-precision: steps of 0.4 m. Firmware older than 2021 has no other.
        fix = Fix(message.lat_int * 1e-7, message.lon_int * 1e-7, message.alt)
        velocity = (message.vn, message.ve, message.vd)
        angles = (message.yaw, message.pitch, message.roll)
        return self._globe(received_s, angles, fix, velocity, (message.ygyro, message.zgyro), ARDUPILOT_EARTH_M)

    def _globe(
        self, t_s: float, angles: Triple | None, fix: Fix, velocity: Triple, rates: tuple[float, float], radius_m: float
    ) -> NedPose | None:
        # Before it knows its place, a simulator sends zeros.
        if angles is None or (fix.latitude_deg == 0.0 and fix.longitude_deg == 0.0):
            return None
        if not all(map(math.isfinite, (*angles, *velocity, *rates, fix.altitude_m))):
            return None
        if self.origin is None:
            self.origin = fix
        origin = self.origin
        middle_rad = math.radians(0.5 * (fix.latitude_deg + origin.latitude_deg))
        turn_deg = math.remainder(fix.longitude_deg - origin.longitude_deg, 360.0)
        measured = (
            math.radians(fix.latitude_deg - origin.latitude_deg) * radius_m,
            math.radians(turn_deg) * radius_m * math.cos(middle_rad),
            origin.altitude_m - fix.altitude_m,
        )
        place = self._filter.update(t_s, measured, velocity)
        yaw_rad, pitch_rad, roll_rad = angles
        yaw_rate_radps = _yaw_rate(roll_rad, pitch_rad, *rates)
        return NedPose(t_s, *place, roll_rad, pitch_rad, yaw_rad, *velocity, yaw_rate_radps)

    def _local(self, message: Any, received_s: float) -> NedPose | None:
        if self._attitude is None:
            return None
        there_s = message.time_boot_ms * 1e-3
        attitude_s, attitude = self._attitude
        later_s = there_s - attitude_s
        if abs(later_s) > LOCAL_PAIR_S:
            return None
        return NedPose(
            self._stamp(there_s, received_s),
            *(message.x, message.y, message.z),
            *(attitude.roll + attitude.rollspeed * later_s, attitude.pitch + attitude.pitchspeed * later_s),
            attitude.yaw + attitude.yawspeed * later_s,
            *(message.vx, message.vy, message.vz),
            _yaw_rate(attitude.roll, attitude.pitch, attitude.pitchspeed, attitude.yawspeed),
        )

    def _stamp(self, remote_s: float, received_s: float) -> float:
        if remote_s <= 0.0:
            return received_s
        self.alignment.add_one_way(remote_s, received_s)
        local_s = self.alignment.to_local_s(remote_s)
        return received_s if local_s is None else max(local_s, received_s - LARGEST_DELAY_S)


def _yaw_rate(roll_rad: float, pitch_rad: float, pitch_speed_radps: float, yaw_speed_radps: float) -> float:
    """How fast the heading turns, in rad/s, from the rates about the body's own axes."""
    level = max(math.cos(pitch_rad), 0.1)  # nose straight up or down there is no heading
    return (math.sin(roll_rad) * pitch_speed_radps + math.cos(roll_rad) * yaw_speed_radps) / level


class PositionFilter:
    """A complementary filter that never leaves the grid cell beside the measured one.

    x ← x + v·dt, then a share dt/TAU of the way to the measured position, then back to within one step of it. The true
    position is within one step of the measured one (a cell is rounded or cut off), so the error is at most **two
    steps** whatever the velocity says: 2.2 cm on the 1.1 cm grid of latitude and longitude. With a velocity that is
    right to 1 cm/s (HIL_STATE_QUATERNION cuts off there) it stays within 1.5 steps, and it does not jump: between two
    messages it moves by v·dt and at most a share dt/TAU of a step.

    Args:
        steps_m: the grid along each axis, in m.
    """

    def __init__(self, steps_m: Triple) -> None:
        self._steps_m = steps_m
        self._place: Triple | None = None
        self._t_s = 0.0

    def update(self, t_s: float, measured_m: Triple, velocity_mps: Triple) -> Triple:
        """The smooth position at ``t_s``, in m."""
        dt_s = t_s - self._t_s
        self._t_s = t_s
        if self._place is None or not 0.0 <= dt_s <= GAP_S:
            self._place = measured_m
            return measured_m
        share = min(dt_s / TAU_S, 1.0)
        x, y, z = (
            _toward(place + speed * dt_s, measured, share, step)
            for place, measured, speed, step in zip(self._place, measured_m, velocity_mps, self._steps_m, strict=True)
        )
        self._place = (x, y, z)
        return self._place


def _toward(predicted: float, measured: float, share: float, step: float) -> float:
    smooth = predicted + share * (measured - predicted)
    return min(max(smooth, measured - step), measured + step)
