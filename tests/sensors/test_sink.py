"""The sink: the newest of each stream, and nothing that cannot be right."""

from __future__ import annotations

import math
import threading
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.model import Beam, Camera, RangeReading
from companion.sensors import sink as words
from companion.sensors.sink import DEPTH, PLANAR, STREAMS, RawDepth, RawPlanar, SensorSink
from tests.shared.clocks import HandClock

NOW_S = 100.0
CAMERA = Camera(4, 3, 2.0, 2.0, 1.5, 1.0, 0.25, 10.0)
DEPTH_M = np.full((3, 4), 2.0, np.float32)
BEARINGS = np.array([-1.0, 0.0, 1.0])


def frame(t_s: Any = NOW_S, **changed: Any) -> RawDepth:
    return replace(RawDepth(t_s, DEPTH_M, CAMERA), **changed)


def reading(t_s: float = NOW_S, beam: Beam = Beam.FRONT, **changed: Any) -> RangeReading:
    return replace(RangeReading(beam, t_s, 2.0, 8.0), **changed)


def scan(t_s: float = NOW_S, **changed: Any) -> RawPlanar:
    return replace(RawPlanar(t_s, BEARINGS, np.array([1.0, 2.0, 3.0]), 10.0), **changed)


@pytest.fixture
def clock() -> HandClock:
    return HandClock(NOW_S)


@pytest.fixture
def sink(clock: HandClock) -> SensorSink:
    return SensorSink(clock)


def test_the_newest_of_each_stream_is_handed_out_once(sink: SensorSink) -> None:
    """A slow tick acts on the newest only; a fast one never acts twice on the same reading."""
    for t_s in (99.0, 99.5, 99.9):
        sink.depth(frame(t_s))
        sink.ranges([reading(t_s), reading(t_s - 0.5, Beam.DOWN)])
        sink.planar(scan(t_s))
    taken = sink.take()
    assert taken.depth is not None
    assert taken.planar is not None
    assert (taken.depth.t_s, taken.planar.t_s) == (99.9, 99.9)
    assert {r.beam: r.t_s for r in taken.ranges} == {Beam.FRONT: 99.9, Beam.DOWN: 99.4}
    assert sink.take() == words.Taken(None, (), None)


