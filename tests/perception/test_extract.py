"""From everything the sensors said to one measurement: h, N, d, d_f, the rate of d, and what is missing."""

from __future__ import annotations

import math
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike

from companion.config.sensors import BeamSettings, CameraSettings, ScanSettings, SensorSettings
from companion.config.vehicle import VehicleSettings
from companion.model import (
    CLEAR,
    FRONT_RAD,
    HIT,
    UNKNOWN,
    Beam,
    DepthFrame,
    Input,
    Measurement,
    Observation,
    PlanarScan,
    Pose,
    RangeReading,
    Scan,
)
from companion.perception import Extractor
from companion.perception.extract import POSE_STALE_S
from companion.perception.look import bin_bearings
from tests.perception.scenes import AT_START, FLOOR, H_M, ROOF, Surface, between, frame, wall_ahead, wall_beside

SMALL = CameraSettings(width_px=64, height_px=48)
CAMERA = SMALL.model()
SETTINGS = SensorSettings(camera=SMALL)
VEHICLE = VehicleSettings(body_radius_m=0.35, body_height_m=0.3)
BEAM_LIMIT_M = SETTINGS.beams.max_range_m
BEAM_STALE_S = SETTINGS.beams.stale_after_s
DEPTH_STALE_S = SETTINGS.scan.stale_after_s
BINS = SETTINGS.scan.bins
BEARINGS = bin_bearings(BINS)
HALF_BIN_RAD = math.pi / BINS
SOON_S = 0.05
EXACT_M = 1e-3
"""Depths are float32: 1e-6 of 10 m."""

OPEN = [FLOOR, ROOF]
NAN, INF = float("nan"), float("inf")
DOWN = {Beam.DOWN: H_M}


def extractor(sensors: SensorSettings = SETTINGS) -> Extractor:
    return Extractor(sensors, VEHICLE)


def readings(t_s: float, ranges_m: Mapping[Beam, float | None]) -> tuple[RangeReading, ...]:
    return tuple(RangeReading(beam, t_s, range_m, BEAM_LIMIT_M) for beam, range_m in ranges_m.items())


def image(surfaces: list[Surface], pose: Pose = AT_START) -> DepthFrame:
    return frame(surfaces, pose, CAMERA)


def observed(
    pose: Pose,
    surfaces: list[Surface] | None = None,
    ranges_m: Mapping[Beam, float | None] | None = None,
    planar: PlanarScan | None = None,
) -> Observation:
    """Everything at the time of ``pose``: an image of the surfaces, beams, a planar scan."""
    seen = None if surfaces is None else image(surfaces, pose)
    return Observation(pose.t_s, pose, seen, readings(pose.t_s, ranges_m or {}), planar)


def planar(pose: Pose, bearings_deg: ArrayLike, ranges_m: ArrayLike) -> PlanarScan:
    return PlanarScan(pose.t_s, np.radians(bearings_deg), np.array(ranges_m, np.float64), 10.0, pose)


def later(pose: Pose, dt_s: float, **changed: float) -> Pose:
    return replace(pose, t_s=pose.t_s + dt_s, **changed)


def scan_of(measurement: Measurement) -> Scan:
    assert measurement.scan is not None
    return measurement.scan


def bin_at(bearing_deg: float) -> int:
    """The bin that holds a bearing."""
    return int((math.radians(bearing_deg) + math.pi) / (2.0 * math.pi) * BINS) % BINS


