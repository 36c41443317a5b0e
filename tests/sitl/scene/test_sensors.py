"""The synthetic sensors: exact without noise, and with it as wrong as the configuration says, no more and no less."""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from companion.config.sensors import BeamSettings, CameraSettings, PlanarSettings, SensorSettings
from companion.config.sim import NoiseSettings
from companion.model import Beam, Observation, Pose
from sitl.mines import World
from sitl.scene.raycast import RayCaster
from sitl.scene.render import DepthRenderer
from sitl.scene.sensors import DRIFT_TURNS_M, PoseEstimate, SensorRig
from tests.sitl.scene.test_render import box

TICK_S = 0.05
CAMERA = CameraSettings(width_px=64, height_px=48)
SETTINGS = SensorSettings(camera=CAMERA, beams=BeamSettings(rate_hz=20.0))
IDEAL = NoiseSettings(enabled=False)
NO_NOISE: dict[str, Any] = {name: 0.0 for name in NoiseSettings.model_fields if name != "enabled"}
"""Noise that is switched on, with nothing wrong yet."""

AT = Pose(0.0, 3.0, 1.0, 1.2, 0.0)
"""In the room: 5 m to the wall in front, 3 m behind, 3 m left, 1 m right, 1.2 m down, 1.8 m up."""

RANGES = {Beam.FRONT: 5.0, Beam.BACK: 3.0, Beam.LEFT: 3.0, Beam.RIGHT: 1.0, Beam.DOWN: 1.2, Beam.UP: 1.8}
FLOAT32_M = 1e-5
"""Rays and images are float32: 1e-6 of 8 m."""

DEVIATIONS = 5.0
"""A statistic may be this many of its standard deviations off; the seeds are fixed, and another one would pass too."""


@functools.cache
def room() -> tuple[World, RayCaster]:
    world = box((0.0, 0.0, 0.0), (8.0, 4.0, 3.0))
    return world, RayCaster(world)


@functools.cache
def far_floor() -> tuple[World, RayCaster]:
    """Nothing but a floor 20 m below: out of range for everything."""
    vertices = np.array([[-100.0, -100.0, -20.0], [100.0, -100.0, -20.0], [0.0, 100.0, -20.0]], np.float32)
    world = World("floor", vertices, np.array([[0, 1, 2]], np.int32), None, np.empty((0, 3)), "a floor")
    return world, RayCaster(world)


def noisy(**wrong: float) -> NoiseSettings:
    """Only this wrong."""
    return NoiseSettings(**{**NO_NOISE, **wrong})


def rig(
    noise: NoiseSettings = IDEAL,
    settings: SensorSettings = SETTINGS,
    seed: int = 1,
    scene: tuple[World, RayCaster] | None = None,
) -> SensorRig:
    world, caster = room() if scene is None else scene
    return SensorRig(
        settings, noise, caster, DepthRenderer(world, settings.camera.model()), np.random.default_rng(seed)
    )


def with_rates(camera_hz: float = 5.0, beams_hz: float = 20.0) -> SensorSettings:
    return SensorSettings(camera=CAMERA.model_copy(update={"rate_hz": camera_hz}), beams=BeamSettings(rate_hz=beams_hz))


def observe(sensors: SensorRig, ticks: int, at: Pose = AT, speed_mps: float = 0.0) -> list[Observation]:
    """What arrives in each of so many ticks, flying straight ahead along x."""
    return [
        sensors.observe(replace(at, t_s=TICK_S * i, x_m=at.x_m + speed_mps * TICK_S * i, vx_mps=speed_mps))
        for i in range(ticks)
    ]


def ranges_of(observations: Sequence[Observation], beam: Beam) -> list[float | None]:
    return [reading.range_m for seen in observations for reading in seen.ranges if reading.beam == beam]