def test_a_depth_image_is_not_copied(sink: SensorSink) -> None:
    """A copy of each image would cost the loop a millisecond for nothing."""
    sink.depth(frame())
    taken = sink.take().depth
    assert taken is not None
    assert taken.depth_m is DEPTH_M


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        pytest.param(frame(NOW_S + 0.11), words.FROM_THE_FUTURE, id="future"),
        pytest.param(frame(math.nan), words.NOT_A_TIME, id="NaN stamp"),
        pytest.param(frame(t_s="now"), words.NOT_A_TIME, id="text for a stamp"),
        pytest.param(frame(t_s=np.float32(99.0)), words.NOT_A_TIME, id="stamp too coarse"),
        pytest.param(frame(depth_m=DEPTH_M.T), words.WRONG_SHAPE, id="transposed"),
        pytest.param(frame(depth_m=[[1.0] * 4] * 3), words.WRONG_SHAPE, id="a list"),
        pytest.param(frame(depth_m=DEPTH_M.astype(np.uint16)), words.WRONG_TYPE, id="millimetres"),
        pytest.param(frame(depth_m=DEPTH_M.astype(np.float64)), words.WRONG_TYPE, id="float64"),
        pytest.param(frame(depth_m=DEPTH_M * 0), words.NOT_POSITIVE, id="zero for missing"),
        pytest.param(frame(depth_m=-DEPTH_M), words.NOT_POSITIVE, id="behind the camera"),
        pytest.param(frame(depth_m=DEPTH_M * np.nan), words.NO_SURFACE, id="nothing measured"),
        pytest.param(frame(depth_m=DEPTH_M * np.inf), words.NO_SURFACE, id="all free"),
        pytest.param(frame(depth_m=DEPTH_M * 5.0), words.NO_SURFACE, id="all at the limit"),
        pytest.param(frame(depth_m=DEPTH_M * 0.1), words.NO_SURFACE, id="all too near: a covered lens"),
        pytest.param(
            frame(depth_m=np.array([[np.nan, np.inf, 10.0, 0.1]] * 3, np.float32)), words.NO_SURFACE, id="a mixture"
        ),
        pytest.param(frame(camera=replace(CAMERA, fx_px=0.0)), words.WRONG_CAMERA, id="no focal length"),
        pytest.param(frame(camera=replace(CAMERA, cx_px=math.nan)), words.WRONG_CAMERA, id="NaN in the camera"),
        pytest.param(frame(camera=replace(CAMERA, max_range_m=0.2)), words.WRONG_CAMERA, id="limits swapped"),
    ],
)
def test_an_impossible_depth_image_is_refused_and_counted(sink: SensorSink, bad: RawDepth, reason: str) -> None:
    """Nothing that a camera process sends may reach the navigator as a look ahead unless it can be one."""
    sink.depth(bad)
    assert sink.take().depth is None
    statistics = sink.statistics(NOW_S)[DEPTH]
    assert (statistics.count, statistics.dropped, dict(statistics.reasons)) == (0, 1, {reason: 1})
    assert statistics.age_s == math.inf


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        pytest.param(reading(NOW_S + 0.11), words.FROM_THE_FUTURE, id="future"),
        pytest.param(reading(math.inf), words.NOT_A_TIME, id="infinite stamp"),
        pytest.param(reading(range_m="far"), words.WRONG_TYPE, id="text"),
        pytest.param(reading(range_m=True), words.WRONG_TYPE, id="a truth value"),
        pytest.param(reading(range_m=-0.1), words.NOT_POSITIVE, id="negative"),
        pytest.param(reading(range_m=-math.inf), words.NOT_POSITIVE, id="too near, as some drivers say it"),
        pytest.param(reading(max_range_m=0.0), words.WRONG_LIMIT, id="no limit"),
        pytest.param(reading(max_range_m=math.inf), words.WRONG_LIMIT, id="infinite limit: free out to nowhere"),
        pytest.param(reading(max_range_m=math.nan), words.WRONG_LIMIT, id="NaN limit"),
    ],
)
def test_an_impossible_range_is_refused_and_counted(sink: SensorSink, bad: RangeReading, reason: str) -> None:
    """One bad reading of a beam does not take the good ones beside it with it."""
    sink.ranges([bad, reading(beam=Beam.DOWN)])
    assert [r.beam for r in sink.take().ranges] == [Beam.DOWN]
    assert dict(sink.statistics(NOW_S)["front"].reasons) == {reason: 1}
    assert sink.statistics(NOW_S)["down"].count == 1


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        pytest.param(scan(NOW_S + 0.11), words.FROM_THE_FUTURE, id="future"),
        pytest.param(scan(math.nan), words.NOT_A_TIME, id="NaN stamp"),
        pytest.param(scan(ranges_m=np.ones(2)), words.WRONG_SHAPE, id="lengths differ"),
        pytest.param(scan(bearings_rad=np.empty(0), ranges_m=np.empty(0)), words.WRONG_SHAPE, id="empty"),
        pytest.param(scan(ranges_m=np.ones((3, 1))), words.WRONG_SHAPE, id="two-dimensional"),
        pytest.param(scan(ranges_m=np.ones(3, np.int64)), words.WRONG_TYPE, id="whole numbers"),
        pytest.param(scan(bearings_rad=BEARINGS[::-1]), words.WRONG_BEARINGS, id="clockwise"),
        pytest.param(scan(bearings_rad=BEARINGS + 3.0), words.WRONG_BEARINGS, id="beyond a half turn"),
        pytest.param(scan(bearings_rad=BEARINGS * np.nan), words.WRONG_BEARINGS, id="NaN bearings"),
        pytest.param(scan(bearings_rad=np.array([-1.0, np.nan, 1.0])), words.WRONG_BEARINGS, id="a NaN among them"),
        pytest.param(scan(ranges_m=np.array([1.0, np.nan, -1.0])), words.NOT_POSITIVE, id="negative"),
        pytest.param(scan(max_range_m=-1.0), words.WRONG_LIMIT, id="negative limit"),
        pytest.param(scan(ranges_m=np.zeros(3)), words.NO_SURFACE, id="all zero"),
        pytest.param(scan(ranges_m=np.array([np.nan, np.inf, 10.0])), words.NO_SURFACE, id="nothing near, or unknown"),
    ],
)
def test_an_impossible_planar_scan_is_refused_and_counted(sink: SensorSink, bad: RawPlanar, reason: str) -> None:
    """The bins of N(t) rest on ascending bearings and on ranges that are ranges."""
    sink.planar(bad)
    assert sink.take().planar is None
    assert dict(sink.statistics(NOW_S)[PLANAR].reasons) == {reason: 1}


@pytest.mark.parametrize("again_s", [99.0, 98.9, -1e9])
def test_a_stamp_that_does_not_rise_is_refused(sink: SensorSink, again_s: float) -> None:
    """A repeated, replayed or overtaken reading must not look fresh, even when the first has been taken already."""
    for t_s in (99.0, again_s):
        sink.depth(frame(t_s))
        sink.ranges([reading(t_s)])
        sink.planar(scan(t_s))
        sink.take()
    for name in (DEPTH, "front", PLANAR):
        statistics = sink.statistics(NOW_S)[name]
        assert (statistics.count, dict(statistics.reasons)) == (1, {words.NOT_NEWER: 1})


