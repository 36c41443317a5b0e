"""What is sent to the autopilot: odometry and distances."""

from __future__ import annotations

import enum
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import common as mavlink

from companion.frames import NedPose, bearing_from_frd, pose_to_ned
from companion.geometry import quaternion, rotation
from companion.model import Beam, PlanarScan, RangeReading
from sitl.world.odometry import Estimate, OdometrySettings

ORIENTATIONS = {
    Beam.FRONT: mavlink.MAV_SENSOR_ROTATION_NONE,
    Beam.RIGHT: mavlink.MAV_SENSOR_ROTATION_YAW_90,
    Beam.BACK: mavlink.MAV_SENSOR_ROTATION_YAW_180,
    Beam.LEFT: mavlink.MAV_SENSOR_ROTATION_YAW_270,
    Beam.UP: mavlink.MAV_SENSOR_ROTATION_PITCH_90,
    Beam.DOWN: mavlink.MAV_SENSOR_ROTATION_PITCH_270,
}

BINS = 72
UNKNOWN_CM = 65535
LEAST_RANGE_CM = 5
LARGEST_CM = 65533

_STEP_RAD = 2.0 * math.pi / BINS
_BEARINGS_RAD = np.array([bearing_from_frd(k * _STEP_RAD) for k in range(BINS)])
"""The bearing, as we count it, of the middle of each bin of OBSTACLE_DISTANCE."""

_BEAM_RAD = {Beam.FRONT: 0.0, Beam.LEFT: math.pi / 2.0, Beam.BACK: -math.pi, Beam.RIGHT: -math.pi / 2.0}


class Feed(enum.StrEnum):
    """With which messages the odometry leaves."""

    NONE = "none"
    ODOMETRY = "odometry"
    VISION = "vision"


class LocalFrame(enum.StrEnum):
    """In which frame ODOMETRY leaves to PX4."""

    LOCAL_NED = "local_ned"
    LOCAL_FRD = "local_frd"


class Outgoing:
    """Encodes for one autopilot.

    Args:
        sender: pymavlink's encoder, which sends what it encodes.
        feed: how odometry leaves.
        settings: the odometry's, for the covariances that go with it.
        frame: what PX4 is told that the odometry's frame is. LOCAL_NED whatever its heading: a real tracker knows no
            north either, and without GPS and compass PX4 takes its x axis for it. ArduPilot takes LOCAL_FRD alone.
    """

    def __init__(
        self, sender: Any, feed: Feed, settings: OdometrySettings, frame: LocalFrame = LocalFrame.LOCAL_NED
    ) -> None:
        self._sender = sender
        self._feed = feed
        self._frame = frame
        # Upper triangles of 6x6 and 3x3, row by row. An estimator that gets 0 trusts without limit.
        variances = [max(settings.position_noise_m, 0.005) ** 2] * 3 + [
            max(settings.attitude_noise_rad, 0.002) ** 2
        ] * 3
        speeds = [max(settings.velocity_noise_mps, 0.01) ** 2] * 3
        self._pose_covariance = _upper_triangle(variances)
        self._twist_covariance = _upper_triangle([*speeds, *[0.01**2] * 3])
        self._speed_covariance = [speed for i in range(3) for speed in (speeds[0] if i == j else 0.0 for j in range(3))]

    def odometry(self, estimate: Estimate, ardupilot: bool) -> None:
        """Sends one estimate, stamped with its own time in µs of our clock.

        Neither autopilot believes that stamp: PX4 takes the time of arrival unless it has aligned its clock over
        TIMESYNC, which the world never answers, and ArduPilot corrects it by the least delay.

        Args:
            estimate: the tracker's.
            ardupilot: it takes no other frame than LOCAL_FRD.
        """
        ned = pose_to_ned(estimate.pose)
        time_usec, resets = int(ned.t_s * 1e6), estimate.resets % 256
        place = (ned.north_m, ned.east_m, ned.down_m)
        if self._feed is Feed.ODOMETRY:
            ned_frame = self._frame is LocalFrame.LOCAL_NED and not ardupilot
            frame = mavlink.MAV_FRAME_LOCAL_NED if ned_frame else mavlink.MAV_FRAME_LOCAL_FRD
            self._sender.odometry_send(
                *(time_usec, frame, mavlink.MAV_FRAME_BODY_FRD, *place),
                quaternion(ned.yaw_rad, ned.pitch_rad, ned.roll_rad),
                *(*_body_velocity(ned), 0.0, 0.0, ned.yaw_rate_radps),
                *(self._pose_covariance, self._twist_covariance, resets, mavlink.MAV_ESTIMATOR_TYPE_VIO, 100),
            )
        elif self._feed is Feed.VISION:
            speed = (ned.v_north_mps, ned.v_east_mps, ned.v_down_mps)
            angles = (ned.roll_rad, ned.pitch_rad, ned.yaw_rad)
            self._sender.vision_position_estimate_send(time_usec, *place, *angles, self._pose_covariance, resets)
            self._sender.vision_speed_estimate_send(time_usec, *speed, self._speed_covariance, resets)

    def distances(self, readings: Sequence[RangeReading]) -> None:
        """Sends a DISTANCE_SENSOR for each beam that measured something; at the range limit it says the limit."""
        for number, reading in enumerate(readings):
            if reading.range_m is None:
                continue
            limit_cm = _cm(reading.max_range_m)
            self._sender.distance_sensor_send(
                *(int(reading.t_s * 1e3) & 0xFFFFFFFF, LEAST_RANGE_CM, limit_cm, min(_cm(reading.range_m), limit_cm)),
                *(mavlink.MAV_DISTANCE_SENSOR_LASER, number, ORIENTATIONS[reading.beam], 255),
            )

    def obstacles(self, t_s: float, distances_cm: Sequence[int], max_range_m: float) -> None:
        """Sends one OBSTACLE_DISTANCE in the body's frame."""
        self._sender.obstacle_distance_send(
            *(int(t_s * 1e6), mavlink.MAV_DISTANCE_SENSOR_LASER, distances_cm, round(360 / BINS), LEAST_RANGE_CM),
            *(_cm(max_range_m), 360.0 / BINS, 0.0, mavlink.MAV_FRAME_BODY_FRD),
        )


