"""Rays and depth images: on a box known by hand, and the renderer against rays through the same pixels."""

from __future__ import annotations

import functools
import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from companion.geometry import camera_to_world
from companion.model import Camera, Pose
from sitl.mines import World, load_world
from sitl.scene.raycast import RayCaster
from sitl.scene.render import DepthRenderer

WORLDS = Path(os.environ.get("BENCH_WORLDS", "worlds"))
"""Scanned mines, which are not part of the project."""

MESHES = ("darpa_cave_01", "edgar_mine", "koutzi_mine_kum", "subt_tunnel_practice_1")

SIDE_PX = 0.02
"""How far beside a pixel's centre the rays go that show whether an edge passes through it. Rays are float32: a
direction of length 1 is known to 6e-8 and a place 500 m from the origin to 3e-5 m, which is 0.01 px at 0.3 m."""

CAMERA = Camera(
    *(160, 120, 85.8, 85.8, 79.5, 59.5),
    min_range_m=0.3,
    max_range_m=10.0,
    mount_x_m=0.12,
    mount_y_m=-0.03,
    mount_z_m=0.05,
    mount_yaw_rad=0.2,
    mount_pitch_rad=-0.3,
)
LEVEL = Camera(161, 121, 80.0, 80.0, 80.0, 60.0, min_range_m=0.3, max_range_m=10.0)


@functools.cache
def scene(spec: str) -> tuple[World, RayCaster]:
    world = load_world(spec, seed=0)
    return world, RayCaster(world)


def poses(world: World, count: int, seed: int) -> list[Pose]:
    """Places in the middle of drifts, or about a mesh's start, with any heading and a good deal of tilt."""
    rng = np.random.default_rng(seed)
    tilt = [np.pi, 0.5, 0.5]
    if world.start is None:
        places = rng.choice(world.start_area_m, count) + rng.uniform([-0.8, -0.8, 0.4], [0.8, 0.8, 2.0], (count, 3))
    else:
        start = [world.start.x_m, world.start.y_m, world.start.z_m]
        places = np.array(start) + rng.uniform(-0.5, 0.5, (count, 3))
    return [
        Pose(0.0, *place.tolist(), *angles.tolist())
        for place, angles in zip(places, rng.uniform(np.negative(tilt), tilt, (count, 3)), strict=True)
    ]


