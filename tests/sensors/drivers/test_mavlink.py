"""DISTANCE_SENSOR and OBSTACLE_DISTANCE: every direction, unit and special value, and whatever else may come."""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.config.settings import Settings
from companion.mavlink.ids import MavCmd
from companion.model import Beam, RangeReading
from companion.sensors.drivers import mavlink
from companion.sensors.drivers.driver import DriverContext
from companion.sensors.drivers.mavlink import DISTANCE, OBSTACLES, MavlinkDriver, create, planar_scan
from companion.sensors.sink import SensorSink, Taken
from tests.autopilot.fake_link import FakeLink
from tests.shared.beside import until
from tests.shared.clocks import HandClock

NOW_S = 100.0


def distance(**changed: Any) -> dict[str, Any]:
    """A DISTANCE_SENSOR that looks down and sees the ground 1.5 m away."""
    fields = {"time_boot_ms": 0, "min_distance": 20, "max_distance": 800, "current_distance": 150, "type": 0, "id": 0}
    return {**fields, "orientation": 25, "covariance": 0, "signal_quality": 0, **changed}


def obstacles(**changed: Any) -> dict[str, Any]:
    """An OBSTACLE_DISTANCE of 72 sectors of 5° with something 3 m ahead and nothing else known."""
    fields: dict[str, Any] = {"time_usec": 0, "sensor_type": 0, "distances": [300] + [65535] * 71, "increment": 5}
    fields |= {"min_distance": 20, "max_distance": 1000, "increment_f": 0.0, "angle_offset": 0.0, "frame": 12}
    return fields | changed


class Bench:
    """A running driver, its link, its sink and its clock."""

    def __init__(self) -> None:
        self.clock = HandClock(NOW_S)
        self.link = FakeLink(self.clock)
        self.sink = SensorSink(self.clock)
        self.driver = MavlinkDriver(self.link, self.clock, {DISTANCE: 10.0, OBSTACLES: 5.0})

    def says(self, name: str, fields: dict[str, Any], received_s: float = NOW_S, **sender: int) -> Taken:
        """What is in the sink after that message."""
        self.clock.time_s = received_s
        self.link.deliver(name, fields, **sender)
        return self.sink.take()

    def reasons(self, stream: str) -> set[str]:
        return set(self.sink.statistics(self.clock.time_s)[stream].reasons)


@asynccontextmanager
async def bench() -> AsyncIterator[Bench]:
    made = Bench()
    task = asyncio.create_task(made.driver.run(made.sink))
    await asyncio.sleep(0)
    try:
        yield made
    finally:
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task


async def taken_ranges(fields: dict[str, Any]) -> tuple[RangeReading, ...]:
    async with bench() as b:
        return b.says(DISTANCE, fields).ranges


@pytest.mark.parametrize(
    ("orientation", "beam"),
    [(0, Beam.FRONT), (2, Beam.RIGHT), (4, Beam.BACK), (6, Beam.LEFT), (24, Beam.UP), (25, Beam.DOWN)],
)
async def test_each_orientation_is_its_beam(orientation: int, beam: Beam) -> None:
    """Left and right swapped would steer into the wall; the stamp is the arrival, the length in metres."""
    assert await taken_ranges(distance(orientation=orientation)) == (RangeReading(beam, NOW_S, 1.5, 8.0),)


@pytest.mark.parametrize(
    ("changed", "range_m"),
    [
        pytest.param({"current_distance": 800}, 8.0, id="free out to the limit"),
        pytest.param({"current_distance": 1200}, None, id="beyond the limit"),
        pytest.param({"current_distance": 65535}, None, id="65535, which many send for nothing"),
        pytest.param({"current_distance": 65535, "max_distance": 65535}, None, id="65535 as its range too"),
        pytest.param({"current_distance": 10}, None, id="nearer than it can measure"),
        pytest.param({"current_distance": 0, "min_distance": 0}, None, id="zero"),
        pytest.param({"signal_quality": 1}, None, id="failed reading"),
        pytest.param({"signal_quality": 100}, 1.5, id="perfect signal"),
        pytest.param({"signal_quality": None}, 1.5, id="signal quality not sent"),
    ],
)
async def test_what_a_distance_means(changed: dict[str, Any], range_m: float | None) -> None:
    """A failed reading is missing, not free and not 0 m; what has no quality is believed, as most sensors have none."""
    (reading,) = await taken_ranges(distance(**changed))
    assert reading.range_m == range_m