class TestIdeal:
    """Without noise everything is true."""

    def test_pose_beams_and_image_are_true_and_come_at_once(self) -> None:
        """Protects `noise.enabled: false`, whatever else is configured: other noise settings have no effect then."""
        terrible = NoiseSettings(
            enabled=False, depth_noise_per_m2=0.1, depth_dropout_share=0.9, depth_latency_s=1.0, frame_loss_share=0.9,
            range_noise_m=1.0, range_dropout_share=0.9, pose_noise_m=1.0, pose_drift_share=0.2,
        )  # fmt: skip
        world, _ = room()
        for pose in (AT, replace(AT, yaw_rad=0.7, pitch_rad=0.2, roll_rad=-0.1)):
            seen = rig(terrible).observe(pose)
            assert seen.pose == pose
            assert seen.t_s == pose.t_s
            assert seen.frame is not None
            assert (seen.frame.t_s, seen.frame.pose, seen.frame.camera) == (pose.t_s, pose, CAMERA.model())
            exact = DepthRenderer(world, CAMERA.model()).render(pose)
            np.testing.assert_array_equal(seen.frame.depth_m, exact)

    def test_the_beams_look_along_the_axes_of_the_body(self) -> None:
        """Protects left from right and up from down, in the order of the configuration."""
        seen = rig().observe(AT)
        assert [reading.beam for reading in seen.ranges] == list(SETTINGS.beams.directions)
        for reading in seen.ranges:
            assert reading.range_m == pytest.approx(RANGES[reading.beam], abs=FLOAT32_M)
            assert (reading.t_s, reading.max_range_m) == (AT.t_s, SETTINGS.beams.max_range_m)

    def test_the_beams_turn_and_tilt_with_the_body(self) -> None:
        """Protects yaw, pitch and roll of the beams: nose down the front beam meets the floor, and down looks back."""
        turned = rig().observe(replace(AT, yaw_rad=math.pi / 2.0)).ranges
        assert {r.beam: r.range_m for r in turned}[Beam.FRONT] == pytest.approx(RANGES[Beam.LEFT], abs=FLOAT32_M)
        pitched = {r.beam: r.range_m for r in rig().observe(replace(AT, pitch_rad=0.5)).ranges}
        assert pitched[Beam.FRONT] == pytest.approx(1.2 / math.sin(0.5), abs=FLOAT32_M)
        assert pitched[Beam.DOWN] == pytest.approx(1.2 / math.cos(0.5), abs=FLOAT32_M)
        assert pitched[Beam.LEFT] == pytest.approx(3.0, abs=FLOAT32_M)
        # The left side far up: the right beam meets the floor, the left one the roof.
        rolled = {r.beam: r.range_m for r in rig().observe(replace(AT, roll_rad=1.2)).ranges}
        assert rolled[Beam.RIGHT] == pytest.approx(1.2 / math.sin(1.2), abs=FLOAT32_M)
        assert rolled[Beam.LEFT] == pytest.approx(1.8 / math.sin(1.2), abs=FLOAT32_M)

    def test_only_what_the_vehicle_carries(self) -> None:
        """Protects the outfit: the beams that are configured, and no planar scanner unless there is one."""
        only_down = SensorSettings(camera=CAMERA, beams=BeamSettings(directions=(Beam.DOWN,)))
        seen = rig(settings=only_down).observe(AT)
        assert [reading.beam for reading in seen.ranges] == [Beam.DOWN]
        assert seen.planar is None

    def test_the_planar_scanner_sees_the_room(self) -> None:
        """Protects its bearings: ascending over the full turn, and each range that of the wall there."""
        settings = SensorSettings(camera=CAMERA, planar=PlanarSettings(enabled=True, rays=36))
        turn = rig(settings=settings).observe(AT).planar
        assert turn is not None
        assert turn.bearings_rad.size == turn.ranges_m.size == 36
        assert (np.diff(turn.bearings_rad) > 0.0).all()
        assert -math.pi <= turn.bearings_rad[0]
        assert turn.bearings_rad[-1] < math.pi
        x, y = turn.ranges_m * np.cos(turn.bearings_rad), turn.ranges_m * np.sin(turn.bearings_rad)
        # On the nearest of the four walls: nothing is nearer, and one of them is met.
        off_m = np.minimum.reduce([np.abs(x - 5.0), np.abs(x + 3.0), np.abs(y - 3.0), np.abs(y + 1.0)])
        np.testing.assert_allclose(off_m, 0.0, atol=FLOAT32_M)
        assert (turn.pose, turn.max_range_m) == (AT, settings.planar.max_range_m)

    def test_what_is_nearer_than_the_camera_measures_is_not_measured(self) -> None:
        """Protects the blind zone: NaN, where the depth is below the smallest range and nowhere else."""
        world, _ = room()
        close = replace(AT, x_m=7.7)  # 0.2 m before the wall, with the lens 0.1 m ahead of the middle
        frame = rig().observe(close).frame
        assert frame is not None
        exact = DepthRenderer(world, CAMERA.model()).render(close)
        near = exact < CAMERA.min_range_m
        assert near.any()
        np.testing.assert_array_equal(np.isnan(frame.depth_m), near)