def rays_px(camera: Camera, u: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
    """Directions in the camera's frame with a forward part of 1, so that ranges are depths."""
    return np.stack([np.ones(u.shape), (camera.cx_px - u) / camera.fx_px, (camera.cy_px - v) / camera.fy_px], axis=-1)


def compare(caster: RayCaster, camera: Camera, pose: Pose, image: NDArray[np.float32]) -> tuple[int, int]:
    """Compares an image with one ray through each pixel.

    Returns:
        how many pixels differ by more than 1 mm; and how many of those lie further than 1 mm outside what rays
        `SIDE_PX` beside the centre find, that is, are not on the outline of something nearer, or on a surface seen at
        so flat an angle that its depth changes that much within the pixel.
    """
    axes, place = camera_to_world(camera, pose)
    u, v = np.meshgrid(np.arange(float(camera.width_px)), np.arange(float(camera.height_px)))
    cast = caster.cast(place, rays_px(camera, u, v).reshape(-1, 3) @ axes.T).reshape(image.shape)
    limit = np.float32(camera.max_range_m)
    rendered, cast = np.minimum(image, limit), np.minimum(cast, limit)
    differ = np.abs(rendered - cast) > 1e-3
    if not differ.any():
        return 0, 0
    sides = np.array([[1, 0], [-1, 0], [0, 1], [0, -1], [1, 1], [-1, -1], [1, -1], [-1, 1]]) * SIDE_PX
    beside = rays_px(camera, u[differ][:, None] + sides[:, 0], v[differ][:, None] + sides[:, 1])
    depths = np.minimum(caster.cast(place, beside.reshape(-1, 3) @ axes.T).reshape(-1, len(sides)), limit)
    wrong = (rendered[differ] < depths.min(axis=1) - 1e-3) | (rendered[differ] > depths.max(axis=1) + 1e-3)
    return int(differ.sum()), int(wrong.sum())


@pytest.mark.parametrize("spec", ["complex", "slope", "room", "random:1"])
def test_depths_are_those_of_rays_through_the_pixels(spec: str) -> None:
    """To 1 mm everywhere but where an outline crosses a pixel within the precision of float32 rays.

    Such pixels are few because their number is that of the outlines' pixels times `SIDE_PX`.
    """
    world, caster = scene(spec)
    renderer = DepthRenderer(world, CAMERA)
    looks = poses(world, 20, seed=1)
    results = np.array([compare(caster, CAMERA, pose, renderer.render(pose)) for pose in looks])
    differ, wrong = results.sum(axis=0)
    assert wrong == 0
    assert differ <= 1e-4 * 160 * 120 * len(looks)


@pytest.mark.parametrize("name", MESHES)
def test_depths_agree_in_meshes_that_were_not_made_for_this(name: str) -> None:
    """Meshes with holes, slivers, doubled walls, triangles of any size, and coordinates of hundreds of metres."""
    mesh = WORLDS / f"{name}.ply"
    if not mesh.is_file():
        pytest.skip(f"{mesh} is not here: set BENCH_WORLDS")
    world, caster = scene(str(mesh))
    renderer = DepthRenderer(world, CAMERA)
    looks = poses(world, 10, seed=2)
    results = np.array([compare(caster, CAMERA, pose, renderer.render(pose)) for pose in looks])
    differ, wrong = results.sum(axis=0)
    assert wrong == 0
    assert differ <= 1e-3 * 160 * 120 * len(looks)


@pytest.mark.parametrize("spec", ["complex", "random:1"])
def test_there_are_no_cracks(spec: str) -> None:
    """In a closed world whose farthest wall is in range no pixel may be empty. 640 x 480: some 3 million pixels."""
    world, _caster = scene(spec)
    camera = replace(CAMERA, width_px=640, height_px=480, fx_px=343.0, fy_px=343.0, cx_px=319.5, cy_px=239.5)
    renderer = DepthRenderer(world, replace(camera, max_range_m=100.0))
    for pose in poses(world, 10, seed=3):
        assert np.isfinite(renderer.render(pose)).all()


def test_there_are_no_cracks_where_edges_run_through_pixel_centres() -> None:
    """On the middle line of the room, level: edges of floor, roof and walls project onto whole pixels."""
    world, _caster = scene("room")
    renderer = DepthRenderer(world, LEVEL)
    for x_m in np.arange(1.0, 6.0, 0.25):
        for yaw_rad in (0.0, np.pi / 2, np.pi, -np.pi / 2):
            image = renderer.render(Pose(0.0, float(x_m), 1.8, 1.35, yaw_rad))
            assert np.isfinite(image).all()


def test_the_depth_of_a_wall_ahead_is_the_same_in_every_pixel() -> None:
    """Depth is along the optical axis, not along the ray. The long leg of the room ends at x = 10."""
    world, _caster = scene("room")
    image = DepthRenderer(world, LEVEL).render(Pose(0.0, 8.5, 1.8, 1.35, 0.0))
    np.testing.assert_allclose(image[:, 40:121], 1.5, atol=1e-5)


@pytest.mark.parametrize("gap_m", [0.03, 0.1])
def test_triangles_that_reach_behind_the_camera_are_cut_and_not_dropped(gap_m: float) -> None:
    """Flying right along a wall, close to floor and roof, tilted: most triangles in view also lie behind the camera."""
    world, caster = scene("room")
    camera = replace(CAMERA, mount_x_m=0.0, mount_y_m=0.0, mount_z_m=0.0, max_range_m=20.0)
    renderer = DepthRenderer(world, camera)
    for yaw_rad, z_m in ((0.3, gap_m), (-2.8, 2.7 - gap_m), (3.0, 1.3)):
        pose = Pose(0.0, 5.0, gap_m, z_m, yaw_rad, roll_rad=0.2, pitch_rad=0.1)
        image = renderer.render(pose)
        axes, place = camera_to_world(camera, pose)
        u, v = np.meshgrid(np.arange(160.0), np.arange(120.0))
        cast = caster.cast(place, rays_px(camera, u, v).reshape(-1, 3) @ axes.T).reshape(image.shape)
        beyond = cast > 0.021
        assert beyond.mean() > 0.2
        np.testing.assert_allclose(image[beyond], cast[beyond], rtol=2e-4, atol=1e-4)


def test_nothing_beyond_the_range_is_drawn_and_everything_just_beyond_is() -> None:
    """A little beyond the range there are still depths, so that noise added to a wall at the limit has a meaning."""
    world, _caster = scene("room")
    at = Pose(0.0, 1.0, 1.8, 1.35, 0.0)  # 9 m from the end wall
    assert np.isinf(DepthRenderer(world, replace(LEVEL, max_range_m=8.5)).render(at)[60, 80])
    assert DepthRenderer(world, replace(LEVEL, max_range_m=8.9)).render(at)[60, 80] == pytest.approx(9.0, abs=1e-5)


def test_a_surface_seen_exactly_edge_on_is_not_seen() -> None:
    """The camera lies in the plane of a sheet, and the sheet's pixels are a column of pixel centres."""
    room, _caster = scene("room")
    sheet_m = np.array([[4.0, 1.8, 1.0], [5.0, 1.8, 1.0], [5.0, 1.8, 1.7], [4.0, 1.8, 1.7]], dtype=np.float32)
    n = len(room.vertices_m)
    hung = replace(
        room,
        vertices_m=np.concatenate([room.vertices_m, sheet_m]),
        triangles=np.concatenate([room.triangles, np.array([[n, n + 1, n + 2], [n, n + 2, n + 3]], dtype=np.int32)]),
    )
    at = Pose(0.0, 3.0, 1.8, 1.35, 0.0)
    np.testing.assert_array_equal(DepthRenderer(hung, LEVEL).render(at), DepthRenderer(room, LEVEL).render(at))


def test_an_image_with_nothing_in_it_is_inf() -> None:
    world, _caster = scene("room")
    image = DepthRenderer(world, LEVEL).render(Pose(0.0, 500.0, 0.0, 0.0, 0.0))
    assert image.dtype == np.float32
    assert image.shape == (121, 161)
    assert np.isinf(image).all()


@pytest.mark.parametrize(
    ("pose", "forward", "up"),
    [
        (Pose(0.0, 1.0, 2.0, 3.0, 0.0), (1, 0, 0), (0, 0, 1)),
        (Pose(0.0, 1.0, 2.0, 3.0, np.pi / 2), (0, 1, 0), (0, 0, 1)),
        (Pose(0.0, 1.0, 2.0, 3.0, 0.0, pitch_rad=np.pi / 2), (0, 0, -1), (1, 0, 0)),
        (Pose(0.0, 1.0, 2.0, 3.0, 0.0, roll_rad=np.pi / 2), (1, 0, 0), (0, -1, 0)),
        (Pose(0.0, 1.0, 2.0, 3.0, np.pi / 2, pitch_rad=np.pi / 2), (0, 0, -1), (0, 1, 0)),
    ],
)
def test_attitude_turns_the_camera_as_the_model_says(
    pose: Pose, forward: tuple[int, int, int], up: tuple[int, int, int]
) -> None:
    """A positive pitch looks down, a positive roll lifts the left side; roll is about the nose, pitch after yaw."""
    axes, place = camera_to_world(LEVEL, pose)
    np.testing.assert_allclose(axes[:, 0], forward, atol=1e-12)
    np.testing.assert_allclose(axes[:, 2], up, atol=1e-12)
    np.testing.assert_allclose(np.cross(axes[:, 0], axes[:, 1]), axes[:, 2], atol=1e-12)
    np.testing.assert_allclose(place, [1.0, 2.0, 3.0])


def test_the_mount_moves_and_turns_the_camera_with_the_body() -> None:
    camera = replace(LEVEL, mount_x_m=0.3, mount_y_m=0.2, mount_z_m=0.1, mount_yaw_rad=np.pi / 2)
    axes, place = camera_to_world(camera, Pose(0.0, 1.0, 2.0, 3.0, np.pi / 2))
    np.testing.assert_allclose(place, [0.8, 2.3, 3.1], atol=1e-12)
    np.testing.assert_allclose(axes[:, 0], [-1.0, 0.0, 0.0], atol=1e-12)


def test_a_wall_on_the_right_is_on_the_right_of_the_image_and_the_floor_below() -> None:
    world, _caster = scene("room")
    image = DepthRenderer(world, LEVEL).render(Pose(0.0, 3.0, 0.8, 0.6, 0.0))  # right wall 0.8 m, left 2.8 m
    assert image[60, 160] == pytest.approx(0.8, abs=1e-4)
    assert image[60, 0] == pytest.approx(2.8, abs=1e-4)
    assert image[120, 80] == pytest.approx(0.6 * 80.0 / 60.0, abs=1e-4)


def test_one_renderer_may_be_used_from_several_threads() -> None:
    world, _caster = scene("complex")
    renderer = DepthRenderer(world, CAMERA)
    looks = poses(world, 16, seed=4)
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(renderer.render, looks))
    for pose, image in zip(looks, together, strict=True):
        np.testing.assert_array_equal(image, renderer.render(pose))


