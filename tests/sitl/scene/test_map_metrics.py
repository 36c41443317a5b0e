"""Maps against the truth: what can be seen of a world, and how much of it a map has, and how well."""

from __future__ import annotations

import functools
import math
import time

import numpy as np
import pytest
from numpy.typing import NDArray

from companion.config.mapping import MapSettings
from companion.errors import InputError
from companion.mapping import VoxelMap
from sitl.mines import World, load_world
from sitl.scene import visibility
from sitl.scene.raycast import RayCaster
from sitl.scene.surface import Surroundings, surface_samples
from sitl.scene.visibility import (
    Truth,
    _Levels,
    accuracy_m,
    horizontal_clearance,
    precision,
    traveling_surface,
    visible_samples,
)
from tests.mapping.voxels.scenes import camera, frame, pose, room_depth
from tests.sitl.scene.test_render import box


def completeness(voxels: VoxelMap, points_m: NDArray[np.float64]) -> float:
    """The share of points (n, 3) within one voxel of an occupied voxel."""
    return float(np.mean(voxels.occupied_near(points_m)))


def test_precision_counts_up_to_one_voxel() -> None:
    """Protects the definition: exactly one voxel away still counts."""
    assert precision(np.array([0.0, 0.05, 0.1, 0.11]), 0.1) == 0.75


def test_accuracy_is_the_mean() -> None:
    """Protects the definition, in m."""
    assert accuracy_m(np.array([0.0, 0.1, 0.2])) == pytest.approx(0.1)


def test_nothing_has_no_measure() -> None:
    """Protects reports of an empty map: not known is NaN, neither 0 % nor 100 %."""
    empty = np.zeros(0)
    assert math.isnan(precision(empty, 0.1))
    assert math.isnan(accuracy_m(empty))
    assert completeness(VoxelMap(MapSettings()), np.zeros((5, 3))) == 0.0


def test_completeness_is_within_one_voxel() -> None:
    """Protects the definition: points one voxel beside an occupied one count, points two beside it do not."""
    voxels = VoxelMap(MapSettings())
    wall = frame(camera(), pose(), 2.05)
    voxels.integrate(wall)
    voxels.integrate(wall)
    points = np.array([[x, 0.05, 0.05] for x in (1.85, 1.95, 2.05, 2.15, 2.25)])
    assert completeness(voxels, points) == pytest.approx(3 / 5)


def test_the_defaults_see_a_noisy_tunnel() -> None:
    """Protects the choice of the sensor model: noise of 0.002 z², 2 % dropouts, pose noise of 1 cm and 0.2°.

    Completeness must pass 99 %, which ends a flight (METHOD, t_f), of what is seen well: at 3 m and nearer. Precision
    must stay above 95 %: at 6 m 17 % of the readings are more than a voxel off (7.2 cm standard deviation), and with
    OctoMap's probabilities it drops to 90 % (see `MapSettings`).
    """
    low, high = np.array([-1.53, -2.04, -0.02]), np.array([12.07, 2.06, 3.03])
    cam = camera(160, 120)
    random = np.random.default_rng(3)
    voxels = VoxelMap(MapSettings())
    for x in np.arange(0.0, 8.0, 0.05):
        at = pose(x, 0.2 * math.sin(x), 1.5, yaw=0.5 * math.sin(2.0 * x))
        depth = room_depth(cam, at, low, high)
        depth += random.normal(size=depth.shape) * 0.002 * depth**2
        depth[random.random(depth.shape) < 0.02] = np.nan
        off, turn = random.normal(0.0, 0.01, 3), random.normal(0.0, math.radians(0.2), 3)
        estimated = pose(
            at.x_m + off[0], at.y_m + off[1], at.z_m + off[2], yaw=at.yaw_rad + turn[0], pitch=turn[1], roll=turn[2]
        )
        voxels.integrate(frame(cam, estimated, depth))

    # The walls, floor and roof that the camera passes at less than 3 m, with 45° to either side.
    along = random.uniform(3.0, 10.0, 40_000)
    sides = np.stack([along, np.where(along > 6.5, low[1], high[1]), random.uniform(low[2], high[2], 40_000)], axis=1)
    flat = np.stack([along, random.uniform(low[1], high[1], 40_000), np.where(along > 6.5, low[2], high[2])], axis=1)
    assert completeness(voxels, np.concatenate([sides, flat])) >= 0.99

    occupied = voxels.occupied()
    inwards = np.minimum(occupied - low, high - occupied).min(axis=1)
    outwards = np.linalg.norm(np.maximum(np.maximum(low - occupied, occupied - high), 0.0), axis=1)
    off_m = np.where(inwards >= 0.0, inwards, outwards)
    assert precision(off_m, voxels.voxel_m) >= 0.95
    # The centre of a voxel that a plane crosses is on average a quarter of a voxel off it: 2.5 cm. Noise adds to it.
    assert 0.02 < accuracy_m(off_m) < 0.05


