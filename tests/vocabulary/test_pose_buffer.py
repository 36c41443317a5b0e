"""The pose at any time between the samples, and none where it is not known."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.model import Pose, wrap_rad
from companion.pose_buffer import EXTRAPOLATION_S, GAP_S, NEAREST_ATTITUDE_S, SAMPLES, PoseBuffer

angles = st.floats(-math.pi, math.pi, exclude_max=True)
shares = st.floats(0.0, 1.0)
metres = st.floats(-1e4, 1e4)


def buffer_of(yaws_rad: list[float], period_s: float = 0.02, speed_mps: float = 1.0) -> PoseBuffer:
    """Samples from time 10 on, flying east at a steady speed."""
    poses = PoseBuffer()
    for i, yaw_rad in enumerate(yaws_rad):
        t_s = 10.0 + i * period_s
        poses.add_attitude(t_s, 0.0, 0.0, yaw_rad, 0.5)
        poses.add_position(t_s, speed_mps * i * period_s, 2.0, 3.0, speed_mps, 0.0, 0.0)
    return poses


def known(pose: Pose | None) -> Pose:
    assert pose is not None
    return pose


@given(metres, metres, angles, angles, shares)
def test_between_two_samples_the_pose_lies_between_them(
    first_m: float, second_m: float, first_rad: float, second_rad: float, share: float
) -> None:
    """Protects the map: a frame is placed on the way between two poses, never beside it."""
    poses = PoseBuffer()
    for t_s, x_m, yaw_rad in ((5.0, first_m, first_rad), (5.1, second_m, second_rad)):
        poses.add_attitude(t_s, 0.1, -0.1, yaw_rad, 0.0)
        poses.add_position(t_s, x_m, -x_m, 1.0, 0.0, 0.0, 0.0)
    t_s = min(5.0 + 0.1 * share, 5.1)
    pose = known(poses.at(t_s))
    assert pose.t_s == t_s
    assert min(first_m, second_m) <= pose.x_m <= max(first_m, second_m)
    assert min(-first_m, -second_m) <= pose.y_m <= max(-first_m, -second_m)
    assert pose.z_m == 1.0
    assert [pose.roll_rad, pose.pitch_rad] == pytest.approx([0.1, -0.1])
    turn_rad = abs(wrap_rad(second_rad - first_rad))
    assert abs(wrap_rad(pose.yaw_rad - first_rad)) <= turn_rad + 1e-9, "the short way, also over ±π"
    assert abs(wrap_rad(pose.yaw_rad - second_rad)) <= turn_rad + 1e-9
    assert -math.pi <= pose.yaw_rad < math.pi


def test_half_way_over_the_seam_is_the_seam() -> None:
    """Protects against the long way round: half way between 179° and -179° is not 0°."""
    poses = buffer_of([math.pi - 0.02, -math.pi + 0.02])
    assert abs(known(poses.at(10.01)).yaw_rad) == pytest.approx(math.pi)


@given(st.floats(-1.0, 3.0))
def test_nothing_is_known_outside_the_samples_but_a_little_ahead(t_s: float) -> None:
    """Protects against placing a frame with a pose that was never measured."""
    poses = PoseBuffer()
    for i in range(11):
        poses.add_attitude(0.1 * i, 0.0, 0.0, 0.2, 0.5)
        poses.add_position(0.1 * i, 0.1 * i, 0.0, 0.0, 1.0, 0.0, 0.0)
    pose = poses.at(t_s)
    if 0.0 <= t_s <= 1.0:
        assert known(pose).x_m == pytest.approx(t_s)
    elif 1.0 < t_s <= 1.0 + EXTRAPOLATION_S - 1e-9:
        assert known(pose).x_m == pytest.approx(t_s), "by the velocity of the newest"
        assert known(pose).yaw_rad == pytest.approx(0.2 + 0.5 * (t_s - 1.0))
    elif t_s < 0.0 or t_s > 1.0 + EXTRAPOLATION_S + 1e-9:
        assert pose is None


@pytest.mark.parametrize(("gap_s", "there"), [(GAP_S - 0.01, True), (GAP_S + 0.01, False)])
def test_over_a_gap_nothing_is_known(gap_s: float, there: bool) -> None:
    """Protects against a straight line through a dropout in which the vehicle turned."""
    poses = buffer_of([0.0, 0.0], period_s=gap_s)
    assert (poses.at(10.0 + 0.5 * gap_s) is not None) is there
    assert poses.at(10.0 + gap_s) is not None, "at the sample itself it is known"


def test_both_kinds_are_needed() -> None:
    """Protects against a position with the attitude of long ago."""
    poses = PoseBuffer()
    assert poses.newest() is None
    poses.add_position(5.0, 1.0, 2.0, 3.0, 0.0, 0.0, 0.0)
    assert poses.newest() is None
    assert poses.at(5.0) is None
    poses.add_attitude(5.0 - NEAREST_ATTITUDE_S - 0.01, 0.0, 0.0, 1.0, 0.0)
    assert poses.newest() is None
    poses.add_attitude(5.0 - NEAREST_ATTITUDE_S + 0.01, 0.0, 0.0, 1.0, 0.0)
    assert known(poses.newest()).t_s == 5.0
    assert known(poses.newest()).yaw_rad == 1.0
    poses.add_attitude(5.02, 0.0, 0.0, 1.0 + 0.6, 0.0)
    assert known(poses.newest()).yaw_rad == pytest.approx(1.4), "interpolated when there are samples around"


numbers = st.floats(allow_nan=True, allow_infinity=True)


@given(st.lists(st.tuples(st.booleans(), *[numbers] * 7), max_size=30), st.lists(numbers, max_size=10))
def test_no_number_that_comes_in_makes_nan_come_out(
    samples: list[tuple[bool, float, float, float, float, float, float, float]], asked: list[float]
) -> None:
    """Protects the navigator from one malformed message."""
    poses = PoseBuffer()
    poses.add_attitude(0.0, 0.0, 0.0, 0.0, 0.0)
    poses.add_position(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    for is_attitude, t_s, a, b, c, d, e, f in samples:
        if is_attitude:
            poses.add_attitude(t_s, a, b, c, d)
        else:
            poses.add_position(t_s, a, b, c, d, e, f)
    for pose in (poses.newest(), *(poses.at(t_s) for t_s in (0.0, 0.01, *asked))):
        if pose is not None:
            assert all(math.isfinite(getattr(pose, name)) for name in Pose.__slots__)


def test_samples_that_go_back_in_time_are_refused_and_counted() -> None:
    """Protects the order: a replayed packet must not move the vehicle back."""
    poses = buffer_of([0.0] * 5)
    newest = poses.newest()
    poses.add_attitude(10.01, 0.0, 0.0, 3.0, 0.0)
    poses.add_position(10.08, 99.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    poses.add_position(10.2, math.nan, 0.0, 0.0, 0.0, 0.0, 0.0)
    poses.add_position(10.2, 1e30, 0.0, 0.0, 0.0, 0.0, 0.0)
    assert poses.refused == 4
    assert poses.newest() == newest


def test_memory_is_bounded_by_time_and_by_count() -> None:
    """Protects a flight of hours, and against a flood of messages."""
    poses = buffer_of([0.0] * 500)
    assert poses.at(10.0 + 499 * 0.02 - 2.1) is None
    assert poses.at(10.0 + 499 * 0.02 - 1.9) is not None
    flooded = buffer_of([0.0] * (SAMPLES + 100), period_s=1e-4)
    assert len(flooded._attitudes.samples) == len(flooded._positions.samples) == SAMPLES


def test_cleared_it_knows_nothing_and_begins_anew_at_any_time() -> None:
    """Protects the time after a restart of the autopilot: the old poses are of another world."""
    poses = buffer_of([0.0] * 5)
    poses.clear()
    assert poses.newest() is None
    assert poses.at(10.02) is None
    poses.add_attitude(1.0, 0.0, 0.0, 0.0, 0.0)
    poses.add_position(1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    assert known(poses.at(1.0)).t_s == 1.0
