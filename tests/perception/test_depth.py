"""From a depth image to HIT, CLEAR and UNKNOWN, on scenes whose answer is known by hand."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from numpy.typing import NDArray

from companion.config.sensors import CameraSettings
from companion.model import CLEAR, HIT, UNKNOWN, Camera, DepthFrame, Pose
from companion.perception.depth import AGREE_M, Slab, look_ahead
from companion.perception.look import Look, bin_bearings
from companion.perception.view import pool_nearest, view_of
from tests.perception.scenes import (
    AT_START,
    BINS,
    CAMERA,
    FINE_CAMERA,
    FLOOR,
    H_M,
    ROOF,
    Surface,
    between,
    board,
    frame,
    hit_points,
    ramp,
    render,
    tilted,
    wall_ahead,
    wall_beside,
)

SLAB = Slab(half_height_m=0.4, max_ground_slope=0.7)
FLAT_SLAB = Slab(half_height_m=0.4, max_ground_slope=1e-6)
"""The same slab, which may not follow the ground: the horizontal plane of the paper."""

BEARINGS = bin_bearings(BINS)
HALF_BIN_RAD = math.pi / BINS
EXACT_M = 1e-3
"""Depths are float32, 1e-6 of 10 m; nothing else is rounded."""

IN_VIEW = between(-40.0, 40.0)
"""The camera sees 43° to each side; roll by 10° turns its corners, and the bins at its edge hold half a bin."""

TILTS = list(itertools.product((-10.0, 0.0, 10.0), repeat=2))


def look(image: DepthFrame, slab: Slab = SLAB, h_m: float = H_M) -> Look:
    return look_ahead(view_of(image), image, h_m, slab, BINS)[0]


def slope(image: DepthFrame, slab: Slab = SLAB) -> float | None:
    return look_ahead(view_of(image), image, H_M, slab, BINS)[1]


def bin_at(bearing_deg: float) -> int:
    return int((math.radians(bearing_deg) + math.pi) / (2.0 * math.pi) * BINS)


def assert_on_walls(seen: Look, where: NDArray[np.bool_], *distances: NDArray[np.float64]) -> None:
    """In ``where`` everything is HIT, as far as the nearest of the walls is somewhere within that bin.

    Each of ``distances`` is (3, bins): one wall's distance at the right edge, the middle and the left edge of each bin.
    """
    wall = np.minimum.reduce(distances)
    np.testing.assert_array_equal(seen.state[where], HIT)
    assert (seen.ranges_m[where] >= wall.min(axis=0)[where] - EXACT_M).all()
    assert (seen.ranges_m[where] <= wall.max(axis=0)[where] + EXACT_M).all()


def distance_ahead(x_m: float) -> NDArray[np.float64]:
    with np.errstate(divide="ignore"):
        distance = x_m / np.cos(BEARINGS + np.array([[-HALF_BIN_RAD], [0.0], [HALF_BIN_RAD]]))
    return np.where(distance > 0.0, distance, np.inf)


def distance_beside(y_m: float) -> NDArray[np.float64]:
    with np.errstate(divide="ignore"):
        distance = y_m / np.sin(BEARINGS + np.array([[-HALF_BIN_RAD], [0.0], [HALF_BIN_RAD]]))
    return np.where(distance > 0.0, distance, np.inf)


class TestWalls:
    """Where walls are."""

    @pytest.mark.parametrize(("pitch_deg", "roll_deg"), TILTS)
    @pytest.mark.parametrize("x_m", [1.0, 2.0, 4.0, 7.0])
    def test_a_wall_ahead_is_at_its_distance_in_every_bin(self, x_m: float, pitch_deg: float, roll_deg: float) -> None:
        """Protects range, bearing and tilt compensation of the one thing that must never be missed."""
        seen = look(frame([FLOOR, ROOF, wall_ahead(x_m)], tilted(pitch_deg, roll_deg)))
        assert_on_walls(seen, IN_VIEW, distance_ahead(x_m))

    @pytest.mark.parametrize("side", [1.0, -1.0])
    def test_a_wall_on_the_left_has_positive_bearings(self, side: float) -> None:
        """Protects the sign of bearings: a mirrored scan flies into the wall it follows."""
        seen = look(frame([FLOOR, ROOF, wall_beside(2.0 * side)]))
        # From 12° on the wall is nearer than 10 m along the optical axis, which is as far as the camera sees.
        there = IN_VIEW & (side * BEARINGS > math.radians(12.0))
        assert_on_walls(seen, there, distance_beside(2.0 * side))
        assert (seen.state[IN_VIEW & (side * BEARINGS < 0.0)] == CLEAR).all()

    def test_bearings_count_from_the_heading_and_positions_from_the_vehicle(self) -> None:
        """Protects the look's own pose: the image is the same wherever the vehicle stands and wherever it looks."""
        pose = replace(AT_START, x_m=-3.0, y_m=40.0, yaw_rad=2.0)
        heading = (math.cos(2.0), math.sin(2.0), 0.0)
        at = (-3.0 + 4.0 * heading[0], 40.0 + 4.0 * heading[1], 0.0)
        seen = look(frame([FLOOR, ROOF, Surface(at, heading)], pose))
        assert_on_walls(seen, IN_VIEW, distance_ahead(4.0))
        assert (seen.x_m, seen.y_m, seen.yaw_rad) == (pose.x_m, pose.y_m, pose.yaw_rad)

    @pytest.mark.parametrize("mount_yaw_deg", [90.0, -90.0, -180.0])
    def test_a_camera_that_looks_elsewhere_reports_where_it_looks(self, mount_yaw_deg: float) -> None:
        """Protects the mount: its direction, the pitch of its own, and its distance from the middle of the body."""
        camera = CameraSettings(
            mount_x_m=-0.2, mount_y_m=0.3, mount_z_m=0.1, mount_yaw_deg=mount_yaw_deg, mount_pitch_deg=5.0
        ).model()
        walls = [wall_ahead(3.0), wall_ahead(-3.0), wall_beside(3.0), wall_beside(-3.0)]
        seen = look(frame([FLOOR, ROOF, *walls], camera=camera))
        off = np.abs((BEARINGS - math.radians(mount_yaw_deg) + np.pi) % (2.0 * np.pi) - np.pi)
        # Within 30° of its axis no wall but the one it looks at is in view, although it stands 0.3 m off the middle.
        there = off < math.radians(30.0)
        assert_on_walls(
            seen, there, distance_ahead(3.0), distance_ahead(-3.0), distance_beside(3.0), distance_beside(-3.0)
        )
        assert not seen.covered[off > math.radians(60.0)].any()

    def test_an_obstacle_counts_within_the_height_of_the_slab(self) -> None:
        """Protects the thickness of the slab: a bar at the body's height is in the way, one above or below is not."""
        half_m = SLAB.half_height_m
        for low_m, high_m, expected in (
            (H_M - 0.1, H_M + 0.1, HIT),
            (H_M + half_m - 0.2, H_M + half_m + 0.2, HIT),
            (H_M - half_m - 0.2, H_M - half_m + 0.2, HIT),
            (H_M + half_m + 0.1, H_M + half_m + 0.3, CLEAR),
        ):
            seen = look(frame([FLOOR, ROOF, board(4.0, 0.0, 20.0, low_m, high_m)]))
            np.testing.assert_array_equal(seen.state[IN_VIEW], expected, err_msg=f"{low_m} to {high_m}")