def bins_of_beams(readings: Sequence[RangeReading]) -> list[int]:
    """The 72 distances in cm, clockwise from the heading, that horizontal beams know; the other bins are unknown."""
    bearings, ranges = [], []
    for reading in readings:
        if reading.beam in _BEAM_RAD and reading.range_m is not None:
            bearings.append(_BEAM_RAD[reading.beam])
            ranges.append(reading.range_m)
    limit_m = max((reading.max_range_m for reading in readings), default=0.0)
    return _bins(np.array(bearings), np.array(ranges), limit_m)


def bins_of_planar(scan: PlanarScan) -> list[int]:
    """The 72 distances in cm, clockwise from the heading: the nearest of the rays in each bin."""
    return _bins(scan.bearings_rad, scan.ranges_m, scan.max_range_m)


def _bins(bearings_rad: NDArray[np.float64], ranges_m: NDArray[np.float64], limit_m: float) -> list[int]:
    out = np.full(BINS, UNKNOWN_CM, np.int64)
    known = ~np.isnan(ranges_m)
    bearings, ranges = bearings_rad[known], ranges_m[known]
    if bearings.size:
        apart = np.abs(np.angle(np.exp(1j * (bearings[:, None] - _BEARINGS_RAD[None, :]))))
        # One more than the limit says "nothing there".
        far_cm = _cm(limit_m) + 1
        cm = np.where(ranges >= limit_m, far_cm, np.clip(np.round(ranges * 100.0), 0, far_cm)).astype(np.int64)
        np.minimum.at(out, apart.argmin(axis=1), cm)
    return [int(value) for value in out]


def _body_velocity(ned: NedPose) -> tuple[float, float, float]:
    """The velocity along the body's forward, right and down axes, in m/s."""
    turn = rotation(ned.yaw_rad, ned.pitch_rad, ned.roll_rad)
    forward, right, down = turn.T @ (ned.v_north_mps, ned.v_east_mps, ned.v_down_mps)
    return float(forward), float(right), float(down)


def _cm(length_m: float) -> int:
    return min(max(round(length_m * 100.0), 0), LARGEST_CM)


def _upper_triangle(variances: Sequence[float]) -> list[float]:
    size = len(variances)
    return [variances[i] if i == j else 0.0 for i in range(size) for j in range(i, size)]
