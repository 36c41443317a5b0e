"""Faulty sensors: their data may look like readings, and must not keep the vehicle flying.

Each flight goes from the sink to the measurement, as on the vehicle, and is flown twice: with healthy sensors, when
everything is known all the time, and with the fault, when what relies on that sensor must be missing soon.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest

from companion.config.sensors import BeamSettings, CameraSettings, PlanarSettings, SensorSettings
from companion.config.vehicle import VehicleSettings
from companion.model import Beam, FloatArray, Input, Measurement, Observation, Pose, RangeReading
from companion.perception import Extractor
from companion.pose_buffer import PoseBuffer
from companion.sensors import sink as words
from companion.sensors.sink import DEPTH, PLANAR, RawDepth, RawPlanar, SensorSink
from companion.sensors.stuck import MOVED_M
from companion.sensors.synchronizer import Synchronizer
from tests.perception.scenes import FLOOR, H_M, ROOF, render, wall_ahead, wall_beside
from tests.shared.clocks import HandClock

SMALL = CameraSettings(width_px=64, height_px=48)
CAMERA = SMALL.model()
SETTINGS = SensorSettings(
    camera=SMALL,
    beams=BeamSettings(directions=(Beam.FRONT, Beam.LEFT, Beam.RIGHT, Beam.DOWN)),
    planar=PlanarSettings(enabled=True),
)
LIMIT_M = SETTINGS.beams.max_range_m
STALE_S, BEAM_STALE_S = SETTINGS.scan.stale_after_s, SETTINGS.beams.stale_after_s
WALLS = [FLOOR, ROOF, wall_ahead(30.0), wall_beside(2.0), wall_beside(-2.0)]
PERIOD_S, FRAME_EVERY, RANGES_EVERY = 0.05, 4, 2
START_S, FAULT_AT_S = 100.0, 101.0
NAN, INF = math.nan, math.inf

Way = Callable[[float], Pose]
"""Where the vehicle is at a time."""


def standing(t_s: float) -> Pose:
    return Pose(t_s, 0.0, 0.0, H_M, 0.0)


def forward(t_s: float) -> Pose:
    return Pose(t_s, 0.4 * (t_s - START_S), 0.0, H_M, 0.0, vx_mps=0.4)


def turning(t_s: float) -> Pose:
    return Pose(t_s, 0.0, 0.0, H_M, 0.3 * (t_s - START_S), yaw_rate_radps=0.3)


def climbing(t_s: float) -> Pose:
    return Pose(t_s, 0.0, 0.0, H_M + 0.2 * (t_s - START_S), 0.0, vz_mps=0.2)


def sideways(t_s: float) -> Pose:
    return Pose(t_s, 0.0, 0.25 * (t_s - START_S), H_M, 0.0, vy_mps=0.25)


@dataclass
class Faults:
    """What each sensor delivers in place of its reading, from `FAULT_AT_S` on; None: nothing."""

    depth: Callable[[RawDepth], RawDepth | None] = lambda raw: raw
    beam: Callable[[RangeReading], RangeReading | None] = lambda reading: reading
    planar: Callable[[RawPlanar], RawPlanar | None] = lambda raw: raw


class Flight:
    """A drift without end, seen without noise."""

    def __init__(self, way: Way, faults: Faults | None = None, *, camera: bool = True, scanner: bool = False) -> None:
        self._way, self._faults = way, faults or Faults()
        self._camera, self._scanner = camera, scanner
        self.clock = HandClock(START_S)
        self.sink = SensorSink(self.clock)
        self._poses = PoseBuffer()
        self._inputs = Synchronizer(self.sink, self._poses)
        self._extractor = Extractor(SETTINGS, VehicleSettings(), 1.5)
        self._tick = 0

    def until(self, end_s: float) -> list[Measurement]:
        """Fly on; what is measured in each tick."""
        measured = []
        while (now_s := START_S + self._tick * PERIOD_S) < end_s - 1e-9:
            self.clock.time_s = now_s
            self._sense(self._way(now_s), now_s)
            self._tick += 1
            observation = self._inputs.observe(now_s)
            assert observation is not None
            measured.append(self._extractor.measure(observation))
        return measured

    def reasons(self, stream: str) -> set[str]:
        return set(self.sink.statistics(self.clock.time_s)[stream].reasons)

    def _sense(self, pose: Pose, now_s: float) -> None:
        self._poses.add_attitude(now_s, 0.0, 0.0, pose.yaw_rad, pose.yaw_rate_radps)
        self._poses.add_position(now_s, pose.x_m, pose.y_m, pose.z_m, pose.vx_mps, pose.vy_mps, pose.vz_mps)
        faults = self._faults if now_s >= FAULT_AT_S - 1e-9 else Faults()
        if self._camera and self._tick % FRAME_EVERY == 0:
            image = faults.depth(RawDepth(now_s, render(WALLS, CAMERA, pose), CAMERA))
            if image is not None:
                self.sink.depth(image)
        if self._scanner and self._tick % FRAME_EVERY == 0:
            scan = faults.planar(scanned(pose))
            if scan is not None:
                self.sink.planar(scan)
        if self._tick % RANGES_EVERY == 0:
            self.sink.ranges([reading for reading in map(faults.beam, beams(pose)) if reading is not None])


def beams(pose: Pose) -> list[RangeReading]:
    """What the beams measure in the drift, for a heading of 0."""
    ranges_m = {Beam.FRONT: 30.0 - pose.x_m, Beam.LEFT: 2.0 - pose.y_m, Beam.RIGHT: 2.0 + pose.y_m, Beam.DOWN: pose.z_m}
    return [RangeReading(beam, pose.t_s, min(range_m, LIMIT_M), LIMIT_M) for beam, range_m in ranges_m.items()]


def scanned(pose: Pose) -> RawPlanar:
    """A turn of the scanner, in the middle of the drift and with a step in its walls every metre."""
    bearings_rad = np.asarray(-math.pi + (np.arange(72) + 0.5) * math.pi / 36.0, np.float64)
    ranges_m: FloatArray = 2.0 / np.abs(np.sin(bearings_rad + pose.yaw_rad))
    along_m = pose.x_m + ranges_m * np.cos(bearings_rad + pose.yaw_rad)
    return RawPlanar(pose.t_s, bearings_rad, np.minimum(ranges_m + 0.1 * (along_m % 1.0 > 0.5), 10.0), 10.0)


class Repeat:
    """Repeats the first images for ever, with the newest stamps."""

    def __init__(self, different: int = 1) -> None:
        self._first: list[RawDepth] = []
        self._different = different
        self._count = 0

    def __call__(self, raw: RawDepth) -> RawDepth:
        self._count += 1
        if len(self._first) < self._different:
            self._first.append(raw)
            return raw
        # A copy: what comes over a wire is never the same array.
        return replace(raw, depth_m=self._first[self._count % self._different].depth_m.copy())


def filled(*values: float) -> Callable[[RawDepth], RawDepth]:
    """Images with these depths in turn and nothing else."""
    return lambda raw: replace(raw, depth_m=np.resize(np.array(values, np.float32), raw.depth_m.shape))


def stamped(shift_s: float) -> Callable[[RawDepth], RawDepth]:
    return lambda raw: replace(raw, t_s=raw.t_s + shift_s)


DEPTH_FAULTS: dict[str, tuple[Callable[[], Callable[[RawDepth], RawDepth | None]], str | None]] = {
    "silence": (lambda: lambda _: None, None),
    "nothing measured": (lambda: filled(NAN), words.NO_SURFACE),
    "all free": (lambda: filled(INF), words.NO_SURFACE),
    "all at the limit": (lambda: filled(CAMERA.max_range_m), words.NO_SURFACE),
    "all far beyond the limit": (lambda: filled(65.535), words.NO_SURFACE),
    "free or not measured": (lambda: filled(NAN, INF, 10.0), words.NO_SURFACE),
    "covered lens": (lambda: filled(0.1), words.NO_SURFACE),
    "zeros": (lambda: filled(0.0), words.NOT_POSITIVE),
    "a frozen image": (lambda: Repeat(), words.FROZEN),
    "four images in turn": (lambda: Repeat(4), words.FROZEN),
    "stamps that go back": (lambda: stamped(-50.0), words.NOT_NEWER),
    "stamps from the future": (lambda: stamped(0.5), words.FROM_THE_FUTURE),
    "stamps that stand": (lambda: lambda raw: replace(raw, t_s=FAULT_AT_S), words.NOT_NEWER),
    "stamps that are no number": (lambda: stamped(NAN), words.NOT_A_TIME),
    "images that come too late": (lambda: lambda raw: replace(raw, t_s=raw.t_s - 0.6), words.NOT_NEWER),
}
SEEN_THROUGH_S = {"four images in turn": 4 * FRAME_EVERY * PERIOD_S, "a frozen image": FRAME_EVERY * PERIOD_S}
"""For this long the images are still new ones: those that it then repeats."""


@pytest.mark.parametrize("way", [forward, turning], ids=lambda way: way.__name__)
@pytest.mark.parametrize("fault", DEPTH_FAULTS)
def test_a_faulty_camera_counts_as_a_missing_one(fault: str, way: Way) -> None:
    """Protects from flying on: the look ages as if nothing had come, and the safety gate is sent that age."""
    make, reason = DEPTH_FAULTS[fault]
    healthy, faulty = Flight(way), Flight(way, Faults(depth=make()))
    before = faulty.until(FAULT_AT_S)
    assert before[-1].missing == ()
    stale_s = FAULT_AT_S + SEEN_THROUGH_S.get(fault, 0.0) + STALE_S
    faulty.until(stale_s + PERIOD_S)
    ages_s = []
    for measured in faulty.until(stale_s + 2.0):
        assert measured.missing == (Input.DEPTH,)
        assert math.isnan(measured.ahead_m)
        ages_s.append(measured.scan_age_s)
    assert min(ages_s) > STALE_S
    assert reason is None or faulty.reasons(DEPTH) == {reason}
    assert all(measured.missing == () for measured in healthy.until(stale_s + 2.0)[1:])


def test_a_camera_that_repeats_itself_while_the_vehicle_stands_is_believed() -> None:
    """Simulated sensors without noise do: a vehicle that stands must be able to take off."""
    flight = Flight(standing)
    assert all(measured.missing == () for measured in flight.until(START_S + 20.0)[1:])
    assert flight.reasons(DEPTH) == set()


def test_an_estimate_that_drifts_on_the_ground_makes_no_frozen_camera() -> None:
    """0.4 m and 10° in two minutes, as an estimator may on the ground: before take-off nothing is wrong with it."""
    flight = Flight(
        lambda t_s: replace(standing(t_s), x_m=0.003 * (t_s - START_S), yaw_rad=0.0014 * (t_s - START_S)),
        Faults(depth=Repeat()),
    )
    assert all(measured.missing == () for measured in flight.until(START_S + 120.0)[1:])


def test_images_without_any_depth_are_not_frozen_ones() -> None:
    """A lens before black rock shows nothing wherever it turns: that is told by what is missing, not as a fault."""
    flight = Flight(turning, Faults(depth=lambda raw: replace(raw, depth_m=np.full_like(raw.depth_m, NAN))))
    measured = flight.until(FAULT_AT_S + 3.0)
    assert measured[-1].missing == (Input.DEPTH,)
    assert words.FROZEN not in flight.reasons(DEPTH)


def test_a_frozen_camera_is_not_believed_again_because_the_vehicle_stops_for_it() -> None:
    """Without this it would fly on a stretch after each stop, blind; when the image changes it flies again."""
    stop_s = FAULT_AT_S + 1.0
    repeat = Repeat()
    flight = Flight(
        lambda t_s: forward(t_s) if t_s < stop_s else replace(forward(stop_s), t_s=t_s, vx_mps=0.0),
        Faults(depth=lambda raw: repeat(raw) if raw.t_s < stop_s + 15.0 else raw),
    )
    flight.until(stop_s)
    assert all(measured.missing == (Input.DEPTH,) for measured in flight.until(stop_s + 15.0))
    assert flight.until(stop_s + 15.0 + 2 * FRAME_EVERY * PERIOD_S)[-1].missing == ()


def test_a_frozen_camera_is_not_believed_where_its_image_was_taken_either() -> None:
    """A pilot flies the vehicle back to there: an image that was wrong elsewhere proves nothing here."""
    repeat = Repeat()
    flight = Flight(
        lambda t_s: replace(forward(min(t_s, 2.0 * FAULT_AT_S + 2.0 - t_s)), t_s=t_s),
        Faults(depth=lambda raw: repeat(raw)),
    )
    flight.until(FAULT_AT_S + 1.0)
    assert all(measured.missing == (Input.DEPTH,) for measured in flight.until(FAULT_AT_S + 3.0))


def test_the_same_image_twice_within_3_cm_is_a_slow_driver() -> None:
    """A driver that is asked faster than its camera gives images repeats them; within 3 cm nobody has flown blind."""
    last: list[RawDepth] = []

    def every_second(raw: RawDepth) -> RawDepth:
        last.append(raw if len(last) % 2 == 0 else replace(raw, depth_m=last[-1].depth_m))
        return last[-1]

    slow_mps = 0.6 * MOVED_M / (FRAME_EVERY * PERIOD_S)
    flight = Flight(
        lambda t_s: replace(standing(t_s), x_m=slow_mps * (t_s - START_S), vx_mps=slow_mps), Faults(depth=every_second)
    )
    assert all(measured.missing == () for measured in flight.until(START_S + 5.0)[1:])


PLANAR_FAULTS: dict[str, Callable[[RawPlanar], RawPlanar | None]] = {
    "nothing measured": lambda raw: replace(raw, ranges_m=raw.ranges_m * NAN),
    "all at the limit": lambda raw: replace(raw, ranges_m=np.full_like(raw.ranges_m, 10.0)),
    "zeros": lambda raw: replace(raw, ranges_m=np.zeros_like(raw.ranges_m)),
    "frozen": lambda raw: replace(raw, ranges_m=scanned(forward(FAULT_AT_S)).ranges_m),
}


@pytest.mark.parametrize("fault", PLANAR_FAULTS)
def test_a_faulty_scanner_counts_as_a_missing_one(fault: str) -> None:
    """The same for a planar scanner, which is all that looks ahead here."""
    faulty = Flight(forward, Faults(planar=PLANAR_FAULTS[fault]), camera=False, scanner=True)
    assert faulty.until(FAULT_AT_S)[-1].missing == ()
    faulty.until(FAULT_AT_S + FRAME_EVERY * PERIOD_S + STALE_S + PERIOD_S)
    assert all(measured.missing == (Input.DEPTH,) for measured in faulty.until(FAULT_AT_S + 3.0))
    assert faulty.reasons(PLANAR) == {words.FROZEN if fault == "frozen" else words.NO_SURFACE}
    healthy = Flight(forward, camera=False, scanner=True)
    assert all(measured.missing == () for measured in healthy.until(FAULT_AT_S + 3.0)[1:])


def reads(beam: Beam, range_m: float | None) -> Faults:
    """One beam always reads the same."""
    return Faults(beam=lambda reading: replace(reading, range_m=range_m) if reading.beam is beam else reading)


def shifts(beam: Beam, shift_s: float) -> Faults:
    return Faults(beam=lambda r: replace(r, t_s=r.t_s + shift_s) if r.beam is beam else r)


DOWN_FAULTS = {
    "silence": Faults(beam=lambda reading: None if reading.beam is Beam.DOWN else reading),
    "nothing measured": reads(Beam.DOWN, None),
    "no number": reads(Beam.DOWN, NAN),
    "zeros": reads(Beam.DOWN, 0.0),
    "at the limit": reads(Beam.DOWN, LIMIT_M),
    "infinite": reads(Beam.DOWN, INF),
    "below zero": reads(Beam.DOWN, -1.0),
    "stamps that go back": shifts(Beam.DOWN, -50.0),
    "stamps from the future": shifts(Beam.DOWN, 0.5),
}


@pytest.mark.parametrize("fault", DOWN_FAULTS)
def test_a_faulty_downward_beam_leaves_no_height(fault: str) -> None:
    """Protects from a height that is no height: the vehicle stops, and the age that the gate is sent grows.

    But for a beam that sees as far as it can: it works, and there may be a shaft below. The vehicle goes back then.
    """
    faulty = Flight(forward, DOWN_FAULTS[fault])
    assert faulty.until(FAULT_AT_S)[-1].missing == ()
    faulty.until(FAULT_AT_S + BEAM_STALE_S + 2 * PERIOD_S)
    found = faulty.until(FAULT_AT_S + 2.0)
    assert all(measured.h_m is None and Input.HEIGHT in measured.missing for measured in found)
    works = fault in ("at the limit", "infinite")
    assert all((measured.ranges_age_s <= BEAM_STALE_S) is works for measured in found)


@pytest.mark.parametrize(
    ("beam", "way"), [(Beam.DOWN, climbing), (Beam.LEFT, sideways), (Beam.RIGHT, sideways), (Beam.FRONT, forward)]
)
def test_a_frozen_beam_does_not_count(beam: Beam, way: Way) -> None:
    """Repeated to the last bit for more than 1 s and 0.3 m along the beam: it ages from there on."""
    faulty = Flight(way, reads(beam, 1.7))
    # 0.3 m at 0.2 m/s take 1.5 s; up to then it is believed.
    assert faulty.until(FAULT_AT_S + 1.0)[-1].ranges_age_s <= 2 * PERIOD_S
    faulty.until(FAULT_AT_S + 1.5 + BEAM_STALE_S + 3 * PERIOD_S)
    found = faulty.until(FAULT_AT_S + 2.5)
    assert all(measured.ranges_age_s > BEAM_STALE_S for measured in found)
    assert all((measured.h_m is None) == (beam is Beam.DOWN) for measured in found)
    assert faulty.reasons(beam.value) == {words.FROZEN}


@pytest.mark.parametrize(
    ("beam", "range_m", "way"),
    [
        pytest.param(Beam.LEFT, 2.0, forward, id="along a wall"),
        pytest.param(Beam.DOWN, 1.5, forward, id="at one height"),
        pytest.param(Beam.FRONT, LIMIT_M, forward, id="free out to the limit"),
        pytest.param(Beam.FRONT, 3.0, standing, id="a vehicle that stands"),
        pytest.param(
            Beam.DOWN,
            0.12,
            lambda t_s: replace(standing(t_s), z_m=H_M + 0.01 * (t_s - START_S)),
            id="a height that drifts",
        ),
    ],
)
def test_a_beam_that_rightly_repeats_itself_counts(beam: Beam, range_m: float, way: Way) -> None:
    """Rangefinders in centimetres repeat themselves: only movement along the beam shows that one is frozen."""
    flight = Flight(way, reads(beam, range_m))
    assert all(measured.ranges_age_s <= 2 * PERIOD_S for measured in flight.until(START_S + 60.0)[1:])
    assert flight.reasons(beam.value) == set()


def test_a_frozen_beam_counts_again_when_it_changes() -> None:
    """A driver that hung and recovered is a driver that works."""
    heal_s = FAULT_AT_S + 4.0
    flight = Flight(
        climbing, Faults(beam=lambda r: replace(r, range_m=1.7) if r.beam is Beam.DOWN and r.t_s < heal_s else r)
    )
    assert flight.until(heal_s)[-1].h_m is None
    assert flight.until(heal_s + 3 * PERIOD_S)[-1].missing == ()


def test_a_frozen_beam_with_gaps_does_not_count_either() -> None:
    """One missing reading is no sign of life of a beam that is frozen otherwise."""

    def gaps(reading: RangeReading) -> RangeReading:
        has_gap = round((reading.t_s - START_S) / PERIOD_S) % 6 == 0
        return replace(reading, range_m=None if has_gap else 1.7) if reading.beam is Beam.LEFT else reading

    flight = Flight(sideways, Faults(beam=gaps))
    flight.until(FAULT_AT_S + 1.5 + BEAM_STALE_S + 3 * PERIOD_S)
    assert all(measured.ranges_age_s > BEAM_STALE_S for measured in flight.until(FAULT_AT_S + 3.0))


def test_the_age_is_that_of_the_oldest_beam_that_counts() -> None:
    """Protects what the gate is sent: one silent beam among four is a silent beam."""
    faults = Faults(beam=lambda reading: None if reading.beam is Beam.RIGHT else reading)
    flight = Flight(forward, faults)
    assert flight.until(FAULT_AT_S)[-1].ranges_age_s <= 2 * PERIOD_S
    silent = flight.until(FAULT_AT_S + 1.0)[-1]
    assert silent.ranges_age_s == pytest.approx(1.0, abs=2 * PERIOD_S)
    assert silent.missing == ()


def test_a_beam_without_any_reading_makes_the_age_infinite() -> None:
    """Before the first reading of each the beams must not count as working; upward none is needed."""
    sensors = SETTINGS.model_copy(update={"beams": BeamSettings(directions=(Beam.DOWN, Beam.LEFT, Beam.UP))})
    extract = Extractor(sensors, VehicleSettings(), 1.5)
    pose = standing(0.0)
    down, left = (RangeReading(beam, 0.0, 1.5, LIMIT_M) for beam in (Beam.DOWN, Beam.LEFT))
    assert extract.measure(Observation(0.0, pose)).ranges_age_s == INF
    assert extract.measure(Observation(0.0, pose, None, (down,))).ranges_age_s == INF
    assert extract.measure(Observation(0.0, pose, None, (left,))).ranges_age_s == 0.0
    # A stamp from the future says nothing of the age, and the gate takes no beat with one below zero.
    ahead = replace(left, t_s=0.05)
    assert extract.measure(Observation(0.01, standing(0.01), None, (ahead,))).ranges_age_s == INF
    assert extract.measure(Observation(0.06, standing(0.06))).ranges_age_s == pytest.approx(0.06)


@pytest.mark.parametrize("range_m", [None, 0.0, LIMIT_M])
def test_a_side_beam_that_sees_nothing_is_not_silent(range_m: float | None) -> None:
    """Protects flight past a junction: a beam that looks down a drift measures nothing, and works."""
    flight = Flight(forward, reads(Beam.LEFT, range_m))
    assert all(measured.ranges_age_s <= 2 * PERIOD_S for measured in flight.until(FAULT_AT_S + 2.0)[1:])
