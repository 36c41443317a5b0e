"""What is no plain rock: what sensors make of it, what moves and when, and that nothing else changes by it."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

from companion.config.sensors import BeamSettings, CameraSettings, SensorSettings
from companion.config.sim import NoiseSettings
from companion.model import Beam, Observation, Pose
from sitl.mines.conditions import Conditions, Dust, Mover, Stretch, Surface, Trigger, Wind
from sitl.mines.hazards.building import box as body
from sitl.mines.model import World
from sitl.scene.dust import FARTHEST_M, NEAREST_M, PERIOD_S
from sitl.scene.echoes import RETURNED
from sitl.scene.live import LiveWorld
from sitl.scene.raycast import RayCaster
from sitl.scene.render import DepthRenderer
from sitl.scene.sensors import SensorRig
from tests.sitl.scene.test_render import box

SETTINGS = SensorSettings(camera=CameraSettings(width_px=64, height_px=48), beams=BeamSettings(rate_hz=20.0))
CAMERA = SETTINGS.camera.model()
ROOM = box((0.0, 0.0, 0.0), (8.0, 4.0, 3.0))
AT = Pose(0.0, 3.0, 1.0, 1.2, 0.0)
"""5 m to the wall in front, 3 m left, 1 m right, 1.2 m down, 1.8 m up."""

EXACT_M = 1e-3
DEVIATIONS = 5.0
EVERYWHERE = Stretch(-100.0, -100.0, 100.0, 100.0)


def wall_at(x_m: float | None = None, z_m: float | None = None) -> np.ndarray:
    """Which triangles of the room lie in that plane."""
    corners = ROOM.vertices_m[ROOM.triangles]
    axis, at_m = (0, x_m) if z_m is None else (2, z_m)
    return np.asarray((corners[:, :, axis] == at_m).all(axis=1))


def made_of(triangles: np.ndarray, surface: Surface) -> World:
    surfaces = np.where(triangles, surface, Surface.ROCK).astype(np.uint8)
    return replace(ROOM, conditions=Conditions(surfaces=surfaces))


def observed(world: World, poses: list[Pose], seed: int = 1) -> list[Observation]:
    """What ideal sensors see, one after another."""
    caster = RayCaster(world)
    live = LiveWorld(world, caster, CAMERA)
    rig = SensorRig(
        SETTINGS, NoiseSettings(enabled=False), caster, DepthRenderer(world, CAMERA), np.random.default_rng(seed), live
    )
    seen = []
    for pose in poses:
        live.look(pose)
        seen.append(rig.observe(pose))
    return seen


def standing(ticks: int, at: Pose = AT, begin_s: float = 0.0) -> list[Pose]:
    return [replace(at, t_s=begin_s + 0.2 * k) for k in range(ticks)]


def image_of(seen: Observation) -> np.ndarray:
    assert seen.frame is not None
    return seen.frame.depth_m


def beam_of(seen: Observation, beam: Beam) -> float | None:
    return next(reading.range_m for reading in seen.ranges if reading.beam == beam)


TRUE = image_of(observed(ROOM, [AT])[0])
"""The room without anything."""

AHEAD_M = float(TRUE[CAMERA.height_px // 2, CAMERA.width_px // 2])
"""From the camera, which sits before the middle of the body, to the wall in front."""

END = np.isclose(TRUE, AHEAD_M, atol=EXACT_M)
"""Pixels of that wall."""


def test_a_dark_wall_gives_neither_depth_nor_range_and_all_else_is_as_it_was() -> None:
    (seen,) = observed(made_of(wall_at(x_m=8.0), Surface.DARK), [AT])
    assert np.isnan(image_of(seen)[END]).all()
    np.testing.assert_array_equal(image_of(seen)[~END], TRUE[~END])
    assert beam_of(seen, Beam.FRONT) is None
    assert beam_of(seen, Beam.RIGHT) == pytest.approx(1.0, abs=EXACT_M)


def test_a_shiny_wall_comes_and_goes_and_mirrors_what_is_before_it() -> None:
    """Straight ahead a mirror shows the wall behind: 5 m there and 8 m back."""
    images = [image_of(seen) for seen in observed(made_of(wall_at(x_m=8.0), Surface.SHINY), standing(200))]
    middle = np.array([image[20:28, 28:36] for image in images])
    itself, mirrored = RETURNED[Surface.SHINY]
    for share, depth_m in ((itself, AHEAD_M), (mirrored, AHEAD_M + 8.0)):
        # One patch of pixels an image is one draw, or few.
        there = np.isclose(middle, depth_m, atol=0.01).mean()
        assert there == pytest.approx(share, abs=DEVIATIONS * (share / len(images)) ** 0.5)
    assert np.isnan(middle).mean() == pytest.approx(1.0 - itself - mirrored, abs=0.1)
    for image in images:
        np.testing.assert_array_equal(image[~END], TRUE[~END])


def test_still_water_shows_the_roof_as_far_below_as_it_is_above() -> None:
    world = made_of(wall_at(z_m=0.0), Surface.WATER)
    frames = observed(world, standing(200))
    row, column = CAMERA.height_px - 1, CAMERA.width_px // 2
    drop = (row - CAMERA.cy_px) / CAMERA.fy_px  # m down for each m ahead
    # The floor is 1.2 m below, and the roof in it 3 m below that; the wall ahead may come before it.
    expected_m = min((1.2 + 3.0) / drop, AHEAD_M)
    assert TRUE[row, column] == pytest.approx(1.2 / drop, abs=0.01)
    assert image_of(frames[0])[row, column] == pytest.approx(expected_m, abs=0.01)
    downs = [beam_of(seen, Beam.DOWN) for seen in frames]
    kinds = {None if down is None else round(down, 2) for down in downs}
    assert kinds == {None, 1.2, 4.2}
    itself, mirrored = RETURNED[Surface.WATER]
    assert sum(down is not None for down in downs) / len(downs) == pytest.approx(itself + mirrored, abs=0.18)


def test_dust_is_nearer_than_what_is_there_and_comes_in_puffs() -> None:
    """Sparse: a few clouds in an image, a few readings; between two puffs nothing."""
    world = replace(ROOM, conditions=Conditions(dust=(Dust(EVERYWHERE, 6.0, 0.1),)))
    dusty, clear = observed(world, standing(19)), observed(world, standing(19, begin_s=PERIOD_S / 2.0 + 0.05))
    for seen in clear:
        np.testing.assert_array_equal(image_of(seen), TRUE)
    changed = np.array([image_of(seen) != TRUE for seen in dusty])
    assert 0.0 < changed.mean() < 0.1
    found = np.array([image_of(seen) for seen in dusty])
    assert (found <= TRUE).all()
    assert found[changed].min() >= NEAREST_M - EXACT_M
    assert found[changed].max() <= FARTHEST_M
    ranges = [beam_of(seen, Beam.FRONT) for seen in dusty + observed(world, standing(19), seed=2)]
    short = [r for r in ranges if r is not None and r < 4.9]
    assert 0 < len(short) < len(ranges) / 2


def test_there_is_no_dust_elsewhere() -> None:
    world = replace(ROOM, conditions=Conditions(dust=(Dust(Stretch(6.0, 0.0, 8.0, 4.0), 50.0, 1.0),)))
    (seen,) = observed(world, [AT])
    np.testing.assert_array_equal(image_of(seen), TRUE)


def test_when_the_light_fails_no_pixel_has_a_depth_ever_after() -> None:
    world = replace(ROOM, conditions=Conditions(light_fails=Trigger(5.0, 1.0, 1.0)))
    before, there, after = observed(world, [AT, replace(AT, t_s=1.0, x_m=4.5), replace(AT, t_s=2.0)])
    np.testing.assert_array_equal(image_of(before), TRUE)
    assert np.isnan(image_of(there)).all()
    assert np.isnan(image_of(after)).all()
    assert beam_of(after, Beam.FRONT) == pytest.approx(5.0, abs=EXACT_M)


class TestWhatMoves:
    """A box that comes out of the wall on the left at 1 m/s when a vehicle has come to x = 4 m."""

    LEAF = body((6.0, 4.2, 0.0), (7.0, 5.2, 2.5))
    MOVER = Mover(LEAF.vertices_m, LEAF.triangles, (0.0, -3.7, 0.0), 1.0, Trigger(4.0, 1.0, 0.5))
    WORLD = replace(ROOM, conditions=Conditions(movers=(MOVER,)))

    def test_it_waits_until_a_vehicle_comes_goes_straight_and_stays(self) -> None:
        came = replace(AT, t_s=10.0, x_m=4.0)
        far = [replace(AT, t_s=t_s) for t_s in (10.5, 13.7, 30.0, 60.0)]
        frames = observed(self.WORLD, [AT, replace(AT, t_s=9.0), came, *far])
        fronts = [beam_of(seen, Beam.FRONT) for seen in (*frames[:2], *frames[3:])]
        assert fronts == pytest.approx([5.0, 5.0, 5.0, 3.0, 3.0, 3.0], abs=EXACT_M)
        np.testing.assert_array_equal(image_of(frames[1]), TRUE)
        middle = image_of(frames[-1])[CAMERA.height_px // 2, CAMERA.width_px // 2]
        assert middle == pytest.approx(AHEAD_M - 2.0, abs=EXACT_M)

    def test_image_ray_and_distance_agree_on_where_it_is(self) -> None:
        """Protects the judge from looking at another place than the sensors: half way, and at the end."""
        live = LiveWorld(self.WORLD, RayCaster(self.WORLD), CAMERA)
        live.look(replace(AT, t_s=10.0, x_m=4.0))
        point = np.array([[6.5, 1.5, 1.0]])
        # The box begins at y = 4.2 m and ends at 0.5 m; floor and wall are 1 and 1.5 m from the point.
        for t_s, expected_m in ((9.0, 1.0), (11.7, 1.0), (12.2, 0.5), (12.6, 0.1)):
            assert float(live.distance(np.array([t_s]), point)[0]) == pytest.approx(expected_m, abs=EXACT_M), t_s
            at = Pose(t_s, 6.5, 1.5, 1.0, np.pi / 2.0)
            towards = live.ranges(at, point, np.array([[0.0, 1.0, 0.0]]), np.array([2.5]), np.random.default_rng(1))
            gone_m = max(t_s - 10.0, 0.0)
            assert towards == pytest.approx([min(2.5, 2.7 - gone_m)], abs=EXACT_M)
        assert live.is_moving(10.5)
        assert not live.is_moving(9.9)
        assert not live.is_moving(15.0)

    def test_the_clearance_of_a_flight_is_that_of_each_moment(self) -> None:
        live = LiveWorld(self.WORLD, RayCaster(self.WORLD), CAMERA)
        live.look(replace(AT, t_s=10.0, x_m=4.0))
        times_s = np.array([9.0, 13.7])
        points = np.array([[5.0, 1.2, 1.2], [5.0, 1.2, 1.2]])
        found = live.horizontal_clearance(times_s, points, 0.15)
        assert found == pytest.approx([1.2, 1.0], abs=0.01)

    def test_a_simulator_that_is_started_anew_finds_it_where_it_first_stood(self) -> None:
        live = LiveWorld(self.WORLD, RayCaster(self.WORLD), CAMERA)
        live.look(replace(AT, t_s=10.0, x_m=4.0))
        live.restart()
        assert not live.is_moving(11.0)


def test_wind_blows_where_it_blows() -> None:
    conditions = Conditions(winds=(Wind(Stretch(0.0, 0.0, 2.0, 4.0), 2.0, -1.0),))
    live = LiveWorld(replace(ROOM, conditions=conditions), RayCaster(ROOM), CAMERA)
    assert live.wind_mps(replace(AT, x_m=1.0)) == (2.0, -1.0)
    assert live.wind_mps(AT) == (0.0, 0.0)


def test_a_world_of_rock_alone_draws_nothing() -> None:
    """Protects every flight that was ever flown with a seed: the sensors' noise is drawn as before."""
    caster, noise = RayCaster(ROOM), NoiseSettings()
    rigs = [
        SensorRig(SETTINGS, noise, caster, DepthRenderer(ROOM, CAMERA), np.random.default_rng(3), live)
        for live in (None, LiveWorld(ROOM, caster, CAMERA))
    ]
    for pose in standing(5):
        plain, with_live = (rig.observe(pose) for rig in rigs)
        assert plain.ranges == with_live.ranges
        for a, b in itertools.pairwise((plain.frame, with_live.frame)):
            assert (a is None) == (b is None)
            if a is not None and b is not None:
                np.testing.assert_array_equal(a.depth_m, b.depth_m)
