"""From what the sensors measured to h, N, d, d_f, the rate of d, and what is missing."""

from __future__ import annotations

import math
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import ArrayLike

from companion.config.sensors import ScanSettings, SensorSettings
from companion.model import FRONT_RAD, HIT, Beam, Input, Measurement, Observation
from companion.perception.dark import DARK_S
from companion.perception.extract import POSE_STALE_S
from companion.perception.look import bin_bearings
from tests.perception.observations import (
    BEAM_LIMIT_M,
    BEAM_STALE_S,
    BEARINGS,
    CAMERA,
    DEPTH_STALE_S,
    DOWN,
    EXACT_M,
    HALF_BIN_RAD,
    INF,
    NAN,
    OPEN,
    SMALL,
    SOON_S,
    assert_finite,
    bin_at,
    extractor,
    image,
    later,
    observed,
    planar,
    readings,
    scan_of,
)
from tests.perception.scenes import AT_START, FLOOR, H_M, ROOF, Surface, wall_ahead


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

    def test_an_image_without_depth_is_no_look(self) -> None:
        """Protects from flying on in the dark: frames come in time, and hold nothing but a few stray pixels."""
        extract = extractor()
        extract.measure(observed(AT_START, OPEN, DOWN))
        now = later(AT_START, DEPTH_STALE_S + 0.01)
        dark = observed(now, OPEN, DOWN)
        assert dark.frame is not None
        dark.frame.depth_m[:] = NAN
        dark.frame.depth_m[::10, ::10] = 3.0
        measured = extract.measure(dark)
        assert measured.missing == (Input.DEPTH,)
        assert measured.scan_age_s == pytest.approx(DEPTH_STALE_S + 0.01)
        assert extract.measure(observed(now, OPEN, DOWN)).missing == ()

    def test_a_wall_without_echo_is_remembered_when_its_foot_is_out_of_view(self) -> None:
        """Protects from flying beside wet coal into it: from 1.5 m the camera sees no floor before it."""
        extract = extractor()
        for x_m in (0.0, 2.5):
            pose = later(AT_START, 0.1 + x_m, x_m=x_m)
            seen = observed(pose, [FLOOR, ROOF, wall_ahead(4.0)], DOWN)
            assert seen.frame is not None
            seen.frame.depth_m[np.isclose(seen.frame.depth_m, 3.9 - x_m, atol=EXACT_M)] = NAN
            # Nearer, something else is in view: it is a look, and says nothing of what is ahead.
            seen.frame.depth_m[:, :3] = 2.0
            measured = extract.measure(seen)
        # The last row of the floor that is seen lies up to 0.45 m before the wall.
        assert measured.ahead_m == pytest.approx(1.5, abs=0.45)

    @pytest.mark.parametrize(("turned_deg", "dark_s", "missing"), [
        (0.0, 0.6, ()),
        (20.0, 0.6, ()),
        (60.0, 0.6, (Input.DEPTH,)),
        (0.0, DARK_S + 0.1, (Input.DEPTH,)),
    ])  # fmt: skip
    def test_a_dark_wall_that_fills_the_picture_is_what_was_to_be_expected(
        self, turned_deg: float, dark_s: float, missing: tuple[Input, ...]
    ) -> None:
        """Protects a flight into a dark dead end from ending there: it was seen coming, and may be turned away from.

        For as long as that takes, and only where the wall is: beside it an image without depth is a failed lamp.
        """
        extract = extractor()
        for step in range(21):
            came = later(AT_START, 0.1 * step, x_m=0.1 * step)
            seen = observed(came, [FLOOR, ROOF, wall_ahead(4.0)], DOWN)
            assert seen.frame is not None
            seen.frame.depth_m[np.isclose(seen.frame.depth_m, 3.9 - came.x_m, atol=EXACT_M)] = NAN
            extract.measure(seen)
        turned = later(came, dark_s, yaw_rad=math.radians(turned_deg))
        dark = observed(turned, OPEN, DOWN)
        assert dark.frame is not None
        dark.frame.depth_m[:] = NAN
        measured = extract.measure(dark)
        assert measured.missing == missing
        if not missing:
            scan = scan_of(measured)
            assert measured.scan_age_s == 0.0
            assert measured.d_m == pytest.approx(2.0, abs=0.5), "it is kept from by what is remembered"
            assert not scan.fresh[scan.state == HIT].any(), "nothing of it was seen just now"

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
        assert Input.POSE in extract.measure(Observation(pose.t_s, pose, None, readings(pose.t_s, DOWN))).missing

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