# Ground truth against worlds whose answer is known by hand, and against trying every point.


ROOM_START = (2.0, 1.8, 1.0)


@functools.cache
def scene(spec: str) -> tuple[World, RayCaster]:
    world = load_world(spec, seed=0)
    return world, RayCaster(world)


def together(*worlds: World) -> World:
    """Several meshes as one world."""
    firsts = np.cumsum([0] + [len(world.vertices_m) for world in worlds])
    vertices = np.concatenate([world.vertices_m for world in worlds])
    triangles = np.concatenate([world.triangles + first for world, first in zip(worlds, firsts[:-1], strict=True)])
    return World("together", vertices, triangles.astype(np.int32), None, np.empty((0, 3)), "several boxes")


def test_the_traveling_surface_of_the_room_has_the_area_of_the_room_less_the_margin() -> None:
    """By hand, 1 m inside the L: 8 x 1.6 + 1.6 x 3.4 m, and at the inner corner the square less a quarter disc.

    A grid of 0.1 m counts the border to half a step: 26 m of border times 0.05 m.
    """
    _world, caster = scene("room")
    surface = traveling_surface(caster, ROOM_START, height_m=1.0, margin_m=1.0, step_m=0.1)
    by_hand_m2 = 8.0 * 1.6 + 1.6 * 3.4 + (1.0 - np.pi / 4)
    assert len(surface) * 0.1**2 == pytest.approx(by_hand_m2, abs=26.0 * 0.05)
    np.testing.assert_allclose(surface[:, 2], 1.0, atol=1e-5)
    assert surface[:, :2].min() >= 1.0 - 1e-5
    assert surface[:, 0].max() <= 9.0 + 1e-5
    assert surface[:, 1].max() <= 6.0 + 1e-5


def test_the_traveling_surface_follows_ramps_up_and_down() -> None:
    """Everything above the floor by H, and both ends of the main drift and the end of the branch are reached."""
    world, caster = scene("slope")
    surface = traveling_surface(caster, (4.0, 0.0, 1.0), height_m=1.5, margin_m=1.0)
    below = caster.cast(surface, np.array([0.0, 0.0, -1.0]))
    np.testing.assert_allclose(below, 1.5, atol=1e-4)
    away = np.linalg.norm(world.start_area_m[:, None, :2] - surface[None, :, :2], axis=2).min(axis=1)
    assert away.max() <= 0.5


def test_the_traveling_surface_stops_at_ramps_that_are_too_steep() -> None:
    """The first ramp of the slope begins at x = 10 m and rises by tan 15° = 0.27."""
    _world, caster = scene("slope")
    surface = traveling_surface(caster, (4.0, 0.0, 1.0), height_m=1.5, margin_m=1.0, max_slope=0.25)
    assert 9.5 <= surface[:, 0].max() <= 10.5


def test_the_traveling_surface_goes_on_behind_a_step_that_is_flown_over_and_not_down_a_shaft() -> None:
    """Protects the judge of every mine with a step: what lies behind 0.7 m was explored and counted for nothing."""
    world, caster = scene("hazard:step")
    surface = traveling_surface(caster, tuple(world.start_area_m[0]), height_m=1.5, margin_m=1.0, step_m=0.25)
    far_m = world.vertices_m[:, 0].max()
    assert surface[:, 0].max() > far_m - 2.0
    assert np.ptp(surface[:, 2]) > 0.6
    world, caster = scene("hazard:shaft")
    surface = traveling_surface(caster, tuple(world.start_area_m[0]), height_m=1.5, margin_m=1.0, step_m=0.25)
    assert np.ptp(surface[:, 2]) < 0.6


