"""Rotations by hand: where the nose, the left side and the roof of a turned body point, and where its camera looks."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import ArrayLike, NDArray

from companion.geometry import (
    angles_of,
    camera_to_level,
    camera_to_world,
    pixel_tangents,
    quaternion,
    rotation,
    rotation_of,
)
from companion.model import Camera, Pose

QUARTER = math.pi / 2.0
ROUNDING = 1e-14
"""Of sums and products of a few sines, each rounded by 2^-53; cos(π/2) alone is 6e-17."""

angles = st.floats(-10.0, 10.0)
offsets = st.floats(-1.0, 1.0)

CAMERA = Camera(
    width_px=160,
    height_px=120,
    fx_px=80.0,
    fy_px=75.0,
    cx_px=79.5,
    cy_px=59.5,
    min_range_m=0.25,
    max_range_m=10.0,
)
mounted = st.builds(
    replace,
    st.just(CAMERA),
    mount_x_m=offsets,
    mount_y_m=offsets,
    mount_z_m=offsets,
    mount_yaw_rad=angles,
    mount_pitch_rad=angles,
)
poses = st.builds(
    Pose, t_s=st.just(0.0), x_m=offsets, y_m=offsets, z_m=offsets, yaw_rad=angles, roll_rad=angles, pitch_rad=angles
)


def about_z(angle_rad: float) -> NDArray[np.float64]:
    """Counter-clockwise seen from above."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def about_y(angle_rad: float) -> NDArray[np.float64]:
    """From up towards forward: the nose goes down."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def about_x(angle_rad: float) -> NDArray[np.float64]:
    """From left towards up: the left side rises."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


@pytest.mark.parametrize(
    ("yaw_pitch_roll", "forward", "left", "up"),
    [
        pytest.param((0.0, 0.0, 0.0), [1, 0, 0], [0, 1, 0], [0, 0, 1], id="level, east"),
        pytest.param((QUARTER, 0.0, 0.0), [0, 1, 0], [-1, 0, 0], [0, 0, 1], id="turned left: north"),
        pytest.param((-QUARTER, 0.0, 0.0), [0, -1, 0], [1, 0, 0], [0, 0, 1], id="turned right: south"),
        pytest.param((0.0, QUARTER, 0.0), [0, 0, -1], [0, 1, 0], [1, 0, 0], id="nose down"),
        pytest.param((0.0, 0.0, QUARTER), [1, 0, 0], [0, 0, 1], [0, -1, 0], id="left side up"),
        pytest.param((QUARTER, QUARTER, 0.0), [0, 0, -1], [-1, 0, 0], [0, 1, 0], id="north, then nose down"),
        pytest.param((QUARTER, 0.0, QUARTER), [0, 1, 0], [0, 0, 1], [1, 0, 0], id="north, then left side up"),
        pytest.param((0.0, QUARTER, QUARTER), [0, 0, -1], [1, 0, 0], [0, -1, 0], id="nose down of a rolled body"),
    ],
)
def test_rotation_by_hand(
    yaw_pitch_roll: tuple[float, float, float], forward: ArrayLike, left: ArrayLike, up: ArrayLike
) -> None:
    """Where nose, left side and roof point in the world: the columns of the matrix."""
    np.testing.assert_allclose(rotation(*yaw_pitch_roll), np.transpose([forward, left, up]), atol=ROUNDING)


@given(yaw_rad=angles, pitch_rad=angles, roll_rad=angles)
def test_rotation_is_yaw_of_pitch_of_roll(yaw_rad: float, pitch_rad: float, roll_rad: float) -> None:
    """Rz·Ry·Rx, in this order, against the three turns one by one."""
    product = about_z(yaw_rad) @ about_y(pitch_rad) @ about_x(roll_rad)
    np.testing.assert_allclose(rotation(yaw_rad, pitch_rad, roll_rad), product, atol=ROUNDING)


@given(yaw_rad=angles, pitch_rad=angles, roll_rad=angles)
def test_rotation_keeps_lengths_and_hands(yaw_rad: float, pitch_rad: float, roll_rad: float) -> None:
    """Orthogonal with determinant 1: nothing is stretched, and left stays left."""
    matrix = rotation(yaw_rad, pitch_rad, roll_rad)
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=ROUNDING)
    assert np.linalg.det(matrix) == pytest.approx(1.0, abs=ROUNDING)


def test_a_camera_sits_on_the_body_that_turns() -> None:
    """A camera 0.1 m ahead of the middle, looking left, on a body that faces north: it is north of it, looking west."""
    camera = replace(CAMERA, mount_x_m=0.1, mount_yaw_rad=QUARTER)
    matrix, position = camera_to_world(camera, Pose(0.0, 5.0, 6.0, 7.0, QUARTER))
    np.testing.assert_allclose(position, [5.0, 6.1, 7.0], atol=ROUNDING)
    np.testing.assert_allclose(matrix @ [1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], atol=ROUNDING)