class TestLimits:
    """Far away is free, not unknown."""

    @pytest.mark.parametrize("noise", [IDEAL, noisy(range_noise_m=0.5, depth_noise_per_m2=0.01)])
    def test_nothing_in_range_is_free_out_to_the_limit(self, noise: NoiseSettings) -> None:
        """Protects CLEAR, with noise too: a beam says its limit, a depth and a planar ray are beyond theirs."""
        settings = SensorSettings(camera=CAMERA, planar=PlanarSettings(enabled=True))
        seen = rig(noise, settings, scene=far_floor()).observe(replace(AT, z_m=0.0))
        assert [reading.range_m for reading in seen.ranges] == [settings.beams.max_range_m] * 6
        assert seen.frame is not None
        assert (seen.frame.depth_m >= settings.camera.max_range_m).all()
        assert seen.planar is not None
        assert (seen.planar.ranges_m >= settings.planar.max_range_m).all()

    def test_a_range_is_never_negative_nor_beyond_the_limit(self) -> None:
        """Protects the domain of a reading from the noise: 0.05 m before a wall, and 0.05 m below the limit."""
        settings = SensorSettings(camera=CAMERA, beams=BeamSettings(max_range_m=2.95, rate_hz=20.0))
        seen = observe(rig(noisy(range_noise_m=0.2), settings), 200, replace(AT, y_m=0.05, x_m=2.9))
        for beam, limit_m in ((Beam.RIGHT, 0.0), (Beam.BACK, 2.95)):
            ranges = [range_m for range_m in ranges_of(seen, beam) if range_m is not None]
            assert len(ranges) == 200
            assert all(0.0 <= range_m <= 2.95 for range_m in ranges)
            assert limit_m in ranges