class TestHeight:
    """h (paper Definition 3.7)."""

    @pytest.mark.parametrize(("pitch_deg", "roll_deg"), [(0.0, 0.0), (10.0, 0.0), (0.0, -10.0), (-8.0, 9.0)])
    def test_the_height_is_along_gravity(self, pitch_deg: float, roll_deg: float) -> None:
        """Protects the height law from the tilt: a slanted beam is longer than the height."""
        pitch_rad, roll_rad = math.radians(pitch_deg), math.radians(roll_deg)
        pose = replace(AT_START, pitch_rad=pitch_rad, roll_rad=roll_rad)
        slanted = {Beam.DOWN: H_M / (math.cos(pitch_rad) * math.cos(roll_rad)), Beam.UP: 2.0}
        measured = extractor().measure(observed(pose, OPEN, slanted))
        assert measured.h_m == pytest.approx(H_M)
        assert measured.roof_m == pytest.approx(2.0 * math.cos(pitch_rad) * math.cos(roll_rad))

    def test_the_tilt_is_that_of_the_reading(self) -> None:
        """Protects the height of a vehicle that levels out between two readings."""
        tilted = replace(AT_START, pitch_rad=0.3)
        extract = extractor()
        extract.measure(observed(tilted, OPEN, {Beam.DOWN: H_M / math.cos(0.3)}))
        assert extract.measure(observed(later(AT_START, SOON_S))).h_m == pytest.approx(H_M)

    def test_the_height_goes_on_with_the_climb(self) -> None:
        """Protects the height law from acting on an old height between two readings."""
        extract = extractor()
        extract.measure(observed(AT_START, OPEN, DOWN))
        measured = extract.measure(observed(later(AT_START, SOON_S, z_m=AT_START.z_m + 0.2)))
        assert measured.h_m == pytest.approx(H_M + 0.2)

    def test_a_dropout_does_not_blind_and_a_long_one_is_told(self) -> None:
        """Protects both ways: one lost reading must not stop the vehicle, and no reading must not keep it flying."""
        extract = extractor()
        extract.measure(observed(AT_START, OPEN, DOWN))
        for age_s in (0.5 * BEAM_STALE_S, BEAM_STALE_S):
            measured = extract.measure(observed(later(AT_START, age_s), OPEN, {Beam.DOWN: None}))
            assert measured.h_m == pytest.approx(H_M)
            assert measured.missing == ()
        stale = extract.measure(observed(later(AT_START, BEAM_STALE_S + 0.01), OPEN, {Beam.DOWN: None}))
        assert stale.h_m is None
        assert stale.missing == (Input.HEIGHT,)
        back = extract.measure(observed(later(AT_START, BEAM_STALE_S + 0.02), OPEN, DOWN))
        assert back.missing == ()

    @pytest.mark.parametrize("range_m", [None, 0.0, -1.0, NAN, INF, BEAM_LIMIT_M, BEAM_LIMIT_M + 1.0])
    def test_what_is_no_height_is_missing(self, range_m: float | None) -> None:
        """Protects unknown: nothing measured, or no ground within range, is no height of 0 or of the limit."""
        measured = extractor().measure(observed(AT_START, OPEN, {Beam.DOWN: range_m}))
        assert measured.h_m is None
        assert Input.HEIGHT in measured.missing

    def test_a_reading_from_the_future_does_not_count(self) -> None:
        """Protects against a sensor's clock that runs ahead: its age would never grow."""
        early = Observation(0.0, AT_START, image(OPEN), readings(1.0, DOWN))
        assert extractor().measure(early).missing == (Input.DEPTH, Input.HEIGHT)


