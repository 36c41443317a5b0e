"""Readings end up where a hand calculation says, for each angle and each part of the mount."""

from __future__ import annotations

import math
from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.mapping import FREE, OCCUPIED, UNKNOWN, VoxelMap
from companion.model import Camera, Pose
from tests.mapping.voxels.scenes import EXACT, camera, contents, frame, one_pixel, pose, room_depth

QUARTER = math.pi / 2
SIN30, COS30 = 0.5, math.sqrt(3.0) / 2.0

odd = partial(camera, 81, 61)
"""An odd number of pixels has one on the optical axis: (40, 30). There fx = fy = 40.5 px."""

SIDE = 20 / 40.5
"""Twenty pixels from the axis, at depth 1."""


@pytest.mark.parametrize(
    ("cam", "at", "pixel", "depth_m", "expected_m"),
    [
        pytest.param(odd(), pose(1, 2, 3), (40, 30), 2.03, (3.03, 2, 3), id="straight ahead"),
        pytest.param(odd(), pose(), (20, 30), 2.03, (2.03, 2.03 * SIDE, 0), id="left in the image is left"),
        pytest.param(odd(), pose(), (40, 10), 2.03, (2.03, 0, 2.03 * SIDE), id="up in the image is up"),
        pytest.param(odd(), pose(yaw=QUARTER), (40, 30), 2.03, (0, 2.03, 0), id="yaw left looks north"),
        pytest.param(odd(), pose(pitch=math.pi / 6), (40, 30), 2.03, (2.03 * COS30, 0, -2.03 * SIN30), id="nose down"),
        pytest.param(odd(), pose(roll=QUARTER), (20, 30), 2.03, (2.03, 0, 2.03 * SIDE), id="roll lifts the left side"),
        pytest.param(
            odd(mount_m=(0.3, 0.2, 0.11)), pose(yaw=math.pi), (40, 30), 2.03, (-2.33, -0.2, 0.11), id="offset"
        ),
        pytest.param(
            odd(mount_m=(0.35, 0, 0)), pose(pitch=QUARTER), (40, 30), 2.03, (0, 0, -2.38), id="offset pitched"
        ),
        pytest.param(odd(mount_yaw_rad=QUARTER), pose(), (40, 30), 2.03, (0, 2.03, 0), id="mounted left"),
        pytest.param(odd(mount_pitch_rad=QUARTER), pose(), (40, 30), 2.03, (0, 0, -2.03), id="mounted down"),
        pytest.param(
            odd(mount_pitch_rad=QUARTER),
            pose(5, 5, 5, yaw=QUARTER),
            (20, 30),
            2.03,
            (5 - 2.03 * SIDE, 5, 2.97),
            id="mounted down, heading north: left in the image is west",
        ),
        pytest.param(
            odd(mount_yaw_rad=QUARTER),
            pose(roll=math.pi / 6),
            (40, 30),
            2.03,
            (0, 2.03 * COS30, 2.03 * SIN30),
            id="mounted left, rolled: looks up",
        ),
    ],
)
def test_reading_ends_where_it_should(
    cam: Camera, at: Pose, pixel: tuple[int, int], depth_m: float, expected_m: tuple[float, float, float]
) -> None:
    """Protects every sign and the order of the turns. Depths are such that no end lies on the border of a voxel."""
    voxels = VoxelMap(EXACT)
    # 5 mm, so that coordinates of exactly 0 lie inside a voxel.
    at = Pose(0.0, at.x_m + 0.005, at.y_m + 0.005, at.z_m + 0.005, at.yaw_rad, at.roll_rad, at.pitch_rad)
    report = voxels.integrate(one_pixel(cam, at, *pixel, depth_m))
    end = np.array([expected_m]) + 0.005
    assert report.hits == 1
    assert voxels.classify(end) == [OCCUPIED]
    assert len(voxels.occupied()) == 1
    # Half a voxel along each axis is how far a centre can be from a point in it.
    assert np.abs(voxels.occupied() - end).max() <= EXACT.voxel_m / 2