class TestGround:
    """Floor and roof are not obstacles."""

    @pytest.mark.parametrize(("pitch_deg", "roll_deg"), TILTS)
    def test_flat_floor_and_roof_are_clear_whatever_the_tilt(self, pitch_deg: float, roll_deg: float) -> None:
        """Protects tilt compensation: braking and turning must not turn the floor into a wall."""
        seen = look(frame([FLOOR, ROOF], tilted(pitch_deg, roll_deg)))
        assert not (seen.state == HIT).any()
        np.testing.assert_array_equal(seen.state[IN_VIEW], CLEAR)

    @pytest.mark.parametrize(("pitch_deg", "roll_deg"), [tilt for tilt in TILTS if tilt != (0.0, 0.0)])
    def test_without_the_tilt_the_same_image_would_show_obstacles(self, pitch_deg: float, roll_deg: float) -> None:
        """Shows that the test before this one can fail: the image of a tilted camera under a level pose."""
        image = replace(frame([FLOOR, ROOF], tilted(pitch_deg, roll_deg)), pose=AT_START)
        assert (look(image, FLAT_SLAB).state == HIT).any()

    @pytest.mark.parametrize("rise", [math.tan(math.radians(15.0)), 0.25])
    @pytest.mark.parametrize("sign", [1.0, -1.0])
    @pytest.mark.parametrize("starts_at_m", [-20.0, 2.0, 4.0])
    def test_a_ramp_is_not_in_the_way(self, rise: float, sign: float, starts_at_m: float) -> None:
        """Protects the slope worlds: a slab that follows the ground keeps the way free where a plane meets the floor.

        A level camera sees the floor of an up ramp only up to its own height, H/slope = 5.6 m away at 15°. From there
        the slab goes on level, and the floor comes into it (2 H - half)/slope = 9.7 m away: nothing before 9 m.
        """
        slope_here = sign * rise
        pose = replace(AT_START, z_m=H_M + max(0.0, -starts_at_m) * slope_here)
        image = frame(ramp(starts_at_m, slope_here), pose)
        # The side walls, 2 m away, are further than the camera's 10 m within this bearing.
        ahead = between(-10.0, 10.0)
        seen = look(image)
        assert (seen.state[ahead] != UNKNOWN).all()
        assert (seen.ranges_m[ahead] > 9.0).all()
        if starts_at_m < 4.0:  # at 4 m the tolerance of the walk is enough to get onto the ramp
            on_plane = look(image, FLAT_SLAB)
            assert (on_plane.state[ahead] == HIT).all()
            # The plane is met where the floor, or the roof, is half a slab away: this far from the bend, and one row of
            # pixels further, 0.5° of a surface that is seen at 17° or more.
            met_m = max(0.0, starts_at_m) + (H_M - FLAT_SLAB.half_height_m) / rise
            assert (np.abs(on_plane.ranges_m[ahead] * np.cos(BEARINGS[ahead]) - met_m) < 0.3).all()

    @pytest.mark.parametrize("rise", [-math.tan(math.radians(15.0)), -0.25, -0.1, 0.1, 0.25, 0.268])
    def test_the_slope_ahead_has_the_sign_and_the_size_of_the_ramp(self, rise: float) -> None:
        """Protects the feed-forward of the height law: up is positive.

        The ground is the lowest of a cell of 0.5 m, taken at the distance of its lowest point: the error is within one
        row of pixels, 0.5° or 1 cm per metre.
        """
        on_ramp = replace(AT_START, z_m=H_M + 20.0 * rise)
        assert slope(frame(ramp(-20.0, rise), on_ramp)) == pytest.approx(rise, abs=0.01)

    @pytest.mark.parametrize(("pitch_deg", "roll_deg"), TILTS)
    def test_flat_ground_has_no_slope_whatever_the_tilt(self, pitch_deg: float, roll_deg: float) -> None:
        """Protects the height law from climbing when the vehicle only pitches."""
        # Depths are float32 and everything else exact.
        assert slope(frame([FLOOR, ROOF], tilted(pitch_deg, roll_deg))) == pytest.approx(0.0, abs=1e-5)

    @pytest.mark.parametrize("surfaces", [[], [ROOF], [wall_ahead(1.0)]])
    def test_no_ground_in_view_means_no_slope(self, surfaces: list[Surface]) -> None:
        """Protects unknown from being taken for level; at 1 m the foot of a wall is below the picture."""
        assert slope(frame(surfaces)) is None

    def test_the_slab_is_as_high_as_the_vehicle_flies(self) -> None:
        """Protects h: flying higher, the same bar is below the slab."""
        bar = board(4.0, 0.0, 20.0, H_M - 0.1, H_M + 0.1)
        higher = replace(AT_START, z_m=2.2)
        roof = Surface((0.0, 0.0, 6.0), (0.0, 0.0, 1.0))
        assert (look(frame([FLOOR, roof, bar])).state[IN_VIEW] == HIT).all()
        assert not (look(frame([FLOOR, roof, bar], higher), h_m=2.2).state[IN_VIEW] == HIT).any()