class TestTiming:
    """When which reading comes."""

    @pytest.mark.parametrize(("rate_hz", "every"), [(20.0, 1), (10.0, 2), (5.0, 4), (2.0, 10), (90.0, 1)])
    def test_frames_and_beams_come_at_their_rates(self, rate_hz: float, every: int) -> None:
        """Protects the rates, on the grid from 0 on: every n-th tick, and each tick for what is faster."""
        frames = observe(rig(settings=with_rates(camera_hz=rate_hz)), 81)
        assert [i for i, seen in enumerate(frames) if seen.frame is not None] == list(range(0, 81, every))
        beams = observe(rig(settings=with_rates(beams_hz=rate_hz)), 81)
        assert [i for i, seen in enumerate(beams) if seen.ranges] == list(range(0, 81, every))

    @pytest.mark.parametrize("rate_hz", [3.0, 7.0, 13.0])
    def test_a_rate_that_does_not_fit_the_ticks_is_kept_on_average(self, rate_hz: float) -> None:
        """Protects the number of frames: each comes in the tick after it is due, and none is lost by that."""
        seen = observe(rig(settings=with_rates(camera_hz=rate_hz)), round(10.0 / TICK_S))
        times = [observation.t_s for observation in seen if observation.frame is not None]
        due = np.arange(len(times)) / rate_hz
        assert len(times) == math.ceil(10.0 * rate_hz - TICK_S * rate_hz)
        assert (np.array(times) >= due - 1e-6).all()
        assert (np.array(times) < due + TICK_S + 1e-6).all()

    @pytest.mark.parametrize("latency_s", [0.0, 0.05, 0.12, 0.5])
    def test_a_late_frame_carries_the_time_and_the_pose_of_its_exposure(self, latency_s: float) -> None:
        """Protects the map and the scan from being shifted by the latency: 0.5 s are 25 cm at 0.5 m/s.

        Several frames are under way at 0.5 s and 10 Hz; all arrive, in their order, each at the first tick possible.
        """
        seen = observe(rig(noisy(depth_latency_s=latency_s), with_rates(camera_hz=10.0)), 60, speed_mps=0.5)
        poses = {observation.t_s: observation.pose for observation in seen}
        frames = [(observation.t_s, observation.frame) for observation in seen if observation.frame is not None]
        exposed = [frame.t_s for _, frame in frames]
        assert exposed == pytest.approx([0.1 * i for i in range(len(frames))])
        last_s = TICK_S * 59
        assert len(frames) == 1 + math.floor((last_s - latency_s) / 0.1 + 1e-6)
        for arrived_s, frame in frames:
            assert -1e-6 <= arrived_s - frame.t_s - latency_s < TICK_S - 1e-6
            assert frame.pose == poses[frame.t_s]
            assert frame.pose.x_m == pytest.approx(AT.x_m + 0.5 * frame.t_s)
            # The image is that of the exposure too: the wall is as far in front of the lens as it was then.
            ahead_m = 8.0 - frame.pose.x_m - CAMERA.mount_x_m
            assert frame.depth_m[24, 32] == pytest.approx(ahead_m, abs=FLOAT32_M)

    def test_beams_come_without_delay(self) -> None:
        """Protects the time of a reading: that of the tick in which it is handed over."""
        for observation in observe(rig(noisy(depth_latency_s=0.5)), 10):
            assert [reading.t_s for reading in observation.ranges] == [observation.t_s] * 6


