"""What the autopilot reads, field by field, decoded from the bytes that were sent."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mavlink

from companion.model import Beam, PlanarScan, Pose, RangeReading
from sitl.world.mavlink_out import UNKNOWN_CM, Feed, LocalFrame, Outgoing, bins_of_beams, bins_of_planar
from sitl.world.odometry import Align, Estimate, OdometrySettings
from tests.sitl.world.messages import Tap, quaternion

NORTH_RAD = math.pi / 2
EVERY_BEAM = (Beam.FRONT, Beam.LEFT, Beam.BACK, Beam.RIGHT, Beam.DOWN, Beam.UP)

AHEAD_LEFT_UP = Pose(
    12.5, -1.0, 2.0, 3.0, NORTH_RAD + 0.4, roll_rad=0.1, pitch_rad=0.2, vx_mps=0.0, vy_mps=0.5, vz_mps=0.25,
    yaw_rate_radps=0.3,
)  # fmt: skip
"""In a tracker's frame whose x is called north: 2 m ahead, 1 m to the left, 3 m up, turned 0.4 to the left, nose down
by 0.2, right side down by 0.1, flying ahead and up and turning left."""


def outgoing(feed: Feed) -> tuple[Outgoing, Tap]:
    tap = Tap()
    return Outgoing(tap.sender, feed, OdometrySettings()), tap


def reading(beam: Beam, range_m: float | None, max_range_m: float = 8.0) -> RangeReading:
    return RangeReading(beam, 5.0, range_m, max_range_m)


def test_odometry_is_forward_right_down() -> None:
    """Each sign by hand; a mirrored axis here makes the vehicle fly away from where it should hold."""
    out, tap = outgoing(Feed.ODOMETRY)
    out.odometry(Estimate(AHEAD_LEFT_UP, 0), ardupilot=False)
    (message,) = tap.sent
    assert message.get_type() == "ODOMETRY"
    assert (message.x, message.y, message.z) == pytest.approx((2.0, -1.0, -3.0))
    assert message.q == pytest.approx(quaternion(-0.4, -0.2, 0.1), abs=1e-6)
    assert message.yawspeed == pytest.approx(-0.3)
    assert message.time_usec == 12_500_000
    assert message.estimator_type == mavlink.MAV_ESTIMATOR_TYPE_VIO
    assert message.child_frame_id == mavlink.MAV_FRAME_BODY_FRD
    assert (message.get_srcSystem(), message.get_srcComponent()) == (1, 197)


def test_the_velocity_of_odometry_is_along_the_body() -> None:
    """Level and looking left of the way: flying ahead in the frame is forward and to the right of the nose."""
    out, tap = outgoing(Feed.ODOMETRY)
    pose = Pose(1.0, 0.0, 0.0, 0.0, NORTH_RAD + 0.4, vy_mps=0.5, vz_mps=0.25)
    out.odometry(Estimate(pose, 0), ardupilot=False)
    (message,) = tap.sent
    expected = (0.5 * math.cos(0.4), 0.5 * math.sin(0.4), -0.25)
    assert (message.vx, message.vy, message.vz) == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize(
    ("asked", "ardupilot", "frame"),
    [
        (LocalFrame.LOCAL_NED, False, mavlink.MAV_FRAME_LOCAL_NED),
        (LocalFrame.LOCAL_NED, True, mavlink.MAV_FRAME_LOCAL_FRD),
        (LocalFrame.LOCAL_FRD, False, mavlink.MAV_FRAME_LOCAL_FRD),
        (LocalFrame.LOCAL_FRD, True, mavlink.MAV_FRAME_LOCAL_FRD),
    ],
)
@pytest.mark.parametrize("align", list(Align))
def test_the_frame_is_one_that_the_autopilot_takes(
    asked: LocalFrame, ardupilot: bool, frame: int, align: Align
) -> None:
    """PX4 lands where it is with LOCAL_NED alone, whatever its heading; ArduPilot takes LOCAL_FRD alone."""
    tap = Tap()
    out = Outgoing(tap.sender, Feed.ODOMETRY, OdometrySettings(align=align), asked)
    out.odometry(Estimate(AHEAD_LEFT_UP, 0), ardupilot)
    assert tap.sent[0].frame_id == frame


def test_covariances_say_how_large_the_noise_is() -> None:
    """21 numbers of the upper triangle: the diagonal at 0, 6, 11, 15, 18 and 20; zero would be trusted blindly."""
    tap = Tap()
    settings = OdometrySettings(position_noise_m=0.1, attitude_noise_rad=0.0, velocity_noise_mps=0.2)
    Outgoing(tap.sender, Feed.ODOMETRY, settings).odometry(Estimate(AHEAD_LEFT_UP, 0), ardupilot=False)
    pose, twist = tap.sent[0].pose_covariance, tap.sent[0].velocity_covariance
    assert [pose[i] for i in (0, 6, 11)] == pytest.approx([0.01] * 3)
    assert all(pose[i] > 0.0 for i in (15, 18, 20))
    assert [twist[i] for i in (0, 6, 11)] == pytest.approx([0.04] * 3)
    assert pose[1] == twist[1] == 0.0


def test_vision_messages_are_in_the_local_frame() -> None:
    """Position with angles, and the velocity not turned into the body."""
    out, tap = outgoing(Feed.VISION)
    out.odometry(Estimate(AHEAD_LEFT_UP, 300), ardupilot=True)
    position, speed = tap.sent
    assert (position.get_type(), speed.get_type()) == ("VISION_POSITION_ESTIMATE", "VISION_SPEED_ESTIMATE")
    assert (position.x, position.y, position.z) == pytest.approx((2.0, -1.0, -3.0))
    assert (position.roll, position.pitch, position.yaw) == pytest.approx((0.1, -0.2, -0.4))
    assert (speed.x, speed.y, speed.z) == pytest.approx((0.5, 0.0, -0.25))
    assert position.usec == speed.usec == 12_500_000
    assert position.reset_counter == speed.reset_counter == 300 % 256


def test_no_feed_sends_nothing() -> None:
    """An autopilot with GPS gets no second opinion unasked."""
    out, tap = outgoing(Feed.NONE)
    out.odometry(Estimate(AHEAD_LEFT_UP, 0), ardupilot=False)
    assert tap.sent == []


def test_each_beam_has_its_orientation() -> None:
    """MAV_SENSOR_ORIENTATION turns clockwise: right is YAW_90 (2), left YAW_270 (6); up is PITCH_90, down PITCH_270."""
    out, tap = outgoing(Feed.NONE)
    out.distances([reading(beam, 1.234) for beam in EVERY_BEAM])
    assert [message.orientation for message in tap.sent] == [0, 6, 4, 2, 25, 24]
    assert {message.current_distance for message in tap.sent} == {123}
    assert {(message.min_distance, message.max_distance) for message in tap.sent} == {(5, 800)}
    assert len({message.id for message in tap.sent}) == 6
    assert {message.time_boot_ms for message in tap.sent} == {5000}


def test_a_beam_that_measured_nothing_says_nothing() -> None:
    """Any number would be taken for a distance; and free out to the limit is the limit, not beyond."""
    out, tap = outgoing(Feed.NONE)
    out.distances([reading(Beam.FRONT, None), reading(Beam.DOWN, 8.0)])
    assert [(message.orientation, message.current_distance) for message in tap.sent] == [(25, 800)]


def test_beams_fill_their_bins_and_no_other() -> None:
    """Clockwise from the nose, 5 degrees each: right is bin 18. What no beam sees is unknown, not free."""
    bins = bins_of_beams(
        [
            reading(Beam.FRONT, 1.0),
            reading(Beam.RIGHT, 2.0),
            reading(Beam.BACK, 8.0),
            reading(Beam.LEFT, None),
            reading(Beam.DOWN, 0.5),
        ]
    )
    assert len(bins) == 72
    assert {k: cm for k, cm in enumerate(bins) if cm != UNKNOWN_CM} == {0: 100, 18: 200, 36: 801}


def test_a_scanner_gives_the_nearest_of_each_bin() -> None:
    """Rays a degree apart; one obstacle ahead to the left, one ray without a reading, the rest free."""
    bearings = np.radians(np.arange(-180.0, 180.0))
    ranges = np.full(360, np.inf)
    ranges[180 + 31], ranges[180 + 32] = 3.0, 2.5
    ranges[180 - 90] = np.nan
    bins = bins_of_planar(PlanarScan(1.0, bearings, ranges, 10.0, Pose(1.0, 0, 0, 0, 0)))
    # 30 degrees to the left are 330 clockwise: bin 66 is its middle, and reaches 2.5 degrees to either side.
    assert bins[66] == 250
    assert {cm for k, cm in enumerate(bins) if k != 66} == {1001}


def test_obstacle_distance_is_in_the_frame_of_the_body() -> None:
    """ArduPilot and PX4 take frame 12; in frame 0 the obstacles would stand still when the vehicle turns."""
    out, tap = outgoing(Feed.NONE)
    out.obstacles(5.0, bins_of_beams([reading(Beam.FRONT, 1.0)]), 8.0)
    (message,) = tap.sent
    assert (message.frame, message.increment, message.increment_f, message.angle_offset) == (12, 5, 5.0, 0.0)
    assert (message.min_distance, message.max_distance, message.distances[0]) == (5, 800, 100)
    assert message.time_usec == 5_000_000


@pytest.mark.parametrize("range_m", [0.0, 1e6])
def test_no_range_breaks_the_encoding(range_m: float) -> None:
    """Centimetres are 16 bits."""
    out, tap = outgoing(Feed.NONE)
    out.distances([reading(Beam.FRONT, range_m, 1e6)])
    out.obstacles(5.0, bins_of_beams([reading(Beam.FRONT, range_m, 1e6)]), 1e6)
    assert len(tap.sent) == 2