class TestUnknown:
    """Unknown is not free."""

    def test_a_look_into_the_open_is_clear_out_to_the_limit_and_only_where_it_looks(self) -> None:
        """Protects CLEAR: range limit, and nothing said about bearings outside the picture."""
        seen = look(frame([FLOOR, ROOF]))
        assert (seen.ranges_m[seen.state == CLEAR] == CAMERA.max_range_m).all()
        outside = np.abs(BEARINGS) > math.radians(44.0)
        assert (seen.state[outside] == UNKNOWN).all()
        assert not seen.covered[outside].any()
        assert (seen.ranges_m[seen.state == UNKNOWN] == 0.0).all()
        assert seen.limit_m == CAMERA.max_range_m

    def test_a_wall_beyond_the_limit_is_clear(self) -> None:
        """Protects the range limit from both sides: a depth at the limit says free, one just below says wall."""
        assert (look(frame([FLOOR, ROOF, wall_ahead(10.2)])).state[IN_VIEW] == CLEAR).all()
        assert (look(frame([FLOOR, ROOF, wall_ahead(9.9)])).state[IN_VIEW] == HIT).all()

    def test_no_measurement_is_unknown(self) -> None:
        """Protects from a covered lens: an image of NaN must not say that the way is free."""
        image = frame([FLOOR, ROOF])
        image.depth_m[:] = np.nan
        seen = look(image)
        assert (seen.state == UNKNOWN).all()
        assert seen.covered[IN_VIEW].all()

    def test_a_wall_nearer_than_the_camera_measures_is_unknown(self) -> None:
        """Protects the blind zone: 0.2 m before the lens there is NaN, not free space."""
        seen = look(frame([FLOOR, ROOF, wall_ahead(0.3)]))
        assert (seen.state[IN_VIEW] == UNKNOWN).all()

    @pytest.mark.parametrize("surfaces", [[FLOOR, ROOF], [FLOOR, ROOF, wall_ahead(5.0)]])
    def test_a_dark_stripe_is_unknown_and_hides_nothing_else(self, surfaces: list[Surface]) -> None:
        """Protects from black rock: columns without a measurement are neither free nor taken from beside them."""
        image = frame(surfaces)
        bearing = np.arctan(-(np.arange(CAMERA.width_px) - CAMERA.cx_px) / CAMERA.fx_px)
        dark = np.abs(bearing - math.radians(20.0)) < math.radians(4.0)
        image.depth_m[:, dark] = np.nan
        seen = look(image)
        # The camera stands 0.1 m before the middle: that turns a point 5 m away at 20° by 0.4°.
        inside = np.abs(BEARINGS - math.radians(20.0)) < math.radians(2.5)
        beside = IN_VIEW & (np.abs(BEARINGS - math.radians(20.0)) > math.radians(6.0))
        assert (seen.state[inside] == UNKNOWN).all()
        assert (seen.state[beside] != UNKNOWN).all()

    @pytest.mark.parametrize("x_m", [3.0, 4.5, 6.0])
    def test_a_wall_that_gives_no_echo_stands_where_floor_and_roof_end(self, x_m: float) -> None:
        """Protects from wet coal: nothing comes back from the wall, and a vehicle flew into it at full speed."""
        image = frame([FLOOR, ROOF, wall_ahead(x_m)])
        on_wall = np.isclose(image.depth_m, x_m - 0.1, atol=EXACT_M)
        # All but a hand's breadth at its foot and at its top.
        rows = np.abs(np.arange(CAMERA.height_px) - CAMERA.cy_px) * x_m / CAMERA.fy_px < 1.3
        image.depth_m[on_wall & rows[:, None]] = np.nan
        seen = look(image)
        assert_on_walls(seen, IN_VIEW, distance_ahead(x_m))
        assert seen.inferred[IN_VIEW].all()
        assert not look(frame([FLOOR, ROOF, wall_ahead(x_m)])).inferred.any()

    def test_the_far_half_of_a_bearing_in_the_dark_is_not_clear(self) -> None:
        """Protects CLEAR from rays that are not level: those over and under the slab see far and prove nothing."""
        image = frame([FLOOR, ROOF])
        elevation = np.abs(np.arctan(-(np.arange(CAMERA.height_px) - CAMERA.cy_px) / CAMERA.fy_px))
        # At 10 m the slab of ± 0.4 m is 2.3° high each way.
        image.depth_m[elevation < math.radians(3.5)] = np.nan
        assert (look(image).state[IN_VIEW] == UNKNOWN).all()