@pytest.mark.parametrize(
    ("said", "kept"), [(None, None), (math.nan, None), (math.inf, 8.0), (9.5, 9.5), (0.0, 0.0), (np.float64(1.5), 1.5)]
)
def test_missing_is_none_and_infinity_is_free_to_the_limit(
    sink: SensorSink, said: float | None, kept: float | None
) -> None:
    """NaN must not leave the sink, and infinity means what the model means by a range at its limit."""
    sink.ranges([reading(range_m=said)])
    assert [r.range_m for r in sink.take().ranges] == [kept]


def test_planar_scans_keep_nan_and_lose_infinity(sink: SensorSink) -> None:
    """As for a beam, ray by ray; numbers of 32 bits are taken too."""
    sink.planar(scan(ranges_m=np.array([np.nan, np.inf, 3.0], np.float32)))
    taken = sink.take().planar
    assert taken is not None
    assert taken.ranges_m.dtype == np.float64
    np.testing.assert_array_equal(taken.ranges_m, [np.nan, 10.0, 3.0])


@pytest.mark.parametrize("at", [0, 3, 4, 11])
def test_an_image_may_hold_nan_and_infinity(sink: SensorSink, at: int) -> None:
    """Missing and seen free are no errors beside a single pixel that shows a surface, wherever it is."""
    depth_m = np.array([[np.nan, np.inf, 10.0, 11.0]] * 3, np.float32)
    depth_m.flat[at] = 2.0
    sink.depth(frame(depth_m=depth_m))
    assert sink.take().depth is not None


def test_one_pixel_among_many_is_found(sink: SensorSink) -> None:
    """Only some are looked at first: what lies between them must count as well."""
    large = replace(CAMERA, width_px=64, height_px=48, cx_px=31.5, cy_px=23.5)
    depth_m = np.full((48, 64), np.nan, np.float32)
    depth_m[13, 27] = 2.0
    sink.depth(RawDepth(NOW_S, depth_m, large))
    assert sink.take().depth is not None


def test_rate_and_age(sink: SensorSink, clock: HandClock) -> None:
    """What pre-flight and the pilot are told: 10 Hz is 10 Hz from the first second on, and falls when it stops."""
    for i in range(50):
        clock.time_s = NOW_S + 0.1 * i
        sink.ranges([reading(clock.time_s - 0.02)])
        if i in (10, 49):
            assert sink.statistics(clock.time_s)["front"].rate_hz == pytest.approx(10.0, rel=0.06)
    assert sink.statistics(clock.time_s)["front"].age_s == pytest.approx(0.02)
    stopped = sink.statistics(clock.time_s + 1.0)["front"]
    assert stopped.rate_hz == pytest.approx(5.0, abs=0.6)
    assert stopped.age_s == pytest.approx(1.02)
    assert sink.statistics(clock.time_s + 10.0)["front"].rate_hz == 0.0
    assert set(sink.statistics(clock.time_s)) == set(STREAMS)


def test_one_reading_is_no_rate(sink: SensorSink) -> None:
    """A single one has no period: nothing to divide by."""
    sink.depth(frame())
    assert sink.statistics(NOW_S)[DEPTH].rate_hz == 0.0


def test_reasons_of_drivers_are_counted_within_bounds(sink: SensorSink) -> None:
    """A driver that puts a number into its reasons must not fill the memory."""
    for i in range(1000):
        sink.drop(DEPTH, f"reason {i}")
    statistics = sink.statistics(NOW_S)[DEPTH]
    assert statistics.dropped == 1000
    assert len(statistics.reasons) <= 17


def test_many_threads_fill_it_and_nothing_is_lost(sink: SensorSink) -> None:
    """Drivers may live in threads of their own: each reading is counted once, as accepted or refused."""

    def fill(beam: Beam) -> None:
        for i in range(500):
            sink.ranges([reading(90.0 + i * 0.01, beam)])
            sink.depth(frame(90.0 + i * 0.01))
            sink.take()

    threads = [threading.Thread(target=fill, args=(beam,)) for beam in Beam]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    statistics = sink.statistics(NOW_S)
    assert all(statistics[beam].count == 500 for beam in Beam)
    assert statistics[DEPTH].count + statistics[DEPTH].dropped == 500 * len(Beam)


@given(
    t_s=st.floats() | st.none() | st.text(),
    range_m=st.floats() | st.none() | st.text() | st.integers(),
    limit=st.floats(),
)
def test_nothing_that_is_said_raises_and_no_nan_comes_out(t_s: Any, range_m: Any, limit: float) -> None:
    """Whatever a driver hands in: refused or sound, never an exception in the driver's loop."""
    sink = SensorSink(HandClock(NOW_S))
    sink.ranges([RangeReading(Beam.UP, t_s, range_m, limit)])
    for kept in sink.take().ranges:
        assert kept.t_s <= NOW_S + words.FUTURE_S
        assert math.isfinite(kept.max_range_m)
        assert kept.range_m is None or (math.isfinite(kept.range_m) and kept.range_m >= 0.0)