class TestLookAhead:
    """The newest look, and when it is too old."""

    def test_everything_there_means_nothing_missing(self) -> None:
        """Protects the way out of HOLD: with all inputs fresh the vehicle may fly."""
        measured = extractor().measure(observed(AT_START, OPEN, DOWN))
        assert measured.missing == ()
        assert measured.scan_age_s == 0.0
        assert measured.t_s == AT_START.t_s
        assert (measured.d_m, measured.d_bearing_rad, measured.d_front_m, measured.d_dot_mps) == (None,) * 4
        assert measured.ground_slope == pytest.approx(0.0, abs=1e-5)

    def test_a_stale_look_is_missing(self) -> None:
        """Protects from flying on a picture that no longer holds; the slope ahead goes with it."""
        extract = extractor()
        extract.measure(observed(AT_START, OPEN, DOWN))
        held = extract.measure(observed(later(AT_START, DEPTH_STALE_S), None, DOWN))
        assert held.missing == ()
        assert held.scan_age_s == pytest.approx(DEPTH_STALE_S)
        stale = extract.measure(observed(later(AT_START, DEPTH_STALE_S + 0.01), None, DOWN))
        assert stale.missing == (Input.DEPTH,)
        assert stale.scan is None
        assert stale.ground_slope is None
        assert stale.d_m is None

    def test_without_any_image_depth_is_missing(self) -> None:
        """Protects the start: beams alone see no way ahead."""
        measured = extractor().measure(observed(AT_START, None, {Beam.DOWN: H_M, Beam.FRONT: 3.0}))
        assert measured.missing == (Input.DEPTH,)
        assert measured.scan is None

    def test_an_image_from_the_future_does_not_count(self) -> None:
        """Protects against a camera's clock that runs ahead."""
        ahead = Observation(0.0, AT_START, image(OPEN, later(AT_START, 1.0)), readings(0.0, DOWN))
        assert extractor().measure(ahead).missing == (Input.DEPTH,)

    def test_an_image_cannot_be_read_without_a_height(self) -> None:
        """Protects the slab: where the ground is not known, neither is what stands on it."""
        measured = extractor().measure(observed(AT_START, [FLOOR, ROOF, wall_ahead(3.0)], None))
        assert measured.missing == (Input.DEPTH, Input.HEIGHT)

    def test_the_height_is_that_of_the_exposure(self) -> None:
        """Protects the slab when an image arrives late: the vehicle has climbed 0.5 m since, over a bar that it saw.

        The bar is in the slab of the exposure's height and below the slab of the present one.
        """
        bar = Surface((4.0, 0.0, 0.0), (1.0, 0.0, 0.0), lambda p: (p[..., 2] > H_M - 0.35) & (p[..., 2] < H_M - 0.1))
        pose = later(AT_START, 0.2, z_m=H_M + 0.5)
        late = Observation(pose.t_s, pose, image([FLOOR, ROOF, bar]), readings(pose.t_s, {Beam.DOWN: H_M + 0.5}))
        assert scan_of(extractor().measure(late)).state[bin_at(0.0)] == HIT

    def test_the_scan_turns_with_the_vehicle(self) -> None:
        """Protects bearings between two images: the wall stays in the world while the vehicle turns left by 20°."""
        extract = extractor()
        wall = [FLOOR, ROOF, wall_ahead(4.0)]
        extract.measure(observed(AT_START, wall, DOWN))
        turned = later(AT_START, SOON_S, yaw_rad=math.radians(20.0))
        scan = scan_of(extract.measure(observed(turned, None, DOWN)))
        seen = (scan.state == HIT) & scan.fresh
        bearings_deg = np.degrees(BEARINGS[seen])
        # From the lens, 0.1 m before the middle, the outermost pixel looks this far aside; a bin may be cut there.
        aside_m = (4.0 - CAMERA.mount_x_m) * CAMERA.cx_px / CAMERA.fx_px
        edge_deg = math.degrees(math.atan2(aside_m, 4.0))
        assert bearings_deg.min() == pytest.approx(-20.0 - edge_deg, abs=1.0)
        assert bearings_deg.max() == pytest.approx(-20.0 + edge_deg, abs=1.0)
        expected = 4.0 / np.cos(BEARINGS[seen] + turned.yaw_rad)
        # The range is that of half a bin beside, and of the nearest pixel in its bin: a whole bin at 43°.
        np.testing.assert_allclose(scan.ranges_m[seen], expected, atol=4.0 * 2.0 * HALF_BIN_RAD * 1.3)

    def test_the_scan_comes_nearer_with_the_vehicle(self) -> None:
        """Protects ranges between two images: 0.3 m flown are 0.3 m nearer."""
        extract = extractor()
        extract.measure(observed(AT_START, [FLOOR, ROOF, wall_ahead(4.0)], DOWN))
        scan = scan_of(extract.measure(observed(later(AT_START, SOON_S, x_m=0.3), None, DOWN)))
        assert scan.ranges_m[bin_at(0.2)] == pytest.approx(3.7, abs=EXACT_M)

    def test_turning_and_moving_at_once(self) -> None:
        """Protects the translation's frame: 0.5 m nearer to the wall that is now on the right, not 0.5 m beside it."""
        extract = extractor()
        extract.measure(observed(AT_START, [FLOOR, ROOF, wall_ahead(4.0)], DOWN))
        pose = later(AT_START, SOON_S, x_m=0.5, yaw_rad=math.radians(90.0))
        scan = scan_of(extract.measure(observed(pose, None, DOWN)))
        b = bin_at(-90.0)
        # Both bins beside -90° look half a bin beside the wall's nearest point.
        assert (scan.state[b], scan.fresh[b]) == (HIT, True)
        assert scan.ranges_m[b] == pytest.approx(3.5, abs=EXACT_M)

    def test_a_late_image_is_put_where_it_was_taken(self) -> None:
        """Protects against latency: the pose of the exposure counts, not that of the arrival."""
        pose = later(AT_START, 0.2, x_m=0.5)
        late = Observation(pose.t_s, pose, image([FLOOR, ROOF, wall_ahead(4.0)]), readings(pose.t_s, DOWN))
        measured = extractor().measure(late)
        assert scan_of(measured).ranges_m[bin_at(0.2)] == pytest.approx(3.5, abs=EXACT_M)
        assert measured.scan_age_s == pytest.approx(0.2)

    def test_the_number_of_bins_is_the_setting(self) -> None:
        """Protects the form of N(t) that the law reads: ascending, even, over the full turn."""
        sensors = SensorSettings(camera=SMALL, scan=ScanSettings(bins=180))
        scan = scan_of(extractor(sensors).measure(observed(AT_START, OPEN, DOWN)))
        np.testing.assert_allclose(scan.bearings_rad, bin_bearings(180))
        assert scan.ranges_m.shape == scan.state.shape == scan.fresh.shape == (180,)