class TestFlyingPixels:
    """One point alone is not believed."""

    @staticmethod
    def with_pixels(surfaces: list[Surface], *pixels: tuple[int, int, float]) -> DepthFrame:
        image = frame(surfaces)
        for v, u, depth_m in pixels:
            image.depth_m[v, u] = depth_m
        return image

    def test_one_alone_is_not_a_hit_and_two_that_agree_are(self) -> None:
        """Protects against stereo speckle on one side, and against throwing away thin obstacles on the other."""
        open_ground = [FLOOR, ROOF]
        ahead = between(-5.0, 5.0)
        alone = look(self.with_pixels(open_ground, (60, 80, 3.0)))
        assert (alone.state[ahead] == CLEAR).all()
        agreeing = look(self.with_pixels(open_ground, (60, 80, 3.0), (61, 80, 3.0 + AGREE_M / 2.0)))
        assert np.flatnonzero(agreeing.state == HIT).size == 1
        # The point lies 3 m before the lens, which is 0.1 m before the middle, half a pixel off the axis.
        assert agreeing.ranges_m[agreeing.state == HIT] == pytest.approx(3.1, abs=EXACT_M)

    def test_one_before_a_wall_does_not_bring_the_wall_nearer(self) -> None:
        """Protects d: the wall behind the speckle is what counts."""
        speckled = look(self.with_pixels([FLOOR, ROOF, wall_ahead(4.0)], (60, 80, 1.0)))
        assert_on_walls(speckled, IN_VIEW, distance_ahead(4.0))

    @pytest.mark.parametrize(
        ("surfaces", "share"),
        # A wall 4 m away fills 24 rows of the slab, of which two are enough; the open at 10 m has 10 rows a bin, of
        # which five must see out: more than half of them missing has a chance of 3e-6 in each bin at 5 %.
        [([FLOOR, ROOF], 0.05), ([FLOOR, ROOF, wall_ahead(4.0)], 0.3)],
    )
    def test_scattered_dropouts_hide_no_wall_and_close_no_way(self, surfaces: list[Surface], share: float) -> None:
        """Protects against dropouts: missing pixels among good ones leave every bin as it was."""
        image = frame(surfaces)
        whole = look(image)
        image.depth_m[np.random.default_rng(1).random(image.depth_m.shape) < share] = np.nan
        np.testing.assert_array_equal(look(image).state[IN_VIEW], whole.state[IN_VIEW])


