"""The ground ahead as heights by distance, in each sector of the image."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from companion.geometry import camera_to_level, pixel_tangents
from companion.model import DepthFrame
from companion.perception.ground import SECTORS, STEP_M, STEP_TOLERANCE_M, ground_at, ground_profiles
from companion.perception.view import View
from tests.perception.scenes import AT_START, CAMERA, FLOOR, H_M, ROOF, Surface, frame, ramp, tilted, wall_ahead

MAX_SLOPE = 0.7
CELLS = math.ceil(CAMERA.max_range_m / STEP_M)
CENTRES_M = (np.arange(CELLS) + 0.5) * STEP_M
ROUNDING_M = 1e-5
"""Depths are float32: 1e-6 of 10 m."""


def profiles(image: DepthFrame, max_slope: float = MAX_SLOPE, h_m: float = H_M) -> tuple[NDArray[np.float64], int]:
    camera = image.camera
    view = View(
        image.depth_m,
        *pixel_tangents(camera),
        *camera_to_level(camera, image.pose),
        camera.min_range_m,
        camera.max_range_m,
    )
    heights, seen = ground_profiles(view, h_m, max_slope)
    return heights, seen


def half_planes(at_m: float, near_m: float, far_m: float) -> list[Surface]:
    """Level floors at two heights, the second from ``at_m`` on, with the step between them."""
    return [
        Surface((0.0, 0.0, near_m), (0.0, 0.0, 1.0), lambda points_m: points_m[..., 0] <= at_m),
        Surface((0.0, 0.0, far_m), (0.0, 0.0, 1.0), lambda points_m: points_m[..., 0] >= at_m),
        Surface(
            (at_m, 0.0, 0.0),
            (1.0, 0.0, 0.0),
            lambda points_m: (points_m[..., 2] >= min(near_m, far_m)) & (points_m[..., 2] <= max(near_m, far_m)),
        ),
    ]


@pytest.mark.parametrize(("pitch_deg", "roll_deg"), [(0.0, 0.0), (10.0, 0.0), (-10.0, 5.0), (0.0, -10.0)])
def test_flat_ground_is_flat_in_every_sector(pitch_deg: float, roll_deg: float) -> None:
    """Protects the usual case: the slab is the horizontal plane of the paper, whatever the tilt."""
    heights, seen = profiles(frame([FLOOR, ROOF], tilted(pitch_deg, roll_deg)))
    assert heights.shape == (SECTORS, CELLS)
    np.testing.assert_allclose(heights, -H_M, atol=ROUNDING_M)
    assert seen > 0


def test_nothing_seen_keeps_the_height_below_the_vehicle() -> None:
    """Protects the dark: without any ground in view it goes on level from where the down beam reads it."""
    for surfaces in ([], [ROOF]):
        heights, seen = profiles(frame(surfaces))
        np.testing.assert_array_equal(heights, -H_M)
        assert seen == 0


@pytest.mark.parametrize("rise", [-0.25, -0.1, 0.1, 0.25])
def test_a_ramp_is_followed_as_far_as_a_level_camera_sees_its_floor(rise: float) -> None:
    """Protects the slope worlds, up and down, and the stretch before the first ground in view.

    A cell has the height of its lowest point but one, at most one cell's rise below its middle; beyond the point where
    an up ramp is as high as the camera the last height stays.
    """
    pose = replace(AT_START, z_m=H_M + 20.0 * rise)
    heights, seen = profiles(frame(ramp(-20.0, rise), pose))
    there = np.ones(CELLS, np.bool_) if rise < 0.0 else np.less(CENTRES_M, H_M / rise - 2.0 * STEP_M)
    true = -H_M + rise * CENTRES_M
    # The two middle sectors look straight ahead.
    for sector in (SECTORS // 2 - 1, SECTORS // 2):
        np.testing.assert_allclose(heights[sector, there], true[there], atol=abs(rise) * STEP_M)
    assert seen > 0


def test_each_sector_has_its_own_ground() -> None:
    """Protects branches: a ramp that goes down on the left leaves the ground on the right level."""
    left_down = Surface((2.0, 0.0, 0.0), (0.25, 0.0, 1.0), lambda points_m: points_m[..., 1] > 0.0)
    left_flat = Surface(
        (0.0, 0.0, 0.0), (0.0, 0.0, 1.0), lambda points_m: (points_m[..., 1] > 0.0) & (points_m[..., 0] <= 2.0)
    )
    right = Surface((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), lambda points_m: points_m[..., 1] <= 0.0)
    clipped = replace(left_down, within=lambda points_m: (points_m[..., 1] > 0.0) & (points_m[..., 0] > 2.0))
    heights, _ = profiles(frame([left_flat, clipped, right]))
    # Sectors count from the left of the image. The first four of them see x > 6 m nowhere near the middle line.
    np.testing.assert_allclose(heights[SECTORS // 2 :], -H_M, atol=ROUNDING_M)
    assert (heights[1:5, CENTRES_M > 6.0] < -H_M - 0.25 * 2.0).all()


@pytest.mark.parametrize(("step_m", "followed"), [(0.1, True), (-0.1, True), (0.9, False)])
def test_a_kerb_is_ground_and_a_wall_is_not(step_m: float, followed: bool) -> None:
    """Protects rubble below STEP_TOLERANCE_M from being an obstacle, and a bench of 0.9 m from becoming the ground.

    With a slope limit of 0.1 the bench, 0.9 m up from one cell to the next, is steeper than it may be.
    """
    assert abs(step_m) < STEP_TOLERANCE_M or not followed
    heights, _ = profiles(frame([*half_planes(5.2, 0.0, step_m), ROOF]), max_slope=0.1)
    beyond = heights[SECTORS // 2, CENTRES_M > 6.0]
    np.testing.assert_allclose(beyond, -H_M + (step_m if followed else 0.0), atol=ROUNDING_M)


def test_ground_steeper_than_the_limit_is_not_followed() -> None:
    """Protects the setting max_ground_slope: a ramp of 45 % right ahead is an obstacle for a limit of 0.1."""
    pose = replace(AT_START, z_m=H_M + 20.0 * 0.45)
    image = frame(ramp(-20.0, 0.45), pose)
    followed, _ = profiles(image, max_slope=0.7)
    kept, _ = profiles(image, max_slope=0.1)
    middle = SECTORS // 2
    assert followed[middle, 4] == pytest.approx(-H_M + 0.45 * CENTRES_M[4], abs=0.45 * STEP_M)
    np.testing.assert_array_equal(kept[middle], -H_M)


@pytest.mark.parametrize("x_m", [1.0, 2.0, 3.1, 5.0, 8.0])
def test_a_wall_across_the_way_does_not_lift_the_ground(x_m: float) -> None:
    """Protects the slab before a wall: its foot stands on the ground, or is below the picture and says nothing."""
    heights, _ = profiles(frame([FLOOR, ROOF, wall_ahead(x_m)]))
    # The lowest point that the picture shows of the wall's foot is within one row of pixels, 1 cm per metre.
    np.testing.assert_allclose(heights, -H_M, atol=0.01 * x_m + ROUNDING_M)


def test_one_stray_pixel_digs_no_hole() -> None:
    """Protects against speckle below the floor: the second lowest point counts."""
    image = frame([FLOOR, ROOF])
    clean, _ = profiles(image)
    image.depth_m[100, 80] *= 1.3
    spoiled, _ = profiles(image)
    # A pixel is missing where it was and one too deep where it went: both cells have many others.
    np.testing.assert_allclose(spoiled, clean, atol=ROUNDING_M)


@given(st.lists(st.floats(-5.0, 5.0), min_size=1, max_size=30), st.floats(0.0, 40.0), st.floats(0.1, 5.0))
@settings(deadline=None)
def test_between_the_cells_the_ground_is_a_straight_line(heights: list[float], distance_m: float, h_m: float) -> None:
    """Protects `ground_at` against off-by-one: it agrees with numpy's interpolation through the cells' centres."""
    profile = np.array([heights])
    places = np.concatenate([[0.0], (np.arange(len(heights)) + 0.5) * STEP_M])
    expected = np.interp(distance_m, places, [-h_m, *heights])
    # Sums of a few numbers below 5 in double precision.
    assert ground_at(profile, 0, distance_m, h_m) == pytest.approx(expected, abs=1e-9)
