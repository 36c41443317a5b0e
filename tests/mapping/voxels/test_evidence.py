"""What a pixel may say of a voxel, and what it may not."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from companion.config.mapping import MapSettings
from companion.mapping import FREE, OCCUPIED, UNKNOWN, VoxelMap
from tests.mapping.voxels.scenes import EXACT, camera, contents, frame, one_pixel, pose, rays, room_depth, to_world

AXIS = np.array([1.0, 0.02, 0.02])
"""Times a depth, a point next to the optical axis of a camera at the origin."""


def test_wall_free_before_unknown_behind() -> None:
    """Protects the three states: free up to the wall, occupied at it, unknown behind it."""
    voxels = VoxelMap(EXACT)
    voxels.integrate(frame(camera(), pose(), 3.05))
    depths_m = np.array([0.15, 1.05, 2.05, 2.95, 3.05, 3.15, 3.55, 4.95, 6.0])
    assert voxels.classify(depths_m[:, np.newaxis] * AXIS).tolist() == [FREE] * 4 + [OCCUPIED] + [UNKNOWN] * 4


@settings(max_examples=25, deadline=None)
@given(arrays(np.float32, (30, 40), elements=st.sampled_from([np.nan, 0.0, 0.1, -1.0, -np.inf])))
def test_pixels_that_say_nothing_change_nothing(depth: np.ndarray) -> None:
    """Protects "missing is not zero": NaN, zero, negative and too near pixels neither free nor fill a single voxel."""
    voxels = VoxelMap(EXACT)
    voxels.integrate(frame(camera(40, 30), pose(), 2.0))
    before = contents(voxels)
    report = voxels.integrate(frame(camera(40, 30), pose(), depth))
    assert contents(voxels) == before
    assert (report.hits, report.misses, report.pixels_hit + report.pixels_clear, report.pixels_invalid) == (
        0,
        0,
        0,
        1200,
    )


def test_nothing_is_known_where_only_nan_was_seen() -> None:
    """Protects "unknown is not free": the half of the image without readings leaves its half of the room unknown."""
    cam = camera()
    depth = np.full((60, 80), 3.05)
    depth[:, :40] = np.nan
    voxels = VoxelMap(EXACT)
    voxels.integrate(frame(cam, pose(), depth))
    # The left half of the image is y > 0. A voxel is judged by its centre, so none with its centre there is free.
    assert (voxels.free()[:, 1] < 0.0).all()
    assert (voxels.occupied()[:, 1] < 0.0).all()


def test_a_hole_of_one_pixel_is_clear_as_far_as_the_rays_beside_it_pass_through_the_same_voxels() -> None:
    """Protects what is near and what is far.

    A camera that always leaves out the same pixel must not leave a line of unknown voxels before it; far away, where a
    voxel is as small as a pixel, the neighbours see past what may be there.
    """
    cam = camera(81, 61)
    # A row of voxels has its centres in the middle pixel.
    at = pose(0.005, 0.051, 0.051)
    depth = np.full((61, 81), np.nan)
    depth[30, 40] = 4.55
    lone, around = VoxelMap(EXACT), VoxelMap(EXACT)
    lone.integrate(frame(cam, at, depth))
    depth = np.full((61, 81), 4.55)
    depth[30, 40] = np.nan
    around.integrate(frame(cam, at, depth))
    # At most one pixel holds a voxel's centre. Half a voxel is 0.05 m, of which it takes sqrt(2.5) px to be sure.
    until_m = 0.05 * cam.fx_px / math.sqrt(2.5)
    near, far = lone.free()[lone.free()[:, 0] < until_m], lone.free()[lone.free()[:, 0] > until_m + 0.01]
    assert len(near) > 5
    assert len(far) > 20
    assert (around.classify(near) == FREE).all()
    assert (around.classify(far) == UNKNOWN).all()


def test_a_wider_hole_stays_a_hole() -> None:
    """Protects "unknown is not free": beside a pixel with nothing above and below it, no ray passes near enough."""
    cam = camera(81, 61)
    depth = np.full((61, 81), 4.55)
    depth[:, 40] = np.nan
    voxels = VoxelMap(EXACT)
    voxels.integrate(frame(cam, pose(0.005, 0.005, 0.005), depth))
    depth = np.where(np.isnan(depth), 4.55, np.nan)
    lone = VoxelMap(EXACT)
    lone.integrate(frame(cam, pose(0.005, 0.005, 0.005), depth))
    assert len(lone.free()) > 100
    assert (voxels.classify(lone.free()) == UNKNOWN).all()


@pytest.mark.parametrize(("map_m", "camera_m"), [(3.0, 10.0), (5.0, 3.0)], ids=["map's limit", "camera's limit"])
@pytest.mark.parametrize("reading_m", [3.0, 4.0, 20.0, np.inf])
def test_at_the_limit_free_up_to_it_and_no_hit(map_m: float, camera_m: float, reading_m: float) -> None:
    """Protects the range limits: a reading at or beyond the nearer one frees the space up to there, nothing more."""
    voxels = VoxelMap(EXACT.model_copy(update={"max_range_m": map_m}))
    report = voxels.integrate(frame(camera(max_range_m=camera_m), pose(), reading_m))
    assert report.hits == 0
    assert report.pixels_clear == 80 * 60
    assert voxels.free()[:, 0].max() == pytest.approx(2.95)
    assert voxels.classify(np.array([[2.95, 0.05, 0.05], [3.05, 0.05, 0.05]])).tolist() == [FREE, UNKNOWN]


def test_a_voxel_hit_twice_is_occupied_by_default() -> None:
    """Protects the default sensor model: one look is not believed, a second one that agrees is."""
    voxels = VoxelMap(MapSettings())
    wall = frame(camera(), pose(), 2.05)
    voxels.integrate(wall)
    assert voxels.classify(2.05 * AXIS[np.newaxis]) == [UNKNOWN]
    assert voxels.counts().undecided > 0
    voxels.integrate(wall)
    assert voxels.classify(2.05 * AXIS[np.newaxis]) == [OCCUPIED]


@settings(max_examples=25, deadline=None)
@given(st.floats(0.3, 5.9), st.integers(0, 39), st.integers(0, 29), st.integers(2, 40))
def test_a_voxel_hit_often_enough_is_occupied(depth_m: float, u: int, v: int, extra: int) -> None:
    """Protects the weight of far hits: they count less, but never so little that a surface is missed for good.

    At 6 m the noise is 7.2 cm, so a hit counts 1 / (1 + (2 · 7.2 / 10)²) = 0.33 of log-odds 0.85: four reach 0.85.
    """
    cam = camera(40, 30)
    voxels = VoxelMap(MapSettings())
    shot = one_pixel(cam, pose(), u, v, depth_m)
    for _ in range(4 + extra):
        voxels.integrate(shot)
    end = to_world(cam, pose(), rays(cam)[v, u] * np.float32(depth_m))
    # Near its border rounding may put the end point into the next voxel.
    assert voxels.occupied_near(end[np.newaxis]) == [True]
    assert voxels.counts().occupied == 1


def test_what_has_gone_is_freed_and_what_came_is_filled() -> None:
    """Protects the clamps: certainty is bounded, so a map can change its mind within a few looks.

    From the upper clamp, 3.48, at -0.41 a look it takes nine to come below zero; from the lower, -1.99, at 0.85 three.
    """
    voxels = VoxelMap(EXACT)
    near, far = frame(camera(), pose(), 2.05), frame(camera(), pose(), 4.05)
    for _ in range(50):
        voxels.integrate(near)
    for _ in range(9):
        voxels.integrate(far)
    assert voxels.classify(2.05 * AXIS[np.newaxis]) == [FREE]
    for _ in range(50):
        voxels.integrate(far)
    for _ in range(3):
        voxels.integrate(near)
    assert voxels.classify(2.05 * AXIS[np.newaxis]) == [OCCUPIED]


def test_a_floor_seen_at_a_slant_has_no_holes() -> None:
    """Protects "hits win over misses": pixels that look over a floor voxel to the next one must not free it.

    The camera flies 0.45 m above the floor, where the rows of pixels meet it as flat as 6°.
    """
    cam = camera()
    low, high = np.array([-9.0, -9.0, -0.45]), np.array([9.0, 9.0, 9.0])
    voxels = VoxelMap(EXACT)
    ends: list[np.ndarray] = []
    for step in range(20):
        at = pose(0.07 * step)
        depth = room_depth(cam, at, low, high)
        voxels.integrate(frame(cam, at, depth))
        # A tenth of a voxel inside the range, so that the end point is a hit whichever way it is rounded.
        seen = depth < EXACT.max_range_m - 0.01
        ends.append(to_world(cam, at, rays(cam)[seen] * depth[seen][:, np.newaxis]))
    floor = np.concatenate(ends)
    floor = floor[floor[:, 2] < -0.449]
    assert len(floor) > 1000
    # The floor lies in the middle of its voxels, so rounding cannot put an end point above or below them.
    assert (voxels.classify(floor) == OCCUPIED).mean() > 0.999
    assert not (voxels.classify(floor) == FREE).any()


def test_hits_win_over_misses() -> None:
    """Protects the same, made sharp: where misses weigh more than hits, a voxel that has both must still fill.

    The wall is in the far half of its voxels, so each of their centres is seen to be clear in every frame.
    """
    wary = EXACT.model_copy(update={"hit_probability": 0.6, "miss_probability": 0.2})
    voxels = VoxelMap(wary)
    report = voxels.integrate(frame(camera(), pose(), 3.09))
    assert voxels.classify(3.09 * AXIS[np.newaxis]) == [OCCUPIED]
    assert (report.hits, report.misses) == (voxels.counts().occupied, voxels.counts().free)


def test_a_thin_pillar_survives_looks_past_it() -> None:
    """Protects thin obstacles: a pillar one pixel wide in front of a far wall is hit, though most rays pass it."""
    depth = np.full((60, 80), 4.55)
    depth[:, 40] = 2.05
    voxels = VoxelMap(EXACT)
    for _ in range(10):
        voxels.integrate(frame(camera(), pose(), depth))
    # Column 40 is half a pixel right of the axis: y = -2.05 · 0.5 / 40.
    assert voxels.classify(np.array([[2.05, -0.0256, 0.05], [2.05, -0.0256, -0.35]])).tolist() == [OCCUPIED] * 2


def test_the_report_counts() -> None:
    """Protects what is logged in flight: pixels add up to the image, chunks to the map."""
    depth = np.full((60, 80), 3.05)
    depth[0, :] = np.nan
    depth[1, :] = 9.0
    voxels = VoxelMap(EXACT)
    report = voxels.integrate(frame(camera(), pose(), depth))
    assert (report.pixels_hit, report.pixels_clear, report.pixels_invalid) == (80 * 58, 80, 80)
    counts = voxels.counts()
    assert (report.hits, report.misses) == (counts.occupied, counts.free)
    assert report.chunks_new == report.chunks_updated == counts.chunks
    assert voxels.integrate(frame(camera(), pose(), depth)).chunks_new == 0
