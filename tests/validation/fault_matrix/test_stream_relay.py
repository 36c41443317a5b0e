"""The relay on the sensors' stream: a fault that was not injected as meant would prove nothing."""

from __future__ import annotations

import asyncio
import math
import socket
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import replace

import numpy as np
import pytest

from companion.clock import MonotonicClock
from companion.model import Beam, Camera, RangeReading
from companion.sensors.drivers.messages import DepthImage, Ranges
from companion.sensors.drivers.stream import StreamDriver
from companion.sensors.drivers.stream_server import StreamServer
from companion.sensors.sink import DEPTH, SensorSink, Taken
from tests.shared.beside import until
from validation.fault_matrix.stream_relay import HONEST, LOOPBACK, StreamRelay, Tampering

CAMERA = Camera(4, 3, 2.0, 2.0, 1.5, 1.0, 0.2, 8.0)
TIMEOUT_S = 10.0


class Sensors:
    """A world's stream, the relay, and the application's driver, on one event loop."""

    def __init__(self, relay: StreamRelay, server: StreamServer, driver: StreamDriver, sink: SensorSink) -> None:
        self.relay, self.server, self.driver, self.sink = relay, server, driver, sink
        self.clock = MonotonicClock()

    def publish(self, depth_m: float, range_m: float, stamp_s: float | None = None) -> float:
        t_s = self.clock.now_s() if stamp_s is None else stamp_s
        self.server.publish_depth(t_s, np.full((3, 4), depth_m, np.float32))
        self.server.publish_ranges([RangeReading(beam, t_s, range_m, 6.0) for beam in (Beam.FRONT, Beam.LEFT)])
        return t_s

    async def taken(self, enough: Callable[[Taken], bool]) -> Taken:
        """Everything that comes, as one, until there is enough of it."""
        whole = Taken(None, (), None)
        async with asyncio.timeout(TIMEOUT_S):
            while not enough(whole):
                await asyncio.sleep(0.005)
                new = self.sink.take()
                whole = Taken(new.depth or whole.depth, new.ranges or whole.ranges, None)
        return whole

    def refused(self, stream: str) -> int:
        return self.sink.statistics(self.clock.now_s())[stream].dropped


@asynccontextmanager
async def connected_sensors() -> AsyncIterator[Sensors]:
    clock = MonotonicClock()
    async with StreamServer(f"tcp://{LOOPBACK}:0", CAMERA, clock) as server:
        with StreamRelay(int(server.url.rpartition(":")[2])) as relay:
            sink = SensorSink(clock)
            driver = StreamDriver(relay.url, clock)
            task = asyncio.create_task(driver.run(sink))
            try:
                await until(lambda: driver.residual_s is not None)
                yield Sensors(relay, server, driver, sink)
            finally:
                task.cancel()
                await asyncio.wait([task])
                assert not relay.errors


def complete(taken: Taken) -> bool:
    return taken.depth is not None and len(taken.ranges) == 2


async def test_an_honest_stream_arrives_whole_and_with_its_stamps() -> None:
    """Protects every flight of the matrix: pings and images pass, so stamps are right to a few milliseconds."""
    async with connected_sensors() as sensors:
        t_s = sensors.publish(3.0, 2.0)
        taken = await sensors.taken(complete)
        assert taken.depth is not None
        assert taken.depth.camera == CAMERA
        assert float(taken.depth.depth_m[0, 0]) == 3.0
        assert {reading.range_m for reading in taken.ranges} == {2.0}
        assert abs(taken.depth.t_s - t_s) < 0.05, "half a round trip"
        assert sensors.relay.changed == [0, 0]


async def test_depth_and_ranges_are_changed_and_silenced_each_on_their_own() -> None:
    """Protects the rows of the matrix that fail one sensor: the other must go on."""

    def further(image: DepthImage, camera: Camera) -> DepthImage:
        return replace(image, depth_m=np.full_like(image.depth_m, camera.max_range_m - 1.0))

    def none(_readings: Ranges) -> None:
        return None

    async with connected_sensors() as sensors:
        sensors.relay.depth = Tampering(depth=further)
        sensors.publish(3.0, 2.0)
        taken = await sensors.taken(complete)
        assert taken.depth is not None
        assert float(taken.depth.depth_m[2, 3]) == 7.0
        assert sensors.relay.changed == [1, 0]
        sensors.relay.depth, sensors.relay.ranges = HONEST, Tampering(ranges=none)
        sensors.publish(3.0, 2.0)
        taken = await sensors.taken(lambda found: found.depth is not None)
        await asyncio.sleep(0.05)
        assert sensors.sink.take().ranges == taken.ranges == ()