@pytest.mark.parametrize(
    "changed",
    [
        {"current_distance": None},
        {"current_distance": math.nan},
        {"current_distance": "150"},
        {"max_distance": 0},
        {"max_distance": None},
        {"min_distance": 900},
        {"min_distance": True},
    ],
)
async def test_a_malformed_distance_is_counted(changed: dict[str, Any]) -> None:
    """JSON makes null of a NaN: neither may crash, nor become a range."""
    async with bench() as b:
        assert b.says(DISTANCE, distance(**changed)).ranges == ()
        assert b.reasons("down") == {mavlink.MALFORMED}


@pytest.mark.parametrize("other", [{"component_id": 197}, {"id": 3}])
async def test_of_two_that_look_the_same_way_the_first_that_measured_is_believed(other: dict[str, int]) -> None:
    """Protects the height: a second sensor that says 65535, or sees something else, took it away every other tick."""
    sender = {name: value for name, value in other.items() if name == "component_id"}
    changed = {name: value for name, value in other.items() if name == "id"}
    async with bench() as b:
        nothing = b.says(DISTANCE, distance(current_distance=65535, **changed), **sender).ranges
        assert [reading.range_m for reading in nothing] == [None]
        assert len(b.says(DISTANCE, distance(), NOW_S + 0.1).ranges) == 1
        for i, seen_cm in enumerate((30, 65535), start=2):
            told = distance(current_distance=seen_cm, **changed)
            assert b.says(DISTANCE, told, NOW_S + 0.1 * i, **sender).ranges == ()
        (reason,) = b.reasons("down")
        other_name = "component 197, id 0" if sender else "component 1, id 3"
        assert reason == (f"from {other_name}; component 1, id 0 looks the same way, measured first, and is believed")
        assert len(b.says(DISTANCE, distance(orientation=24, **changed), NOW_S + 0.5, **sender).ranges) == 1, "upward"


@pytest.mark.parametrize(
    ("chosen", "ranges_m"),
    [({}, 1.5), ({"down_component": 197}, 0.3), ({"down_id": 3}, 0.3), ({"down_component": 1, "down_id": 0}, 1.5)],
)
async def test_which_rangefinder_is_believed_can_be_chosen(chosen: dict[str, int], ranges_m: float) -> None:
    """Protects a vehicle with two: the first that speaks is chance."""
    settings = Settings.model_validate({"sensors": {"mavlink": chosen, "drivers": ["mavlink"]}})
    async with bench() as b:
        b.driver._choice = create(settings, DriverContext(b.clock, b.link))._choice
        found = [*b.says(DISTANCE, distance(), NOW_S + 0.1).ranges]
        found += b.says(DISTANCE, distance(current_distance=30, id=3), NOW_S + 0.2, component_id=197).ranges
        assert [reading.range_m for reading in found] == [ranges_m]
        assert len(b.reasons("down")) == 1


@pytest.mark.parametrize(("other_cm", "times"), [(30, 2), (230, 2), (170, 0), (65535, 0)])
async def test_two_that_contradict_each_other_for_long_are_told(other_cm: int, times: int) -> None:
    """Protects the height: which of the two is right nobody here knows, and somebody has to look."""
    async with bench() as b:
        for i in range(350):
            b.says(DISTANCE, distance(), NOW_S + 0.1 * i)
            b.says(DISTANCE, distance(current_distance=other_cm), NOW_S + 0.1 * i + 0.05, component_id=197)
        told = b.sink.warnings()
        assert len(told) == times, "after two seconds, and again after thirty"
        assert all(f"1/0 1.50 m, 197/0 {other_cm / 100:.2f} m contradict" in text for text in told)