class TestResolution:
    """A finer camera sees the same, and never less."""

    @given(
        arrays(
            np.float32,
            array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=13),
            elements=st.one_of(st.floats(0.125, 100.0, width=32), st.just(float("nan")), st.just(float("inf"))),
        ),
        st.integers(1, 5),
    )
    @settings(deadline=None)
    def test_pooling_keeps_the_nearest_of_each_block(self, depth_m: NDArray[np.float32], pool: int) -> None:
        """Protects thin obstacles: no block is further than its nearest pixel, none is free that was never measured."""
        pooled = pool_nearest(depth_m, pool)
        assert pooled.shape == (depth_m.shape[0] // pool, depth_m.shape[1] // pool)
        for (v, u), nearest in np.ndenumerate(pooled):
            block = depth_m[v * pool : (v + 1) * pool, u * pool : (u + 1) * pool]
            measured = block[~np.isnan(block)]
            expected = measured.min() if measured.size else np.nan
            np.testing.assert_equal(nearest, expected)

    @pytest.mark.parametrize("width_m", [0.02, 0.03])
    @pytest.mark.parametrize("y_m", [-1.03, 0.0, 0.5])
    def test_a_thin_pole_is_seen_in_a_large_image(self, width_m: float, y_m: float) -> None:
        """Protects cables and props: 2 cm at 4 m are 1.7 of 640 pixels, which every fourth pixel would overlook."""
        seen = look(frame([FLOOR, ROOF, board(4.0, y_m, width_m)], camera=FINE_CAMERA))
        points = hit_points(seen)
        assert len(points) > 0
        # A point is known to its bin, 1°, and its block of pixels, 0.7°: 12 cm at 4.1 m.
        np.testing.assert_allclose(points, np.broadcast_to((4.0, y_m), points.shape), atol=0.12)

    @pytest.mark.parametrize("camera", [CAMERA, FINE_CAMERA])
    def test_ranges_do_not_depend_on_the_resolution(self, camera: Camera) -> None:
        """Protects the choice of camera: both resolutions put every obstacle where the walls are.

        Pooled pixels stand for their block's middle: a point is off its true bearing by half a block, 0.35°, and a bin
        by half a bin, 0.5°. So it is off its wall by no more than its distance times that.
        """
        surfaces = [FLOOR, ROOF, wall_ahead(8.0), wall_beside(2.0), wall_beside(-1.5)]
        for pitch_deg, roll_deg in TILTS:
            seen = look(frame(surfaces, tilted(pitch_deg, roll_deg), camera))
            assert (seen.state[between(-30.0, 30.0)] == HIT).all()
            x, y = hit_points(seen).T
            off_m = np.minimum.reduce([np.abs(x - 8.0), np.abs(y - 2.0), np.abs(y + 1.5)])
            assert (off_m <= np.hypot(x, y) * math.radians(0.85) + EXACT_M).all()

    def test_dark_blocks_of_a_large_image_are_unknown(self) -> None:
        """Protects UNKNOWN through the pooling."""
        image = frame([FLOOR, ROOF], camera=FINE_CAMERA)
        image.depth_m[:, :320] = np.nan
        seen = look(image)
        assert (seen.state[IN_VIEW & between(1.0, 180.0)] == UNKNOWN).all()
        assert (seen.state[IN_VIEW & between(-180.0, -1.0)] == CLEAR).all()


FALSE_GROUND = [
    (2.389, math.inf, math.inf, 4.045, 6.356, -0.3047),
    (4.683, math.inf, math.inf, -9.390, -1.883, -0.0101),
    (5.272, 2.0, 2.0, 1.567, -6.117, 0.0312),
    (6.712, 2.0, 2.0, 1.322, 9.565, -0.0964),
    (8.0, 2.0, 1.5, 10.0, 0.0, 0.0),
]
"""Distance of walls ahead, left and right, pitch and roll in degrees, yaw in rad: drawn among a hundred as harmless."""


@pytest.mark.parametrize(("ahead_m", "left_m", "right_m", "pitch_deg", "roll_deg", "yaw_rad"), FALSE_GROUND)
def test_the_foot_of_a_wall_is_not_climbed(
    ahead_m: float, left_m: float, right_m: float, pitch_deg: float, roll_deg: float, yaw_rad: float
) -> None:
    """Protects the slab from being lifted by a wall: neither a false obstacle before it nor a hole in it."""
    pose = replace(tilted(pitch_deg, roll_deg), yaw_rad=yaw_rad)
    sides = [wall_beside(y_m) for y_m in (left_m, -right_m) if math.isfinite(y_m)]
    seen = look(frame([FLOOR, ROOF, wall_ahead(ahead_m), *sides], pose))
    np.testing.assert_array_equal(seen.state[IN_VIEW], HIT)
    forward, left = hit_points(seen).T
    x = forward * math.cos(yaw_rad) - left * math.sin(yaw_rad)
    y = forward * math.sin(yaw_rad) + left * math.cos(yaw_rad)
    off_m = np.minimum.reduce([np.abs(x - ahead_m), np.abs(y - left_m), np.abs(y + right_m)])
    assert (off_m <= np.hypot(x, y) * HALF_BIN_RAD + EXACT_M).all()


def test_an_image_is_not_changed_by_looking() -> None:
    """Protects the map, which is given the same image afterwards."""
    for camera in (CAMERA, FINE_CAMERA):
        image = frame([FLOOR, ROOF, wall_ahead(4.0)], camera=camera)
        kept = image.depth_m.copy()
        look(image)
        np.testing.assert_array_equal(image.depth_m, kept)


def test_render_agrees_with_one_ray_by_hand() -> None:
    """Checks the scenes themselves: one pixel of a camera that is turned, tilted and mounted off the middle."""
    camera = Camera(3, 3, 1.0, 1.0, 1.0, 1.0, 0.1, 100.0, mount_x_m=0.5)
    pose = Pose(0.0, 1.0, 2.0, 3.0, math.pi / 2.0, pitch_rad=math.radians(30.0))
    # Heading north with the nose 30° down, the lens is at (1, 2 + 0.5 cos 30°, 3 - 0.5 sin 30°) = (1, 2.433, 2.75),
    # and the middle ray goes down at 30°: to the floor along it are 2.75 / sin 30° = 5.5 m.
    assert render([FLOOR], camera, pose)[1, 1] == pytest.approx(5.5)
    # One pixel to the right is 45° to the right of it, east, as deep.
    assert render([FLOOR], camera, pose)[1, 2] == pytest.approx(5.5)
    # East of it, at x = 1 + 4, a wall is met at depth 4 by the ray that goes one aside per unit of depth.
    assert render([wall_ahead(5.0)], camera, pose)[1, 2] == pytest.approx(4.0)
    assert np.isinf(render([wall_ahead(5.0)], camera, pose)[1, 0])
    # Rolled to the left by 90° about the optical axis, left of the picture is down.
    rolled = replace(pose, pitch_rad=0.0, roll_rad=-math.pi / 2.0)
    assert render([FLOOR], camera, rolled)[1, 0] == pytest.approx(3.0)
    assert np.isinf(render([FLOOR], camera, rolled)[1, 2])