def test_depth_is_along_the_axis_not_along_the_ray() -> None:
    """Protects against treating depth as range: a flat wall across the image must stay flat out to its corners."""
    voxels = VoxelMap(EXACT)
    voxels.integrate(frame(camera(), pose(), 2.05))
    assert set(np.round(voxels.occupied()[:, 0], 6)) == {2.05}


shift = st.integers(-200, 200)


@settings(max_examples=30, deadline=None)
@given(shift, shift, shift, st.sampled_from([0, 1000, -60000]))
def test_moving_everything_by_whole_voxels_moves_the_map(i: int, j: int, k: int, far: int) -> None:
    """Protects negative coordinates and the borders of chunks: the same view from elsewhere gives the same map.

    The voxel is a power of two, so moving by whole ones changes no rounding near the origin; 60000 voxels away the last
    bits of the positions differ, which the room's walls in the middle of voxels allow for.
    """
    exact = EXACT.model_copy(update={"voxel_m": 0.125})
    cam = camera(40, 30)
    low, high = np.array([-1.0625, -0.9375, -0.5625]), np.array([2.0625, 1.1875, 1.0625])
    depth = room_depth(cam, pose(yaw=0.3, pitch=0.1), low, high)
    here, there = VoxelMap(exact), VoxelMap(exact)
    here.integrate(frame(cam, pose(yaw=0.3, pitch=0.1), depth))
    offset = 0.125 * np.array([i + far, j, k])
    there.integrate(frame(cam, pose(*offset, yaw=0.3, pitch=0.1), depth))
    assert _sorted(there.occupied() - offset) == _sorted(here.occupied())
    assert _sorted(there.free() - offset) == _sorted(here.free())


def _sorted(points: np.ndarray) -> list[tuple[int, ...]]:
    return sorted(tuple(row) for row in np.floor(points / 0.125).astype(int).tolist())


@pytest.mark.parametrize("field", ["x_m", "y_m", "z_m", "yaw_rad", "roll_rad", "pitch_rad"])
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_pose_that_is_not_finite_is_refused(field: str, value: float) -> None:
    """Protects the map from a broken pose estimate, and tells which number it was."""
    good = {"t_s": 0.0, "x_m": 0.0, "y_m": 0.0, "z_m": 0.0, "yaw_rad": 0.0, "roll_rad": 0.0, "pitch_rad": 0.0}
    voxels = VoxelMap(EXACT)
    with pytest.raises(ValueError, match=f"pose.{field}"):
        voxels.integrate(frame(camera(), Pose(**{**good, field: value}), 2.0))
    assert contents(voxels) == {}


def test_a_camera_that_is_not_finite_is_refused() -> None:
    """Protects the map from a calibration with a hole in it."""
    with pytest.raises(ValueError, match=r"camera\.mount_yaw_rad"):
        VoxelMap(EXACT).integrate(frame(camera(mount_yaw_rad=math.nan), pose(), 2.0))


def test_a_pose_outside_the_grid_is_refused() -> None:
    """Protects from two places sharing one key: chunk coordinates have 21 bits each."""
    with pytest.raises(ValueError, match="outside the map"):
        VoxelMap(EXACT).integrate(frame(camera(), pose(2.0e6), 2.0))


def test_an_image_of_another_size_is_refused() -> None:
    """Protects from a driver that changed its resolution: intrinsics would be wrong by a factor."""
    other = frame(camera(40, 30), pose(), 2.0)
    mixed = type(other)(0.0, other.depth_m, camera(80, 60), pose())
    with pytest.raises(ValueError, match=r"shape \(30, 40\), the camera is 60 px high"):
        VoxelMap(EXACT).integrate(mixed)


def test_nothing_is_known_before_the_first_frame() -> None:
    """Protects the meaning of an empty map: everything is unknown, which is not free."""
    points = np.array([[0.0, 0.0, 0.0], [-1e6, 3.0, 1e9]])
    voxels = VoxelMap(EXACT)
    assert (voxels.classify(points) == UNKNOWN).all()
    assert not voxels.occupied_near(points).any()
    assert [int(state) for state in (UNKNOWN, FREE, OCCUPIED)] == [0, 1, 2]