async def test_what_passes_an_edge_one_after_the_other_is_no_contradiction() -> None:
    """Protects from a warning at each step of the ground, and about a sensor that has fallen silent."""
    async with bench() as b:
        for i in range(100):
            b.says(DISTANCE, distance(current_distance=150 if i % 15 else 30), NOW_S + 0.1 * i)
            b.says(DISTANCE, distance(current_distance=30 if i % 15 else 150), NOW_S + 0.1 * i + 0.05, component_id=197)
            if i % 15 == 1:
                b.says(DISTANCE, distance(), NOW_S + 0.1 * i + 0.06, component_id=197)
        for i in range(100, 200):
            b.says(DISTANCE, distance(current_distance=30), NOW_S + 0.1 * i, component_id=197)
        for component in range(2, 40):
            b.says(DISTANCE, distance(current_distance=30), NOW_S + 30.0 + 0.1 * component, component_id=component)
        assert b.sink.warnings() == []


async def test_only_our_vehicle_is_heard_but_any_component_of_it() -> None:
    """Another vehicle's height above ground, believed, would end on the ground."""
    async with bench() as b:
        assert b.says(DISTANCE, distance(), system_id=2).ranges == ()
        assert b.says(DISTANCE, distance(orientation=12)).ranges == ()
        assert len(b.says(DISTANCE, distance(), component_id=197).ranges) == 1


@pytest.mark.parametrize(
    ("name", "fields"), [(DISTANCE, distance(time_boot_ms=5000)), (OBSTACLES, obstacles(time_usec=5_000_000))]
)
async def test_a_replayed_message_is_not_fresh(name: str, fields: dict[str, Any]) -> None:
    """The same stamp again, or an older one, is an old reading however late it arrives; a reboot is not a replay."""
    stamp, step = ("time_boot_ms", 1) if name == DISTANCE else ("time_usec", 1000)
    async with bench() as b:

        def comes(stamp_ms: int, received_s: float, **sender: int) -> bool:
            taken = b.says(name, {**fields, stamp: stamp_ms * step}, received_s, **sender)
            return taken != Taken(None, (), None)

        assert comes(5000, 100.0)
        assert not comes(5000, 100.1)
        assert not comes(4900, 100.2)
        assert comes(5100, 100.3)
        # Another sender has its own stamps; of rangefinders only one is believed.
        assert comes(4000, 100.4, component_id=158) == (name == OBSTACLES)
        assert comes(100, 102.0), "rebooted"
        assert comes(0, 102.1), "senders without a clock send zero"
        assert comes(0, 102.2)


def test_sectors_turn_the_other_way_round() -> None:
    """MAVLink counts clockwise: the sector at 90° is the wall on the right, at a bearing of -π/2."""
    distances = [65535] * 72
    distances[0], distances[18], distances[54] = 300, 150, 200
    scan = planar_scan(obstacles(distances=distances), NOW_S)
    assert scan is not None
    for bearing_rad, range_m in ((0.0, 3.0), (-math.pi / 2.0, 1.5), (math.pi / 2.0, 2.0)):
        near = np.abs(scan.bearings_rad - bearing_rad) < math.radians(2.4)
        assert near.sum() >= 4
        assert set(scan.ranges_m[near]) == {range_m}
    assert np.isnan(scan.ranges_m).sum() == 360 - 15


@given(
    offset_deg=st.floats(-180.0, 180.0),
    increment=st.sampled_from([1.0, 2.5, 5.0, 7.3, 30.0, 90.0, 360.0]),
    sector=st.integers(0, 71),
)
def test_a_sector_is_where_its_offset_puts_it(offset_deg: float, increment: float, sector: int) -> None:
    """Positive offsets are clockwise; each sector is centred on its angle and fills its width, no more."""
    sector %= int(360.0 / increment + 1e-3)
    distances = [1001] * 72
    distances[sector] = 250
    scan = planar_scan(obstacles(distances=distances, increment_f=increment, angle_offset=offset_deg), NOW_S)
    assert scan is not None
    middle_rad = -math.radians(offset_deg + sector * increment)
    off = np.abs([math.remainder(bearing - middle_rad, 2.0 * math.pi) for bearing in scan.bearings_rad])
    hit = scan.ranges_m == 2.5
    assert hit.any()
    assert off[hit].max() <= math.radians(increment) / 2.0
    # Rays of a turn that is not a whole number of sectors leave a gap, never an overlap.
    assert (scan.ranges_m[~hit] == 10.0).all()
    assert not hit.all() or increment == 360.0
    assert (np.diff(scan.bearings_rad) > 0.0).all()