def test_a_camera_mounted_pitched_looks_down() -> None:
    """A positive mount pitch points the camera at the ground ahead."""
    matrix, _ = camera_to_world(replace(CAMERA, mount_pitch_rad=math.radians(30.0)), Pose(0.0, 0.0, 0.0, 1.5, 0.0))
    np.testing.assert_allclose(matrix @ [1.0, 0.0, 0.0], [math.sqrt(3.0) / 2.0, 0.0, -0.5], atol=ROUNDING)


@given(camera=mounted, pose=poses)
def test_the_levelled_frame_is_the_world_without_heading_and_place(camera: Camera, pose: Pose) -> None:
    """Level and world differ by the yaw and the position alone, so heights above the vehicle are the same in both."""
    world, position = camera_to_world(camera, pose)
    level, offset = camera_to_level(camera, pose)
    heading = about_z(pose.yaw_rad)
    np.testing.assert_allclose(heading @ level, world, atol=ROUNDING)
    np.testing.assert_allclose(heading @ offset + [pose.x_m, pose.y_m, pose.z_m], position, atol=ROUNDING)


def test_pixels_count_to_the_right_and_down() -> None:
    """The first column looks left, the first row up; the rays are symmetric about a centred axis."""
    left, up = pixel_tangents(CAMERA)
    assert (left.size, up.size) == (160, 120)
    assert left[0] == pytest.approx(79.5 / 80.0)
    assert up[0] == pytest.approx(59.5 / 75.0)
    assert np.all(np.diff(left) < 0.0)
    assert np.all(np.diff(up) < 0.0)
    np.testing.assert_allclose(left, -left[::-1], atol=ROUNDING)
    np.testing.assert_allclose(up, -up[::-1], atol=ROUNDING)


@given(cx_px=st.floats(0.0, 159.0), cy_px=st.floats(0.0, 119.0))
def test_the_ray_through_the_centre_is_the_axis(cx_px: float, cy_px: float) -> None:
    """A pixel's centre has integer coordinates: (u, v) = (cx, cy) looks straight ahead."""
    left, up = pixel_tangents(replace(CAMERA, cx_px=cx_px, cy_px=cy_px))
    # Coordinates of up to 160 px over a focal length of 80 px, each rounded.
    assert np.interp(-cx_px, -np.arange(160.0)[::-1], left[::-1]) == pytest.approx(0.0, abs=ROUNDING)
    assert np.interp(-cy_px, -np.arange(120.0)[::-1], up[::-1]) == pytest.approx(0.0, abs=ROUNDING)


@pytest.mark.parametrize("pool", [2, 3, 7])
def test_a_block_of_pixels_looks_along_the_mean_of_its_rays(pool: int) -> None:
    """Pooled images keep their geometry, also where the size is no multiple of the pool."""
    left, up = pixel_tangents(CAMERA)
    pooled_left, pooled_up = pixel_tangents(CAMERA, pool)
    for fine, coarse in ((left, pooled_left), (up, pooled_up)):
        whole = fine[: fine.size // pool * pool]
        np.testing.assert_allclose(coarse, whole.reshape(-1, pool).mean(axis=1), atol=ROUNDING)


@given(yaw_rad=angles, pitch_rad=angles, roll_rad=angles)
def test_the_quaternion_is_the_same_rotation(yaw_rad: float, pitch_rad: float, roll_rad: float) -> None:
    """V + 2w(u x v) + 2u x (u x v) for each axis, with u the vector part."""
    w, *u = quaternion(yaw_rad, pitch_rad, roll_rad)
    axes = np.eye(3)
    across = np.cross(u, axes)
    turned = axes + 2.0 * w * across + 2.0 * np.cross(u, across)
    np.testing.assert_allclose(turned.T, rotation(yaw_rad, pitch_rad, roll_rad), atol=ROUNDING)


def test_a_quaternion_gives_its_angles_back_or_none() -> None:
    """Protects what is read from MAVLink and from recordings."""
    turned = (-2.1, 0.4, -0.3)
    assert angles_of(quaternion(*turned)) == pytest.approx(turned)
    assert angles_of((0.0, 0.0, 0.0, 0.0)) is None
    assert angles_of((math.nan, 0.0, 0.0, 1.0)) is None


@given(
    yaw_rad=angles,
    pitch_rad=st.one_of(angles, st.sampled_from((-QUARTER, QUARTER)), st.floats(QUARTER - 1e-6, QUARTER + 1e-6)),
    roll_rad=angles,
    rounded=st.booleans(),
)
def test_the_angles_of_a_quaternion_are_its_rotation_straight_up_and_down_as_well(
    yaw_rad: float, pitch_rad: float, roll_rad: float, rounded: bool
) -> None:
    """Protects the heading of a vehicle that stands on its tail, also from a message in single precision."""
    numbers = np.array(quaternion(yaw_rad, pitch_rad, roll_rad), np.float32 if rounded else np.float64).tolist()
    found, turn = angles_of(numbers), rotation_of(numbers)
    assert found is not None
    assert turn is not None
    np.testing.assert_allclose(rotation(*found), turn, atol=2e-7)
    np.testing.assert_allclose(turn, rotation(yaw_rad, pitch_rad, roll_rad), atol=1e-6 if rounded else ROUNDING)