@pytest.mark.parametrize("slope", [0.6, 0.8, 1.5])
def test_a_slope_is_not_taken_for_steps(slope: float) -> None:
    """Protects against a judge that climbs what no vehicle follows, cell by cell."""
    level = box((0, 0, 0), (20, 6, 3))
    vertices_m = level.vertices_m.copy()
    vertices_m[:, 2] += slope * vertices_m[:, 0]
    ramp = World("ramp", vertices_m, level.triangles, None, np.empty((0, 3)), "a ramp")
    surface = traveling_surface(RayCaster(ramp), (10.0, 3.0, 10.0 * slope + 1.5), 1.5, 0.5, step_m=0.25)
    assert (np.ptp(surface[:, 0]) > 10.0) == (slope <= 0.7)


def test_the_traveling_surface_does_not_pass_through_walls_or_below_low_roofs() -> None:
    """Two chambers that touch; and in the room, 2.7 m high, a flight too near to the roof or above it."""
    _world, caster = scene("room")
    chambers = RayCaster(together(box((0, 0, 0), (6, 6, 3)), box((6, 0, 0), (12, 6, 3))))
    surface = traveling_surface(chambers, (3.0, 3.0, 1.0), height_m=1.0, margin_m=0.5)
    assert surface[:, 0].max() <= 5.5 + 1e-5
    assert len(traveling_surface(caster, ROOM_START, height_m=2.5, margin_m=1.0)) == 0
    assert len(traveling_surface(caster, ROOM_START, height_m=3.5, margin_m=1.0)) == 0
    assert len(traveling_surface(caster, ROOM_START, height_m=2.3, margin_m=1.0)) > 0


def test_levels_above_each_other_stay_apart() -> None:
    levels = _Levels()
    cell = np.array([[3, -4]])
    assert levels.add(cell, np.array([1.0])).tolist() == [True]
    assert levels.add(cell, np.array([1.2])).tolist() == [False]
    assert levels.add(cell, np.array([4.0])).tolist() == [True]
    assert levels.add(np.array([[5, 5], [5, 5]]), np.array([0.0, 0.0])).tolist() == [True, False]


def test_a_start_nearer_to_a_wall_than_the_margin_counts_only_if_that_is_allowed() -> None:
    _world, caster = scene("room")
    start = (2.0, 0.9, 1.0)
    assert len(traveling_surface(caster, start, height_m=1.0, margin_m=1.0)) == 0
    assert len(traveling_surface(caster, start, height_m=1.0, margin_m=1.0, start_margin_m=0.8)) > 10
    assert len(traveling_surface(caster, start, height_m=1.0, margin_m=1.0, start_margin_m=0.95)) == 0


def test_a_start_outside_gives_no_surface_and_no_truth() -> None:
    world, caster = scene("room")
    assert len(traveling_surface(caster, (2.0, 9.0, 1.0), height_m=1.0, margin_m=0.5)) == 0
    with pytest.raises(InputError, match=r"start \(2.00, 9.00, 1.00\) in world room"):
        Truth.of(world, caster, (2.0, 9.0, 1.0), 1.0, 0.5, 0.2, 10.0)


def test_samples_lie_on_the_surface_one_a_voxel_and_stand_for_all_of_it() -> None:
    """A chamber with 2 x 20 m² of floor and roof and 18 x 3 m² of walls, which lie along the voxels.

    Each voxel of 0.1 m holds 0.01 m² of it, but for those at the edges: 60 m of edge, half a voxel to either side.
    """
    world = box((0.0, 0.0, 0.0), (5.0, 4.0, 3.0))
    samples, areas = surface_samples(world, 0.1)
    assert areas.sum() == pytest.approx(94.0, rel=1e-4)
    assert len(samples) == pytest.approx(94.0 / 0.01, abs=60.0 / 0.1)
    assert RayCaster(world).distance(samples).max() < 1e-5
    assert areas.max() < 3 * 0.01, "no voxel can hold more than three sides"
    again, _areas = surface_samples(world, 0.1)
    np.testing.assert_array_equal(samples, again)