@pytest.mark.parametrize(
    ("cm", "range_m"),
    [(65535, math.nan), (1001, 10.0), (1000, 10.0), (0, 0.01), (15, 0.15), (None, math.nan), (-3, math.nan)],
)
def test_what_a_sector_means(cm: int | None, range_m: float) -> None:
    """Unknown is not free, free is not unknown, and 0 is an obstacle that touches, not a missing one."""
    scan = planar_scan(obstacles(distances=[cm] * 72), NOW_S)
    assert scan is not None
    np.testing.assert_array_equal(scan.ranges_m, np.full(360, range_m))


def test_the_fine_increment_wins() -> None:
    """``increment`` is whole degrees and ignored when ``increment_f`` is there."""
    scan = planar_scan(obstacles(distances=[300] * 10, increment=5, increment_f=1.5), NOW_S)
    assert scan is not None
    assert np.ptp(scan.bearings_rad) == pytest.approx(math.radians(15.0 - 0.75))


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({"frame": 0}, mavlink.WRONG_FRAME),
        ({"frame": None}, mavlink.WRONG_FRAME),
        ({"distances": None}, mavlink.MALFORMED),
        ({"distances": []}, mavlink.MALFORMED),
        ({"distances": [1] * 73}, mavlink.MALFORMED),
        ({"increment": 0}, mavlink.MALFORMED),
        ({"increment_f": -5.0}, mavlink.MALFORMED),
        ({"increment_f": 1e30}, mavlink.MALFORMED),
        ({"max_distance": 0}, mavlink.MALFORMED),
        ({"angle_offset": 1e30}, mavlink.MALFORMED),
    ],
)
async def test_obstacles_that_make_no_sense_are_counted(changed: dict[str, Any], reason: str) -> None:
    """Bearings from north, taken for bearings from the heading, would show walls where there are none."""
    async with bench() as b:
        assert b.says(OBSTACLES, obstacles(**changed)).planar is None
        assert b.reasons("planar") == {reason}
        assert b.says(OBSTACLES, obstacles(), NOW_S + 0.1).planar is not None


values = (
    st.none() | st.booleans() | st.text(max_size=3) | st.integers() | st.floats() | st.lists(st.floats(), max_size=75)
)


@given(
    changed=st.dictionaries(st.sampled_from([*distance(), *obstacles()]), values),
    name=st.sampled_from([DISTANCE, OBSTACLES]),
)
async def test_nothing_in_a_message_raises(changed: dict[str, Any], name: str) -> None:
    """Fuzzed fields: ignored, counted, or a sound reading."""
    async with bench() as b:
        taken = b.says(name, {**(distance() if name == DISTANCE else obstacles()), **changed})
        for reading in taken.ranges:
            assert reading.range_m is None or math.isfinite(reading.range_m)
        if taken.planar is not None:
            assert (np.isnan(taken.planar.ranges_m) | (taken.planar.ranges_m > 0.0)).all()


async def test_silent_messages_are_asked_for_and_coming_ones_are_not(monkeypatch: pytest.MonkeyPatch) -> None:
    """ArduPilot sends no ranges unasked; a refusal, or a link that is gone, does not end the driver."""
    monkeypatch.setattr(mavlink, "SILENT_S", 0.01)
    monkeypatch.setattr(mavlink, "ASK_AGAIN_S", 0.02)
    async with bench() as b:
        b.link.results = {MavCmd.SET_MESSAGE_INTERVAL: None}
        b.says(DISTANCE, distance(), NOW_S)
        await until(lambda: len(b.link.commands) >= 2)
        assert set(b.link.commands) == {(MavCmd.SET_MESSAGE_INTERVAL, (330.0, 200_000.0))}


async def test_after_the_end_nothing_is_taken() -> None:
    """A subscription outlives the driver: what comes then goes nowhere."""
    async with bench() as b:
        pass
    assert b.says(DISTANCE, distance()).ranges == ()