async def test_what_is_delayed_arrives_later_with_the_stamp_that_it_had() -> None:
    """Protects the row of the matrix in which the sensors lag: the age has to show, so the clock must not lag along."""
    async with connected_sensors() as sensors:
        sensors.relay.depth = Tampering(delay_s=0.4)
        t_s = sensors.publish(3.0, 2.0)
        at_once = await sensors.taken(lambda found: len(found.ranges) == 2)
        assert at_once.depth is None
        later = await sensors.taken(lambda found: found.depth is not None)
        assert later.depth is not None
        assert abs(later.depth.t_s - t_s) < 0.05
        assert sensors.clock.now_s() - later.depth.t_s >= 0.39


async def test_no_number_passes_for_ranges_as_nothing_measured_and_a_stamp_of_the_past_is_refused() -> None:
    """Protects the meaning of two rows: what the driver makes of NaN, and of stamps that go back."""

    def no_numbers(readings: Ranges) -> Ranges:
        return Ranges(tuple(replace(reading, range_m=math.nan) for reading in readings.readings))

    def before(readings: Ranges) -> Ranges:
        return Ranges(tuple(replace(reading, t_s=reading.t_s - 5.0) for reading in readings.readings))

    async with connected_sensors() as sensors:
        sensors.relay.ranges = Tampering(ranges=no_numbers)
        sensors.publish(3.0, 2.0)
        taken = await sensors.taken(complete)
        assert {reading.range_m for reading in taken.ranges} == {None}
        sensors.relay.ranges = Tampering(ranges=before)
        sensors.publish(3.0, 2.0)
        await sensors.taken(lambda found: found.depth is not None and sensors.refused(Beam.FRONT) == 1)
        assert sensors.refused(DEPTH) == 0


async def test_an_end_that_goes_away_takes_the_other_along_and_the_driver_comes_back() -> None:
    """Protects the rows in which the application dies and is started again: it finds its sensors."""
    async with connected_sensors() as sensors:
        assert sensors.server.client_count == 1
        with socket.create_connection((LOOPBACK, sensors.relay.port)) as second:
            await until(lambda: sensors.server.client_count == 2)
            second.shutdown(socket.SHUT_RDWR)
            await until(lambda: sensors.server.client_count == 1)
        sensors.publish(3.0, 2.0)
        await sensors.taken(complete)


async def test_a_stream_that_was_cut_stays_cut() -> None:
    """Protects the row in which the sensors' process is gone: the driver tries again and must find nobody."""
    async with connected_sensors() as sensors:
        sensors.relay.cut()
        await until(lambda: sensors.driver.problem is not None)
        await until(lambda: sensors.server.client_count == 0)
        await asyncio.sleep(0.2)
        sensors.publish(3.0, 2.0)
        assert sensors.server.client_count == 0
        assert sensors.driver.residual_s is None


async def test_a_reader_that_stands_still_is_not_fed_from_a_growing_store() -> None:
    """Protects the rows that stop the application: the relay keeps nothing for it, the world's own server skips."""
    async with StreamServer(f"tcp://{LOOPBACK}:0", None, MonotonicClock()) as server:
        with StreamRelay(int(server.url.rpartition(":")[2])) as relay, socket.create_connection((LOOPBACK, relay.port)):
            await until(lambda: server.client_count == 1)
            readings = [RangeReading(Beam.FRONT, 1.0, 2.0, 6.0)] * 64

            def skips() -> bool:
                server.publish_ranges(readings)
                return server.skipped > 0

            await until(skips, period_s=0.0)


@pytest.mark.parametrize("kind", ["depth", "ranges"])
async def test_a_change_that_fails_is_told(kind: str) -> None:
    """Protects against a fault that was never injected because the test itself had one."""

    def fails(*_: object) -> None:
        raise ZeroDivisionError

    async with connected_sensors() as sensors:
        setattr(sensors.relay, kind, Tampering(depth=fails) if kind == "depth" else Tampering(ranges=fails))
        sensors.publish(3.0, 2.0)
        await sensors.taken(complete)
        assert [type(error) for error in sensors.relay.errors] == [ZeroDivisionError]
        sensors.relay.errors.clear()