# What rays and distances mean, on a box whose answers are known by hand.


def box(low: tuple[float, float, float], high: tuple[float, float, float]) -> World:
    """The surface of a box, two triangles a side."""
    corners = np.stack(np.meshgrid(*zip(low, high, strict=True), indexing="ij"), axis=-1).reshape(-1, 3)
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = [corner for a, b, c, d in sides for corner in ((a, b, c), (a, c, d))]
    return World(
        "box", corners.astype(np.float32), np.array(triangles, dtype=np.int32), None, np.empty((0, 3)), "a box"
    )


@pytest.fixture(scope="module")
def caster() -> RayCaster:
    return RayCaster(box((0.0, 0.0, 0.0), (4.0, 2.0, 3.0)))


def test_ranges_count_in_lengths_of_the_direction(caster: RayCaster) -> None:
    ranges = caster.cast(np.array([1.0, 1.0, 1.0]), np.array([[1.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 0.0, -0.5]]))
    np.testing.assert_allclose(ranges, [3.0, 1.5, 2.0], rtol=1e-6)


def test_each_ray_may_have_its_own_origin_or_all_one_direction(caster: RayCaster) -> None:
    origins = np.array([[1.0, 1.0, 1.0], [3.0, 1.0, 2.0]])
    np.testing.assert_allclose(caster.cast(origins, np.array([1.0, 0.0, 0.0])), [3.0, 1.0], rtol=1e-6)
    ways = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(caster.cast(origins, ways), [3.0, 1.0], rtol=1e-6)


