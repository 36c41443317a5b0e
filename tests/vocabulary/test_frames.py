"""ENU/FLU to and from NED/FRD: the cardinal cases by hand, and the same body in both frames."""

from __future__ import annotations

import math
from dataclasses import astuple

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from companion.frames import NedPose, bearing_from_frd, pose_from_ned, pose_to_ned, setpoint_to_frd
from companion.geometry import rotation
from companion.model import Pose, Setpoint, wrap_rad

lengths = st.floats(-1e4, 1e4)
angles = st.floats(-math.pi, math.pi, exclude_max=True)
tilts = st.floats(-1.5, 1.5)

poses = st.builds(
    Pose,
    t_s=st.floats(0.0, 1e6),
    x_m=lengths,
    y_m=lengths,
    z_m=lengths,
    yaw_rad=angles,
    roll_rad=tilts,
    pitch_rad=tilts,
    vx_mps=lengths,
    vy_mps=lengths,
    vz_mps=lengths,
    yaw_rate_radps=lengths,
)
ned_poses = st.builds(
    NedPose,
    t_s=st.floats(0.0, 1e6),
    north_m=lengths,
    east_m=lengths,
    down_m=lengths,
    roll_rad=tilts,
    pitch_rad=tilts,
    yaw_rad=angles,
    v_north_mps=lengths,
    v_east_mps=lengths,
    v_down_mps=lengths,
    yaw_rate_radps=lengths,
)

ENU_OF_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
FLU_OF_FRD = np.diag([1.0, -1.0, -1.0])


def assert_same(one: Pose | NedPose, other: Pose | NedPose) -> None:
    """Equal fields; the yaw as a direction, because -π and π are one."""
    for name in one.__dataclass_fields__:
        a, b = getattr(one, name), getattr(other, name)
        if name == "yaw_rad":
            # A quarter turn minus the angle and back again, each rounded by 2^-53 of π.
            assert abs(math.remainder(a - b, 2.0 * math.pi)) <= 1e-14
        else:
            assert a == b


# Angles.


@given(angle_rad=st.floats(-1e6, 1e6))
@example(angle_rad=math.pi)
@example(angle_rad=-math.pi)
@example(angle_rad=math.nextafter(math.pi, 0.0))
@example(angle_rad=math.nextafter(-math.pi, 0.0))
def test_wrapped_angles_are_in_the_half_open_turn(angle_rad: float) -> None:
    """The model promises [-π, π): π itself, counted in bearings, would be one past the end of a scan."""
    wrapped = wrap_rad(angle_rad)
    assert -math.pi <= wrapped < math.pi
    # The same direction: π is rounded by 1e-16, and that as often as there are turns in the angle.
    turns = abs(angle_rad) / math.pi + 1.0
    assert abs(math.remainder(wrapped - angle_rad, 2.0 * math.pi)) <= 1e-15 * turns


def test_the_angle_next_to_half_a_turn_wraps_below_it() -> None:
    """The number just below -π is rounded to a full turn by the modulo, and must not come out as π."""
    assert -math.pi <= wrap_rad(math.nextafter(-math.pi, -4.0)) < math.pi


@pytest.mark.parametrize(
    ("angle_rad", "wrapped_rad"),
    [
        (0.0, 0.0),
        (math.pi, -math.pi),
        (-math.pi, -math.pi),
        (1.5 * math.pi, -0.5 * math.pi),
        (-4.0, 2.0 * math.pi - 4.0),
    ],
)
def test_wrapping_by_hand(angle_rad: float, wrapped_rad: float) -> None:
    """The sign is kept: a little more than half a turn to the left is a little less than half to the right."""
    assert wrap_rad(angle_rad) == pytest.approx(wrapped_rad, abs=1e-15)


# Poses.


@given(pose=poses)
def test_a_pose_comes_back_from_ned(pose: Pose) -> None:
    """Out and in again is the identity, so nothing is lost or scaled on the way."""
    assert_same(pose_from_ned(pose_to_ned(pose)), pose)


@given(ned=ned_poses)
def test_a_ned_pose_comes_back_from_enu(ned: NedPose) -> None:
    """In and out again as well: the two are each other's inverse from either side."""
    assert_same(pose_to_ned(pose_from_ned(ned)), ned)


@pytest.mark.parametrize(
    ("yaw_deg", "heading_deg"),
    [
        pytest.param(0.0, 90.0, id="east"),
        pytest.param(90.0, 0.0, id="north"),
        pytest.param(-180.0, -90.0, id="west"),
        pytest.param(-90.0, -180.0, id="south"),
        pytest.param(45.0, 45.0, id="north-east"),
        pytest.param(135.0, -45.0, id="north-west"),
    ],
)
def test_yaw_counts_from_north_clockwise_in_ned(yaw_deg: float, heading_deg: float) -> None:
    """The compass card: ENU yaw from east to the left, NED yaw from north to the right."""
    ned = pose_to_ned(Pose(0.0, 0.0, 0.0, 0.0, math.radians(yaw_deg)))
    assert math.remainder(ned.yaw_rad - math.radians(heading_deg), 2.0 * math.pi) == pytest.approx(0.0, abs=1e-15)
    assert -math.pi <= ned.yaw_rad < math.pi


def test_east_north_up_is_north_east_down() -> None:
    """Position and velocity by hand: 1 east, 2 north, 3 up; and 4, 5, 6 of the speeds."""
    ned = pose_to_ned(Pose(7.0, 1.0, 2.0, 3.0, 0.0, vx_mps=4.0, vy_mps=5.0, vz_mps=6.0))
    assert (ned.t_s, ned.north_m, ned.east_m, ned.down_m) == (7.0, 2.0, 1.0, -3.0)
    assert (ned.v_north_mps, ned.v_east_mps, ned.v_down_mps) == (5.0, 4.0, -6.0)


