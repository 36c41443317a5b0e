"""Readings that come and are refused: the check says why, and what to do."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from companion.config.sensors import CameraSettings
from companion.model import Beam, RangeReading
from companion.sensors import sink as sinks
from companion.sensors.remedies import REMEDIES, remedy, told
from companion.sensors.sink import RawDepth, SensorSink
from companion.sensors.statistics import StreamStatistics
from tests.shared.clocks import HandClock

NOW_S = 100.0
CAMERA = CameraSettings(width_px=32, height_px=24).model()
NEAR_BEYOND_FAR = dataclasses.replace(CAMERA, min_range_m=20.0)
GOOD = np.full((24, 32), 2.0, np.float32)


def after(*frames: RawDepth) -> StreamStatistics:
    sink = SensorSink(HandClock(NOW_S))
    for frame in frames:
        sink.depth(frame)
    return sink.statistics(NOW_S)["depth"]


ZEROS = GOOD.copy()
ZEROS[3, 4] = 0.0


@pytest.mark.parametrize(
    ("frame", "reason", "says"),
    [
        pytest.param(RawDepth(99.0, ZEROS, CAMERA), sinks.NOT_POSITIVE, "NaN", id="zeros for what was not measured"),
        pytest.param(RawDepth(99.0, GOOD * 1000, CAMERA), sinks.NO_SURFACE, "mm", id="millimetres"),
        pytest.param(RawDepth(99.0, GOOD.astype(np.uint16), CAMERA), sinks.WRONG_TYPE, "1000", id="16 bits"),
        pytest.param(RawDepth(99.0, -GOOD, CAMERA), sinks.NOT_POSITIVE, "never 0 or less", id="negative"),
        pytest.param(RawDepth(99.0, GOOD * np.float32(math.nan), CAMERA), sinks.NO_SURFACE, "uncover", id="all NaN"),
        pytest.param(RawDepth(1.79e9, GOOD, CAMERA), sinks.FROM_THE_FUTURE, "time of day", id="wall clock"),
        pytest.param(RawDepth(99_000.0, GOOD, CAMERA), sinks.FROM_THE_FUTURE, "ms", id="stamps in ms"),
        pytest.param(RawDepth(99.0, GOOD, NEAR_BEYOND_FAR), sinks.WRONG_CAMERA, "min", id="min > max"),
        pytest.param(RawDepth(99.0, GOOD.T.copy(), CAMERA), sinks.WRONG_SHAPE, "rows", id="rows for columns"),
    ],
)
def test_what_is_wrong_with_an_image_is_told(frame: RawDepth, reason: str, says: str) -> None:
    """Protects the integrator's first hour: "0.0 Hz, newest never came" was all that was said of 29 images."""
    found = after(frame)
    assert told(found) == f"1 came, 1 refused: {reason}"
    assert says in remedy(found)


def test_the_commonest_reason_comes_first() -> None:
    """Protects from a single bad image at the start that hides what is wrong with all others."""
    found = after(RawDepth(1e9, GOOD, CAMERA), *[RawDepth(99.0 + i / 100, ZEROS, CAMERA) for i in range(3)])
    assert told(found) == f"4 came, 4 refused: 3: {sinks.NOT_POSITIVE}; 1: {sinks.FROM_THE_FUTURE}"
    assert remedy(found) == REMEDIES[sinks.NOT_POSITIVE]


def test_what_is_well_is_not_spoken_of() -> None:
    """Protects the eye: a stream without a refusal has nothing to tell."""
    found = after(RawDepth(99.0, GOOD, CAMERA))
    assert (told(found), remedy(found)) == ("", "")


def test_a_drivers_own_reason_speaks_for_itself() -> None:
    """Protects from a remedy for something else."""
    sink = SensorSink(HandClock(NOW_S))
    sink.drop("down", "clock not aligned yet")
    sink.ranges([RangeReading(Beam.DOWN, 99.0, 1.0, 8.0)])
    found = sink.statistics(NOW_S)["down"]
    assert (told(found), remedy(found)) == ("2 came, 1 refused: clock not aligned yet", "")


def test_every_reason_of_the_sink_has_a_remedy() -> None:
    """Protects from a new reason that nobody can do anything about."""
    reasons = {value for name, value in vars(sinks).items() if name.isupper() and isinstance(value, str)}
    assert reasons - {sinks.DEPTH, sinks.PLANAR} == set(REMEDIES)