def test_surfaces_are_hit_from_both_sides_and_nothing_gives_inf(caster: RayCaster) -> None:
    ranges = caster.cast(np.array([-1.0, 1.0, 1.0]), np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]]))
    np.testing.assert_allclose(ranges, [1.0, np.inf])


def test_a_way_is_blocked_by_what_lies_between_its_ends(caster: RayCaster) -> None:
    ends = np.array([[3.9, 1.0, 1.0], [4.1, 1.0, 1.0], [-9.0, 1.0, 1.0], [1.0, 1.0, 2.9]])
    assert caster.blocked(np.array([1.0, 1.0, 1.0]), ends).tolist() == [False, True, True, False]


def test_no_rays_give_no_ranges(caster: RayCaster) -> None:
    assert caster.cast(np.empty((0, 3)), np.empty((0, 3))).shape == (0,)
    assert caster.cast(np.empty((0, 3)), np.array([1.0, 0.0, 0.0])).shape == (0,)
    assert caster.blocked(np.empty((0, 3)), np.empty((0, 3))).shape == (0,)
    assert caster.distance(np.empty((0, 3))).shape == (0,)


def test_distance_is_to_the_nearest_surface_inside_and_outside(caster: RayCaster) -> None:
    points = np.array([[1.5, 1.0, 1.5], [0.25, 1.0, 1.5], [-3.0, 1.0, 1.5], [-3.0, -4.0, 1.5]])
    np.testing.assert_allclose(caster.distance(points), [1.0, 0.25, 3.0, 5.0], rtol=1e-6)