class TestNoise:
    """As wrong as configured."""

    def test_depth_noise_grows_with_the_square_of_the_depth(self) -> None:
        """Protects the stereo model: depth errors over depth² have the configured deviation, near and far alike."""
        frames = [seen.frame for seen in observe(rig(noisy(depth_noise_per_m2=0.004), with_rates(20.0)), 10)]
        exact = DepthRenderer(room()[0], CAMERA.model()).render(AT)
        for near, far in ((0.3, 3.0), (3.0, 5.0)):
            where = (exact > near) & (exact < far)
            errors = np.concatenate([(f.depth_m[where] - exact[where]) / exact[where] ** 2 for f in frames if f])
            # The standard deviation of a deviation from n values is 1/√(2n) of it, that of a mean 1/√n.
            bound = DEVIATIONS / math.sqrt(2.0 * errors.size)
            assert errors.size > 5000
            assert np.std(errors) == pytest.approx(0.004, rel=bound)
            assert abs(np.mean(errors)) < DEVIATIONS * 0.004 / math.sqrt(errors.size)

    @pytest.mark.parametrize("share", [0.0, 0.02, 0.3])
    def test_the_configured_share_of_pixels_is_missing(self, share: float) -> None:
        """Protects the dropouts of the depth image."""
        seen = observe(rig(noisy(depth_dropout_share=share), with_rates(20.0)), 10)
        missing = np.concatenate([np.isnan(s.frame.depth_m).ravel() for s in seen if s.frame is not None])
        bound = DEVIATIONS * math.sqrt(share * (1.0 - share) / missing.size)
        assert np.mean(missing) == pytest.approx(share, abs=bound)

    def test_the_configured_share_of_frames_is_lost(self) -> None:
        """Protects the losses: a lost frame does not come later either."""
        share, ticks = 0.3, 600
        seen = observe(rig(noisy(frame_loss_share=share), with_rates(20.0)), ticks)
        lost = sum(observation.frame is None for observation in seen)
        assert lost == pytest.approx(share * ticks, abs=DEVIATIONS * math.sqrt(share * (1.0 - share) * ticks))
        assert all(s.frame.t_s == s.t_s for s in seen if s.frame is not None)

    def test_the_beams_have_their_noise_and_their_dropouts(self) -> None:
        """Protects the rangefinders: deviation, share of readings without a range, and no bias."""
        share, noise_m, ticks = 0.1, 0.05, 500
        seen = observe(rig(noisy(range_noise_m=noise_m, range_dropout_share=share)), ticks)
        errors = []
        for beam, true_m in RANGES.items():
            ranges = ranges_of(seen, beam)
            assert len(ranges) == ticks
            errors += [range_m - true_m for range_m in ranges if range_m is not None]
        readings = 6 * ticks
        dropped = readings - len(errors)
        assert dropped == pytest.approx(readings * share, abs=DEVIATIONS * math.sqrt(share * (1.0 - share) * readings))
        assert np.std(errors) == pytest.approx(noise_m, rel=DEVIATIONS / math.sqrt(2.0 * len(errors)))
        assert abs(np.mean(errors)) < DEVIATIONS * noise_m / math.sqrt(len(errors))

    def test_the_planar_scanner_has_them_too(self) -> None:
        """Protects the same for the planar scan, where nothing measured is NaN."""
        settings = SensorSettings(camera=CAMERA, planar=PlanarSettings(enabled=True, rays=3600))
        exact = rig(settings=settings).observe(AT).planar
        turn = rig(noisy(range_noise_m=0.05, range_dropout_share=0.1), settings).observe(AT).planar
        assert exact is not None
        assert turn is not None
        missing = np.isnan(turn.ranges_m)
        errors = (turn.ranges_m - exact.ranges_m)[~missing]
        assert np.mean(missing) == pytest.approx(0.1, abs=DEVIATIONS * math.sqrt(0.09 / 3600))
        assert np.std(errors) == pytest.approx(0.05, rel=DEVIATIONS / math.sqrt(2.0 * errors.size))

    def test_the_same_seed_sees_the_same(self) -> None:
        """Protects the repeatability of runs, and shows that the seed matters."""

        def readings(seed: int) -> list[tuple[Pose, tuple[object, ...], bytes]]:
            return [
                (s.pose, s.ranges, b"" if s.frame is None else s.frame.depth_m.tobytes())
                for s in observe(rig(NoiseSettings(), seed=seed), 20)
            ]

        assert readings(3) == readings(3)
        assert all(a != b for a, b in zip(readings(3), readings(4), strict=True))


