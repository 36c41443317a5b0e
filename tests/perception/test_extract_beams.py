"""Beams and memory in the measurement, and whatever else may come in."""

from __future__ import annotations

import math
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.config.sensors import BeamSettings, ScanSettings, SensorSettings
from companion.model import CLEAR, HIT, UNKNOWN, Beam, DepthFrame, Input, Measurement, Observation, PlanarScan, Pose
from companion.perception import Extractor
from companion.perception.look import bin_bearings
from tests.perception.observations import (
    BEAM_LIMIT_M,
    BEAM_STALE_S,
    BEARINGS,
    CAMERA,
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
    readings,
    scan_of,
)
from tests.perception.scenes import AT_START, FLOOR, H_M, ROOF, between, wall_ahead, wall_beside


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

    @pytest.mark.parametrize("delay_s", [0.0, 0.01])
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

    @pytest.mark.parametrize(("before_m", "kept"), [(None, False), (3.0, False), (1.2, True)])
    def test_a_reading_that_no_other_agrees_with_is_not_kept(self, before_m: float | None, kept: bool) -> None:
        """Protects flights through dust: one short reading in thirty would stand beside the vehicle for a minute."""
        extract = extractor()
        extract.measure(observed(AT_START, OPEN, DOWN | {Beam.LEFT: before_m}))
        extract.measure(observed(later(AT_START, 0.1), OPEN, DOWN | {Beam.LEFT: 1.1}))
        turned = later(AT_START, 5.0, yaw_rad=math.radians(-20.0))
        scan = scan_of(extract.measure(observed(turned, OPEN, DOWN)))
        assert (scan.state[bin_at(110.0) - 2 : bin_at(110.0) + 3] == HIT).any() == kept


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