def test_samples_leave_no_holes() -> None:
    """Every point of a rough mine's surface has a sample within a voxel's diagonal: the one in its own voxel."""
    world, _caster = scene("random:1")
    samples, _areas = surface_samples(world, 0.2)
    middles = world.vertices_m[world.triangles[::397]].mean(axis=1)
    away = [np.linalg.norm(samples - middle, axis=1).min() for middle in middles]
    assert max(away) <= 0.2 * np.sqrt(3.0)


def test_all_of_the_room_can_be_seen() -> None:
    world, caster = scene("room")
    truth = Truth.of(world, caster, ROOM_START, height_m=1.0, margin_m=1.0, voxel_m=0.1, max_range_m=10.0)
    assert truth.area_share_visible >= 0.999
    assert truth.samples_m.dtype == np.float32
    assert len(truth.samples_m) == len(truth.sample_areas_m2)
    assert truth.reach_m2 == len(truth.traveling_surface_m) * 0.25


def test_what_is_walled_off_is_not_part_of_the_truth() -> None:
    """A second chamber beside the first, half as long: 6 x 6 x 3 m has 144 m² of surface, 3 x 6 x 3 m has 90 m²."""
    world = together(box((0, 0, 0), (6, 6, 3)), box((6.5, 0, 0), (9.5, 6, 3)))
    truth = Truth.of(world, RayCaster(world), (3.0, 3.0, 1.0), 1.0, 1.0, 0.1, 10.0)
    assert truth.area_share_visible == pytest.approx(144.0 / (144.0 + 90.0), abs=1e-3)
    assert truth.samples_m[:, 0].max() <= 6.0 + 1e-4


def test_a_camera_sees_as_far_as_it_does_and_no_further() -> None:
    """From one point in a convex chamber everything within range is visible and nothing else."""
    world = box((0, 0, 0), (12, 6, 3))
    samples, _areas = surface_samples(world, 0.2)
    eye = np.array([[2.0, 3.0, 1.0]])
    seen = visible_samples(RayCaster(world), samples, eye, max_range_m=5.0)
    np.testing.assert_array_equal(seen, np.linalg.norm(samples - eye, axis=1) <= 5.0)


def test_a_camera_sees_no_higher_and_no_lower_than_it_looks() -> None:
    """Protects "complete": a roof right above, which no flight of a camera that looks ahead can ever map, is no part.

    From one point 1 m above the floor of a high chamber, 28° up and 28° down.
    """
    world = box((0, 0, 0), (12, 6, 9))
    samples, _areas = surface_samples(world, 0.2)
    eye = np.array([[2.0, 3.0, 1.0]])
    rad = math.radians(28.0)
    seen = visible_samples(RayCaster(world), samples, eye, max_range_m=20.0, elevations_rad=(-rad, rad))
    rise_m = samples[:, 2] - 1.0
    far_m = np.linalg.norm(samples[:, :2] - eye[:, :2], axis=1)
    np.testing.assert_array_equal(seen, np.abs(rise_m) <= far_m * math.tan(rad))
    assert 0.2 < seen.mean() < 0.8


@pytest.mark.parametrize("fov_deg", [180.0, 57.0])
def test_looking_from_some_points_finds_what_looking_from_all_of_them_finds(fov_deg: float) -> None:
    """Against every pair of sample and point of S, in a chamber with four pillars that nearly reach the roof.

    One in a thousand may be lost, a tenth of the 1 % by which the time to completeness is defined.
    """
    world = together(box((0, 0, 0), (12, 9, 3)), *(box((x, 3, 0), (x + 1, 6, 2.9)) for x in (2, 4, 6, 8)))
    caster = RayCaster(world)
    surface = traveling_surface(caster, (1.0, 1.0, 1.2), height_m=1.2, margin_m=0.9)
    samples, _areas = surface_samples(world, 0.2)
    half_rad = math.radians(fov_deg) / 2.0
    found = visible_samples(caster, samples, surface, max_range_m=4.0, elevations_rad=(-half_rad, half_rad))

    lengths_m = np.linalg.norm(samples[:, None] - surface[None], axis=2)
    rises = np.abs(samples[:, None, 2] - surface[None, :, 2]) / lengths_m
    which, source = np.nonzero((lengths_m <= 4.0) & (rises <= math.sin(half_rad)))
    ways = samples[which] - surface[source]
    ends = samples[which] - ways * (0.02 / np.linalg.norm(ways, axis=1))[:, None]
    exhaustive = np.zeros(len(samples), dtype=bool)
    exhaustive[which[~caster.blocked(surface[source], ends)]] = True
    assert 0.5 < exhaustive.mean() < 0.95, "part of it is out of sight"
    assert not (found & ~exhaustive).any()
    assert (exhaustive & ~found).sum() <= 1e-3 * exhaustive.sum()