def test_attitude_and_rates_by_hand() -> None:
    """Nose down is positive here and negative there; right side down is positive in both; left turns are negative."""
    ned = pose_to_ned(Pose(0.0, 0.0, 0.0, 0.0, 0.0, roll_rad=0.1, pitch_rad=0.2, yaw_rate_radps=0.3))
    assert (ned.roll_rad, ned.pitch_rad, ned.yaw_rate_radps) == (0.1, -0.2, -0.3)


@given(pose=poses)
def test_the_body_stands_in_both_frames_alike(pose: Pose) -> None:
    """The attitude as a rotation: Rz·Ry·Rx of the NED angles is the ENU one with the axes renamed, nothing else."""
    ned = pose_to_ned(pose)
    here = rotation(pose.yaw_rad, pose.pitch_rad, pose.roll_rad)
    there = rotation(ned.yaw_rad, ned.pitch_rad, ned.roll_rad)
    # Products of three sines, rounded a few times by 2^-53.
    np.testing.assert_allclose(ENU_OF_NED @ there @ FLU_OF_FRD, here, atol=1e-14)


@given(pose=poses)
def test_positions_and_velocities_are_the_same_vectors(pose: Pose) -> None:
    """East-north-up and north-east-down name one vector: the renaming is a swap and a sign, no scale."""
    ned = pose_to_ned(pose)
    np.testing.assert_array_equal(ENU_OF_NED @ [ned.north_m, ned.east_m, ned.down_m], [pose.x_m, pose.y_m, pose.z_m])
    np.testing.assert_array_equal(
        ENU_OF_NED @ [ned.v_north_mps, ned.v_east_mps, ned.v_down_mps], [pose.vx_mps, pose.vy_mps, pose.vz_mps]
    )


# Setpoints.


@pytest.mark.parametrize(
    ("setpoint", "sent"),
    [
        pytest.param(Setpoint(0.0, 0.5, 0.0, 0.0), (0.5, 0.0, 0.0, 0.0), id="forward is forward"),
        pytest.param(Setpoint(0.0, 0.0, 0.4, 0.0), (0.0, 0.0, -0.4, 0.0), id="climbing is negative down"),
        pytest.param(Setpoint(0.0, 0.0, -0.4, 0.0), (0.0, 0.0, 0.4, 0.0), id="sinking is positive down"),
        pytest.param(Setpoint(0.0, 0.0, 0.0, 0.6), (0.0, 0.0, 0.0, -0.6), id="a left turn is negative"),
        pytest.param(Setpoint(0.0, 0.0, 0.0, -0.6), (0.0, 0.0, 0.0, 0.6), id="a right turn is positive"),
        pytest.param(Setpoint(0.0, -0.1, 0.0, 0.0), (-0.1, 0.0, 0.0, 0.0), id="backward is negative"),
        pytest.param(Setpoint(0.0, 0.0, 0.0, 0.0, 0.1), (0.0, -0.1, 0.0, 0.0), id="to the left is negative"),
        pytest.param(Setpoint(0.0, 0.0, 0.0, 0.0, -0.1), (0.0, 0.1, 0.0, 0.0), id="to the right is positive"),
    ],
)
def test_a_setpoint_is_sent_as_mavlink_means_it(setpoint: Setpoint, sent: tuple[float, ...]) -> None:
    """The one place where a wrong sign flies into a wall: each field by itself."""
    assert astuple(setpoint_to_frd(setpoint)) == sent


@given(yaw_rad=angles, rate_radps=st.floats(-3.0, 3.0), dt_s=st.floats(0.01, 0.1))
def test_a_turn_that_is_sent_turns_the_pose_that_comes_back(yaw_rad: float, rate_radps: float, dt_s: float) -> None:
    """Rate out and yaw in share their convention: an autopilot that obeys in NED turns the ENU yaw as was asked."""
    sent = setpoint_to_frd(Setpoint(0.0, 0.0, 0.0, rate_radps))
    before = pose_to_ned(Pose(0.0, 0.0, 0.0, 0.0, yaw_rad))
    after = NedPose(
        dt_s, 0.0, 0.0, 0.0, 0.0, 0.0, before.yaw_rad + sent.yaw_rate_radps * dt_s, 0.0, 0.0, 0.0, sent.yaw_rate_radps
    )
    pose = pose_from_ned(after)
    assert pose.yaw_rate_radps == rate_radps
    # Differences of angles up to 2π, each rounded.
    assert math.remainder(pose.yaw_rad - yaw_rad - rate_radps * dt_s, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-14)


# Bearings.


@pytest.mark.parametrize(
    ("clockwise_rad", "bearing_rad"),
    [
        pytest.param(0.0, 0.0, id="the heading"),
        pytest.param(math.pi / 2.0, -math.pi / 2.0, id="the right"),
        pytest.param(-math.pi / 2.0, math.pi / 2.0, id="the left"),
        pytest.param(math.pi, -math.pi, id="behind is -π from either side"),
        pytest.param(-math.pi, -math.pi, id="behind, the other way round"),
        pytest.param(1.5 * math.pi, math.pi / 2.0, id="the left, counted all the way round"),
    ],
)
def test_bearings_are_clockwise_in_mavlink(clockwise_rad: float, bearing_rad: float) -> None:
    """A wall on the right has a positive bearing there and a negative one here."""
    # Two additions of π, each rounded by 2^-52 of it.
    assert bearing_from_frd(clockwise_rad) == pytest.approx(bearing_rad, abs=2e-15)