class TestPoseEstimate:
    """What the estimator makes of the true pose."""

    @staticmethod
    def errors(noise: NoiseSettings, true: Sequence[Pose], seed: int) -> np.ndarray[Any, np.dtype[np.float64]]:
        """The (poses, 3) errors of the estimated position."""
        estimate = PoseEstimate(noise, np.random.default_rng(seed))
        found = [estimate.of(pose) for pose in true]
        return np.array([[e.x_m - p.x_m, e.y_m - p.y_m, e.z_m - p.z_m] for e, p in zip(found, true, strict=True)])

    @staticmethod
    def straight(length_m: float, steps: int) -> list[Pose]:
        return [Pose(0.1 * i, length_m * i / steps, 0.0, 1.5, 0.0) for i in range(steps + 1)]

    def test_white_noise_has_its_deviation_on_every_axis(self) -> None:
        """Protects the noise of position, attitude and velocity, and the yaw rate and time, which are true."""
        noise = noisy(pose_noise_m=0.02, pose_noise_rad=0.01, velocity_noise_mps=0.05)
        estimate = PoseEstimate(noise, np.random.default_rng(1))
        true = replace(AT, yaw_rad=1.0, vx_mps=0.5, yaw_rate_radps=0.2)
        found = [estimate.of(true) for _ in range(2000)]
        expected = {"x_m": 0.02, "y_m": 0.02, "z_m": 0.02, "yaw_rad": 0.01, "roll_rad": 0.01, "pitch_rad": 0.01}
        expected |= {"vx_mps": 0.05, "vy_mps": 0.05, "vz_mps": 0.05}
        for name, deviation in expected.items():
            errors = np.array([getattr(pose, name) for pose in found]) - getattr(true, name)
            assert np.std(errors) == pytest.approx(deviation, rel=DEVIATIONS / math.sqrt(4000.0)), name
            assert abs(np.mean(errors)) < DEVIATIONS * deviation / math.sqrt(2000.0), name
        assert {(pose.t_s, pose.yaw_rate_radps) for pose in found} == {(true.t_s, true.yaw_rate_radps)}

    def test_the_estimated_yaw_stays_in_its_range(self) -> None:
        """Protects the convention [-π, π) where noise pushes the heading over the seam."""
        estimate = PoseEstimate(noisy(pose_noise_rad=0.1), np.random.default_rng(1))
        yaws = [estimate.of(replace(AT, yaw_rad=-math.pi)).yaw_rad for _ in range(100)]
        assert all(-math.pi <= yaw < math.pi for yaw in yaws)
        assert min(yaws) < -3.0
        assert max(yaws) > 3.0

    @pytest.mark.parametrize("length_m", [2.0, 20.0, 200.0])
    def test_the_drift_is_the_configured_share_of_the_way(self, length_m: float) -> None:
        """Protects pose_drift_share: over a few metres the drift is that share of the way, and further on less.

        Its direction forgets itself over T = 20 m, so the mean square of the drift over a way L is, as for any
        velocity whose correlation is exp(-s/T), share²·2T²·(L/T - 1 + exp(-L/T)). Of n ways with three Gaussian axes
        each the mean square has the relative standard deviation √(2/(3n)).
        """
        share, ways = 0.02, 300
        true = self.straight(length_m, steps=20 if length_m < 100.0 else 100)
        squares = [
            float(np.sum(self.errors(noisy(pose_drift_share=share), true, seed)[-1] ** 2)) for seed in range(ways)
        ]
        ratio = length_m / DRIFT_TURNS_M
        expected = share**2 * 2.0 * DRIFT_TURNS_M**2 * (ratio - 1.0 + math.exp(-ratio))
        if length_m == 2.0:
            assert math.sqrt(expected) == pytest.approx(share * length_m, rel=0.02)
        # A step of the way is up to a tenth of T, over which its direction is one: less than 1 % of the square.
        bound = DEVIATIONS * math.sqrt(2.0 / (3.0 * ways)) + 0.01
        assert np.mean(squares) == pytest.approx(expected, rel=bound)

    def test_the_drift_grows_slowly_and_only_with_the_way(self) -> None:
        """Protects against jumps: the drift of a tick is about the share of what was flown, and hovering adds none."""
        share = 0.05
        moving = self.straight(10.0, steps=200)
        hovering = [replace(moving[-1], t_s=100.0 + i) for i in range(50)]
        errors = self.errors(noisy(pose_drift_share=share), moving + hovering, seed=1)
        grown_m = np.linalg.norm(np.diff(errors[: len(moving)], axis=0), axis=1)
        # The direction has three axes with deviation 1/√3: five of them on each at once are never seen.
        assert grown_m.max() < share * 0.05 * DEVIATIONS
        assert grown_m.max() > 0.0
        np.testing.assert_array_equal(errors[len(moving) :], np.broadcast_to(errors[len(moving) - 1], (50, 3)))

    def test_without_drift_the_error_does_not_grow(self) -> None:
        """Protects the default share 0: after a kilometre the error is that of the first metre."""
        errors = self.errors(noisy(pose_noise_m=0.01), self.straight(1000.0, steps=1000), seed=1)
        assert np.abs(errors).max() < DEVIATIONS * 0.01

    def test_the_error_of_a_frame_is_that_of_its_pose(self) -> None:
        """Protects the map: a frame carries the estimate of its own tick, which the observation holds too."""
        for seen in itertools.islice(observe(rig(noisy(pose_noise_m=0.05)), 20), 20):
            if seen.frame is not None:
                assert seen.frame.pose == seen.pose