def test_clearance_is_the_distance_to_the_nearest_wall() -> None:
    """To 0.1 %: of 72 bearings one is within 2.5° of the normal of any wall, and 1 / cos 2.5° = 1.001."""
    caster = RayCaster(box((0, 0, 0), (12, 4, 3)))
    y_m = np.linspace(0.3, 3.7, 35)
    points = np.column_stack([np.full(35, 5.0), y_m, np.full(35, 1.5)])
    np.testing.assert_allclose(horizontal_clearance(caster, points, 0.2), np.minimum(y_m, 4.0 - y_m), rtol=1.1e-3)
    assert horizontal_clearance(caster, np.empty((0, 3)), 0.2).shape == (0,)


def test_clearance_counts_what_is_beside_any_part_of_the_body() -> None:
    """A beam 1 m ahead and 0.25 m above the middle of the body, and floors and roofs that are not beside but below."""
    caster = RayCaster(together(box((0, 0, 0), (12, 4, 3)), box((6, 0, 1.75), (6.2, 4, 1.95))))
    at = np.array([[5.0, 2.0, 1.5]])
    assert horizontal_clearance(caster, at, 0.3)[0] == pytest.approx(1.0, abs=1e-5)
    assert horizontal_clearance(caster, at, 0.2)[0] == pytest.approx(2.0, abs=1e-5)
    assert horizontal_clearance(caster, np.array([[3.0, 2.0, 0.1]]), 0.3)[0] == pytest.approx(2.0, abs=1e-5)


def test_triangles_out_of_sight_are_passed_over_and_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    world = together(
        box((60.0, 60.0, 0.0), (64.0, 64.0, 3.0)),
        box((0.0, 0.0, 0.0), (8.0, 8.0, 3.0)),
        box((-90.0, 0, 0), (-80, 9, 3)),
    )
    part = Surroundings.of(np.array([[4.0, 4.0, 1.0]]), 6.0)
    within = part.meet(world.vertices_m[world.triangles].astype(np.float64))
    assert within.tolist() == [False] * 12 + [True] * 12 + [False] * 12
    samples, areas = surface_samples(world, 0.2, part)
    monkeypatch.setattr(Surroundings, "meet", lambda _self, corners: np.ones(len(corners), np.bool_))
    every, areas_of_every = surface_samples(world, 0.2, part)
    assert len(samples) > 1000
    assert (samples.tobytes(), areas.tobytes()) == (every.tobytes(), areas_of_every.tobytes())


def test_more_surface_than_any_mine_has_is_refused_before_it_is_covered() -> None:
    world = box((0.0, 0.0, 0.0), (5000.0, 5000.0, 3.0))
    began = time.process_time()
    with pytest.raises(InputError, match=r"m² of surface around.*largest triangle 12500000 m².*--scale"):
        surface_samples(world, 0.1, Surroundings.of(np.array([[4.0, 4.0, 1.0]]), 10.0))
    assert time.process_time() - began < 5.0


def test_more_floor_than_any_mine_has_is_refused_while_it_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """And how much was found is told meanwhile."""
    monkeypatch.setattr(visibility, "MOST_PLACES", 5_000)
    caster = RayCaster(box((0.0, 0.0, 0.0), (500.0, 500.0, 3.0)))
    told: list[str] = []
    with pytest.raises(InputError, match=r"m² of floor can be reached from the start"):
        traveling_surface(caster, (250.0, 250.0, 1.0), height_m=1.0, margin_m=1.0, say=told.append)
    assert len(told) > 10
    assert told[-1].endswith("m² so far")