class TestPose:
    """Where the vehicle is must be known now."""

    @pytest.mark.parametrize(
        ("age_s", "missing"),
        [(0.0, ()), (POSE_STALE_S, ()), (POSE_STALE_S + 0.01, (Input.POSE,)), (-0.01, (Input.POSE,))],
    )
    def test_an_old_pose_and_one_from_the_future_are_missing(self, age_s: float, missing: tuple[Input, ...]) -> None:
        """Protects against an estimator that has stopped, and against clocks that disagree."""
        pose = AT_START
        now_s = age_s
        seen = replace(image(OPEN), t_s=now_s)
        assert extractor().measure(Observation(now_s, pose, seen, readings(now_s, DOWN))).missing == missing

    @pytest.mark.parametrize("name", ["x_m", "y_m", "z_m", "yaw_rad", "vx_mps", "vy_mps"])
    @pytest.mark.parametrize("value", [NAN, INF, -INF])
    def test_a_pose_that_is_not_finite_is_missing(self, name: str, value: float) -> None:
        """Protects from an estimator that has diverged."""
        extract = extractor()
        extract.measure(observed(AT_START, OPEN, DOWN))
        pose = later(AT_START, SOON_S, **{name: value})
        assert "pose" in extract.measure(Observation(pose.t_s, pose, None, readings(pose.t_s, DOWN))).missing

    @pytest.mark.parametrize("name", ["roll_rad", "pitch_rad"])
    def test_an_attitude_that_is_not_finite_is_missing(self, name: str) -> None:
        """Protects from a wall that is 0.5 m beside and disappears: nothing may be told of d then, or all of it."""
        extract = extractor()
        extract.measure(observed(AT_START, OPEN, {Beam.DOWN: H_M, Beam.LEFT: 0.5, Beam.UP: H_M}))
        measured = extract.measure(observed(later(AT_START, SOON_S, **{name: NAN})))
        assert Input.POSE in measured.missing
        assert_finite(measured)

    def test_nothing_that_is_not_finite_comes_out_of_a_velocity(self) -> None:
        """Protects logs and displays, and whoever reads the rate without asking what is missing."""
        pose = replace(AT_START, vx_mps=NAN)
        measured = extractor().measure(observed(pose, [FLOOR, ROOF, wall_ahead(3.0)], DOWN))
        assert Input.POSE in measured.missing
        assert_finite(measured)

    def test_a_beam_read_while_the_pose_was_no_number_is_not_remembered(self) -> None:
        """Its place would be a NaN, and the NaN the index of an array: the process died of it."""
        extract = extractor()
        beside = {**DOWN, Beam.LEFT: 1.0}
        extract.measure(observed(replace(AT_START, x_m=NAN), OPEN, beside))
        after = extract.measure(observed(replace(AT_START, t_s=SOON_S), OPEN, DOWN))
        assert_finite(after)
        assert after.missing == ()

    def test_a_computer_that_has_been_on_for_weeks_flies(self) -> None:
        """Times count from its start: after 12 days they pass a million seconds."""
        late = extractor().measure(observed(replace(AT_START, t_s=2e6), OPEN, DOWN))
        assert late.missing == ()
        assert late.h_m == pytest.approx(H_M, abs=EXACT_M)

    def test_an_image_whose_pose_is_not_finite_crashes_nothing(self) -> None:
        """Protects the process: compiled code has no bounds. In a process of its own, because it takes it down."""
        source = """
from dataclasses import replace
from tests.perception.test_extract import *
for name in ("x_m", "yaw_rad"):
    extract = extractor()
    seen = replace(image([FLOOR, ROOF, wall_ahead(3.0)]), pose=replace(AT_START, **{name: NAN}))
    extract.measure(Observation(0.0, AT_START, seen, readings(0.0, DOWN)))
    assert_finite(extract.measure(observed(later(AT_START, SOON_S), OPEN, DOWN)))
"""
        done = subprocess.run([sys.executable, "-c", source], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr


class TestLeastDistance:
    """d, its bearing, d_f and the rate of d."""

    def measured(self, bearings_deg: ArrayLike, ranges_m: ArrayLike, **moving: float) -> Measurement:
        pose = replace(AT_START, **moving)
        return extractor().measure(observed(pose, None, DOWN, planar(pose, bearings_deg, ranges_m)))

    def test_the_nearest_and_its_bearing(self) -> None:
        """Protects d and α*: the sign of the bearing says on which side the wall is."""
        measured = self.measured([-90.5, -30.5, 60.5], [1.2, 3.0, 2.0])
        assert measured.d_m == pytest.approx(1.2)
        assert measured.d_bearing_rad == pytest.approx(math.radians(-90.5))
        assert measured.d_front_m == pytest.approx(1.2)

    @pytest.mark.parametrize(
        ("bearing_deg", "in_front"),
        [
            (180.0 - 1e-6, False),
            (-180.0, False),
            (136.0, False),
            (-136.0, False),
            (134.0, True),
            (-134.0, True),
            (0.0, True),
        ],
    )
    def test_what_is_behind_counts_for_d_and_not_for_the_front(self, bearing_deg: float, in_front: bool) -> None:
        """Protects (12): the vehicle must be able to fly away from a wall behind it."""
        assert math.degrees(FRONT_RAD) == pytest.approx(135.0)
        measured = self.measured([bearing_deg], [0.8])
        assert measured.d_m == pytest.approx(0.8)
        assert measured.d_front_m == (pytest.approx(0.8) if in_front else None)

    def test_the_front_has_a_distance_of_its_own(self) -> None:
        """Protects d_f from being d or nothing: a nearer wall behind does not hide the one in front."""
        measured = self.measured([-179.5, 20.5], [0.5, 2.0])
        assert measured.d_m == pytest.approx(0.5)
        assert measured.d_front_m == pytest.approx(2.0)

    def test_nothing_near_is_none(self) -> None:
        """Protects unknown from being a number: no obstacle has no distance, no bearing and no rate."""
        measured = self.measured([0.0, 90.0], [INF, NAN])
        assert (measured.d_m, measured.d_bearing_rad, measured.d_front_m, measured.d_dot_mps) == (None,) * 4
        assert measured.missing == ()

    @pytest.mark.parametrize("yaw_rad", [0.0, 2.0, -3.0])
    @pytest.mark.parametrize(
        ("bearing_deg", "forward_mps"), [(0.5, 0.5), (60.5, 0.5), (90.5, 0.5), (179.5, 0.5), (0.5, -0.2)]
    )
    def test_the_rate_is_negative_when_coming_nearer(
        self, yaw_rad: float, bearing_deg: float, forward_mps: float
    ) -> None:
        """Protects the sign of the rate in law (7), against the distance itself to a point that stands still."""
        vx_mps, vy_mps = forward_mps * math.cos(yaw_rad), forward_mps * math.sin(yaw_rad)
        measured = self.measured([bearing_deg], [2.0], yaw_rad=yaw_rad, vx_mps=vx_mps, vy_mps=vy_mps)
        # Central difference of the distance to the point, a millisecond before and after: exact to 1e-7.
        direction_rad = yaw_rad + math.radians(bearing_deg)
        x_m, y_m = 2.0 * math.cos(direction_rad), 2.0 * math.sin(direction_rad)
        before_m, after_m = (math.hypot(x_m - t * vx_mps, y_m - t * vy_mps) for t in (-1e-3, 1e-3))
        assert measured.d_dot_mps == pytest.approx((after_m - before_m) / 2e-3, abs=1e-6)

    def test_every_sensor_that_looks_sideways_counts(self) -> None:
        """Protects d from being the camera's alone: image, planar scan and beams, whichever sees the nearest."""
        nearest = {"image": 3.0, "planar": 3.0, "beam": 3.0}
        for sensor in nearest:
            at_m = {**nearest, sensor: 1.0}
            measured = extractor().measure(
                observed(
                    AT_START,
                    [FLOOR, ROOF, wall_ahead(at_m["image"])],
                    {Beam.DOWN: H_M, Beam.BACK: at_m["beam"]},
                    planar(AT_START, [100.5], [at_m["planar"]]),
                )
            )
            assert measured.d_m == pytest.approx(1.0, abs=EXACT_M), sensor


class TestBeams:
    """Single beams in the scan."""

    BEARING_DEG = ((Beam.FRONT, 0.0), (Beam.LEFT, 90.0), (Beam.BACK, -180.0), (Beam.RIGHT, -90.0))

    def test_every_beam_at_its_own_bearing(self) -> None:
        """Protects left from right and front from back."""
        ranges: dict[Beam, float | None] = {
            Beam.DOWN: H_M,
            Beam.LEFT: 1.1,
            Beam.BACK: 1.2,
            Beam.RIGHT: 1.3,
            Beam.FRONT: 1.4,
        }
        scan = scan_of(extractor().measure(observed(AT_START, OPEN, ranges)))
        assert np.count_nonzero(scan.state == HIT) == 4
        for beam, bearing_deg in self.BEARING_DEG:
            b = bin_at(bearing_deg)
            assert (scan.state[b], scan.ranges_m[b], scan.fresh[b]) == (HIT, pytest.approx(ranges[beam]), True), beam

    def test_at_its_limit_a_beam_sees_free_space(self) -> None:
        """Protects CLEAR: free out to the beam's own limit, in its bin only; beside it nobody looked."""
        ranges: dict[Beam, float | None] = {Beam.DOWN: H_M, Beam.LEFT: BEAM_LIMIT_M, Beam.RIGHT: None}
        scan = scan_of(extractor().measure(observed(AT_START, OPEN, ranges)))
        left = bin_at(90.0)
        assert (scan.state[left], scan.ranges_m[left]) == (CLEAR, BEAM_LIMIT_M)
        assert scan.state[left + 1] == scan.state[left - 1] == UNKNOWN
        assert scan.state[bin_at(-90.0)] == UNKNOWN

    def test_a_beam_that_sees_nothing_does_not_hide_what_the_image_shows(self) -> None:
        """Protects HIT: a thin bar can pass beside a beam."""
        ranges: dict[Beam, float | None] = {Beam.DOWN: H_M, Beam.FRONT: BEAM_LIMIT_M}
        scan = scan_of(extractor().measure(observed(AT_START, [FLOOR, ROOF, wall_ahead(4.0)], ranges)))
        assert scan.state[bin_at(0.0)] == HIT

    def test_a_beam_sees_what_the_image_does_not(self) -> None:
        """Protects HIT from CLEAR: glass, or what is nearer than the camera measures."""
        scan = scan_of(extractor().measure(observed(AT_START, OPEN, {Beam.DOWN: H_M, Beam.FRONT: 0.4})))
        assert scan.state[bin_at(0.0)] == HIT
        assert scan.ranges_m[bin_at(0.0)] == pytest.approx(0.4)

    @pytest.mark.parametrize(("age_s", "there"), [(BEAM_STALE_S, True), (BEAM_STALE_S + 0.01, False)])
    def test_a_stale_beam_is_no_longer_there(self, age_s: float, there: bool) -> None:
        """Protects from a dead rangefinder; without memory nothing else keeps its last word."""
        sensors = SensorSettings(camera=SMALL, scan=ScanSettings(memory_age_s=0.0))
        extract = extractor(sensors)
        extract.measure(observed(AT_START, OPEN, {Beam.DOWN: H_M, Beam.LEFT: 1.0}))
        scan = scan_of(extract.measure(observed(later(AT_START, age_s), OPEN, DOWN)))
        assert (scan.state[bin_at(90.0)] == HIT) == there

    @pytest.mark.parametrize("range_m", [0.0, -1.0, NAN])
    def test_what_cannot_be_a_range_is_no_obstacle_and_no_free_space(self, range_m: float) -> None:
        """Protects all three states from readings that are out of their domain."""
        measured = extractor().measure(observed(AT_START, OPEN, {Beam.DOWN: H_M, Beam.LEFT: range_m, Beam.UP: range_m}))
        assert scan_of(measured).state[bin_at(90.0)] == UNKNOWN
        assert measured.d_m is None
        assert measured.roof_m is None

    def test_the_roof_is_what_the_up_beam_says(self) -> None:
        """Protects the distance to the roof: a roof out of range or not measured is not known."""
        assert extractor().measure(observed(AT_START, OPEN, {Beam.DOWN: H_M, Beam.UP: 1.4})).roof_m == 1.4
        for nothing in (None, BEAM_LIMIT_M):
            assert extractor().measure(observed(AT_START, OPEN, {Beam.DOWN: H_M, Beam.UP: nothing})).roof_m is None

    @pytest.mark.parametrize(
        "delay_s",
        [
            0.0,
            pytest.param(0.01),
        ],
    )
    def test_what_a_beam_saw_is_remembered(self, delay_s: float) -> None:
        """Protects the wall beside the vehicle, as a curve, where only the side beam sees it."""
        extract = extractor()
        for i in range(10):
            pose = later(AT_START, 0.1 * i, x_m=0.1 * i)
            ranges = readings(pose.t_s - delay_s, {Beam.DOWN: H_M, Beam.LEFT: 1.0})
            extract.measure(Observation(pose.t_s, pose, image(OPEN, pose), ranges))
        last = later(pose, SOON_S)
        scan = scan_of(extract.measure(observed(last, OPEN, DOWN)))
        behind = between(100.0, 140.0) & (scan.state == HIT)
        assert np.count_nonzero(behind) >= 5
        # Half a bin off at the range of the last of them, 1.35 m.
        np.testing.assert_allclose(scan.ranges_m[behind] * np.sin(BEARINGS[behind]), 1.0, atol=1.35 * HALF_BIN_RAD)
        assert not scan.fresh[behind].any()

    def test_the_camera_and_the_down_beam_are_enough(self) -> None:
        """Protects the smallest outfit: no beam to the sides, no roof, and still everything else is known."""
        sensors = SensorSettings(camera=SMALL, beams=BeamSettings(directions=(Beam.DOWN,)))
        extract = extractor(sensors)
        measured = extract.measure(observed(AT_START, [FLOOR, ROOF, wall_ahead(3.0)], DOWN))
        assert measured.missing == ()
        assert measured.d_m == pytest.approx(3.0, abs=EXACT_M)
        assert measured.roof_m is None
        assert (scan_of(measured).state[np.abs(BEARINGS) > math.radians(45.0)] == UNKNOWN).all()


class TestMemory:
    """The wall beside the vehicle, from images alone."""

    SENSORS = SensorSettings(camera=SMALL, beams=BeamSettings(directions=(Beam.DOWN,)))

    def fly(self, extract: Extractor) -> Measurement:
        """Along a wall 1 m to the left, 5 m far, at 0.5 m/s."""
        walls = [FLOOR, ROOF, wall_beside(1.0), wall_beside(-3.0)]
        for i in range(51):
            pose = Pose(0.2 * i, 0.1 * i, 0.0, H_M, 0.0, vx_mps=0.5)
            measured = extract.measure(observed(pose, walls, DOWN))
        return measured

    def test_d_is_known_where_the_camera_does_not_look(self) -> None:
        """Protects boundary following without side beams: the nearest wall is at 90°, the camera ends at 43°.

        Points are kept one a cell of 0.1 m, so one is within 0.1 m of where the wall is nearest: 0.5 cm further away.
        They were seen in bins of 1° from some 1.5 m: 1.3 cm off.
        """
        measured = self.fly(extractor(self.SENSORS))
        assert measured.d_m == pytest.approx(1.0, abs=0.02)
        assert measured.d_bearing_rad is not None
        assert measured.d_bearing_rad == pytest.approx(math.pi / 2.0, abs=0.2)  # within 0.2 m along the wall
        # It flies along the wall: what is left of the speed is that of a bearing up to 0.2 rad off.
        assert measured.d_dot_mps == pytest.approx(0.0, abs=0.5 * math.sin(0.2))

    def test_turning_away_keeps_the_wall(self) -> None:
        """Protects the turn on the spot: the same wall, now on the other side of the nose."""
        extract = extractor(self.SENSORS)
        before = self.fly(extract)
        pose = Pose(10.05, 5.0, 0.0, H_M, math.radians(170.0))
        after = extract.measure(observed(pose, None, DOWN))
        assert before.d_bearing_rad is not None
        assert after.d_m == pytest.approx(before.d_m)
        assert after.d_bearing_rad == pytest.approx(before.d_bearing_rad - math.radians(170.0), abs=2.0 * HALF_BIN_RAD)

    def test_without_memory_the_wall_is_not_known(self) -> None:
        """Shows that it is the memory which knows the wall: with memory_age_s = 0 the image's edge is the nearest."""
        sensors = self.SENSORS.model_copy(update={"scan": ScanSettings(memory_age_s=0.0)})
        measured = self.fly(extractor(sensors))
        # The camera, 0.1 m before the middle, sees the wall from 43° on, which is 40.6° from the middle.
        assert measured.d_m == pytest.approx(1.0 / math.sin(math.radians(40.6)), abs=0.05)


def assert_finite(measured: Measurement) -> None:
    """Every float is finite or None, and the scan is one that the law can read."""
    for field in fields(measured):
        value = getattr(measured, field.name)
        if isinstance(value, float) and field.name not in ("scan_age_s", "ranges_age_s", "ahead_m"):
            assert math.isfinite(value), (field.name, value)
    assert measured.ranges_age_s >= 0.0
    assert math.isnan(measured.ahead_m) or measured.ahead_m >= 0.0
    assert math.isfinite(measured.scan_age_s) or Input.DEPTH in measured.missing
    assert not math.isnan(measured.scan_age_s)
    if measured.scan is None:
        assert measured.d_m is None
        assert measured.missing
        return
    scan = measured.scan
    assert np.isfinite(scan.ranges_m).all()
    assert np.isin(scan.state, [UNKNOWN, CLEAR, HIT]).all()
    assert (scan.ranges_m[scan.state == UNKNOWN] == 0.0).all()
    assert (scan.ranges_m[scan.state == HIT] >= 0.0).all()
    hits = scan.ranges_m[scan.state == HIT]
    assert measured.d_m == (pytest.approx(hits.min()) if hits.size else None)


WALL_IMAGE = image([FLOOR, ROOF, wall_ahead(3.0)])
ODD = [NAN, INF, -INF, 0.0, -1.0, 1e300, -1e300, 1e-300]
any_float = st.one_of(st.floats(-20.0, 20.0), st.sampled_from(ODD))
any_range = st.one_of(st.none(), st.floats(0.0, 12.0), st.sampled_from(ODD))


@st.composite
def poses(draw: st.DrawFn, t_s: float) -> Pose:
    """A sensible pose, in which up to two numbers are anything at all."""
    x_m, y_m, z_m, yaw_rad, vx_mps = (draw(st.floats(-3.0, 3.0)) for _ in range(5))
    usual = Pose(t_s, x_m, y_m, z_m, yaw_rad, vx_mps=vx_mps)
    names = draw(st.lists(st.sampled_from([f.name for f in fields(Pose)]), max_size=2))
    return replace(usual, **{name: draw(any_float) for name in names})


@st.composite
def observations(draw: st.DrawFn) -> list[Observation]:
    """Three ticks, each with whatever the sensors may say."""
    ticks = []
    for i in range(3):
        t_s = 0.05 * i
        pose = draw(poses(t_s))
        beams = draw(st.dictionaries(st.sampled_from(list(Beam)), any_range))
        seen, turn = None, None
        if draw(st.booleans()):
            depth_m = WALL_IMAGE.depth_m.copy()
            rows, value = draw(st.slices(CAMERA.height_px)), draw(any_float)
            with np.errstate(over="ignore"):
                depth_m[rows] = np.float32(value)
            seen = DepthFrame(t_s, depth_m, CAMERA, draw(poses(t_s)))
        if draw(st.booleans()):
            ranges = draw(st.lists(any_range.map(lambda r: NAN if r is None else r), max_size=20))
            turn = PlanarScan(
                t_s, bin_bearings(max(len(ranges), 1))[: len(ranges)], np.array(ranges), 10.0, draw(poses(t_s))
            )
        # The height is there more often than not: without it no image is looked at.
        ticks.append(Observation(t_s, pose, seen, readings(t_s, {**DOWN, **beams}), turn))
    return ticks


@given(observations())
@settings(deadline=None, max_examples=80)
def test_whatever_comes_in_only_numbers_come_out(ticks: list[Observation]) -> None:
    """Protects everything behind: no NaN, no infinity, no invalid state reaches the law; a broken pose is told."""
    extract = extractor()
    for observation in ticks:
        measured = extract.measure(observation)
        assert_finite(measured)
        pose = observation.pose
        numbers = (pose.x_m, pose.y_m, pose.z_m, pose.yaw_rad, pose.roll_rad, pose.pitch_rad, pose.vx_mps, pose.vy_mps)
        if not all(map(math.isfinite, numbers)) or pose.t_s > observation.t_s:
            assert Input.POSE in measured.missing
