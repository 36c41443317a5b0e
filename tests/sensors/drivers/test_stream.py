"""The stream over real sockets: clocks aligned, lost connections taken up again, slow and foreign ends survived."""

from __future__ import annotations

import asyncio
import contextlib
import math
import os
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path

import numpy as np
import pytest

from companion.clock import MonotonicClock
from companion.errors import InputError
from companion.model import Beam, Camera, RangeReading
from companion.sensors.drivers.framing import encode_camera, encode_depth, encode_ping
from companion.sensors.drivers.messages import Ping
from companion.sensors.drivers.stream import NO_CAMERA, NOT_ALIGNED, StreamDriver
from companion.sensors.drivers.stream_server import MOST_CLIENTS, StreamServer
from companion.sensors.sink import DEPTH, SensorSink
from sitl.launch.processes import free_tcp_port
from tests.shared.beside import until
from tests.shared.clocks import AheadClock

CAMERA = Camera(8, 6, 4.0, 4.0, 3.5, 2.5, 0.25, 10.0)
DEPTH_M = np.full((6, 8), 2.5, np.float32)
AHEAD_S = 2534.0
"""How far the other computer's clock is ahead of ours."""

PATIENCE_S = 10.0
"""Far more than any wait takes here, and far less than a test may."""


@asynccontextmanager
async def running(url: str) -> AsyncIterator[tuple[StreamDriver, SensorSink]]:
    """A driver that runs until the block is left, and then is gone."""
    driver, sink = StreamDriver(url, MonotonicClock()), SensorSink(MonotonicClock())
    task = asyncio.create_task(driver.run(sink))
    try:
        yield driver, sink
    finally:
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task


@pytest.mark.parametrize("kind", ["tcp", "unix"])
async def test_everything_arrives_in_our_time(kind: str, tmp_path: Path) -> None:
    """A frame exposed now must not look 42 minutes old, nor from the future; the error is as small as it says."""
    clock = AheadClock(AHEAD_S)
    url = "tcp://127.0.0.1:0" if kind == "tcp" else f"unix://{tmp_path}/sensors"
    async with StreamServer(url, CAMERA, clock) as server, running(server.url) as (driver, sink):
        await until(lambda: driver.residual_s is not None)
        exposed_s = time.monotonic()
        server.publish_depth(exposed_s + AHEAD_S, DEPTH_M)
        server.publish_ranges([RangeReading(Beam.DOWN, exposed_s + AHEAD_S, 1.5, 8.0)])
        server.publish_planar(exposed_s + AHEAD_S, np.array([0.0, 1.0]), np.array([3.0, np.nan]), 12.0)
        await until(lambda: sink.statistics(time.monotonic())["planar"].count)
        taken, residual_s = sink.take(), driver.residual_s
        assert taken.depth is not None
        assert taken.planar is not None
        assert residual_s is not None
        assert taken.depth.camera == CAMERA
        np.testing.assert_array_equal(taken.depth.depth_m, DEPTH_M)
        (down,) = taken.ranges
        assert (down.beam, down.range_m, down.max_range_m) == (Beam.DOWN, 1.5, 8.0)
        np.testing.assert_array_equal(taken.planar.ranges_m, [3.0, np.nan])
        for t_s in (taken.depth.t_s, down.t_s, taken.planar.t_s):
            # A microsecond for the rounding of sums.
            assert abs(t_s - exposed_s) <= residual_s + 1e-6
        assert driver.problem is None or driver.problem == "not started"
    assert not os.listdir(tmp_path), "the socket's file stayed behind"  # noqa: PTH208 - pathlib would count as blocking


async def test_a_stream_that_is_not_there_is_waited_for_and_taken_up_again() -> None:
    """The camera process starts late, and dies and comes back in flight: nobody restarts the application."""
    url = f"tcp://127.0.0.1:{free_tcp_port()}"
    async with running(url) as (driver, sink):
        await until(lambda: "refused" in str(driver.problem) or "connect" in str(driver.problem).lower())
        for life in (1, 2):
            # The second one's clock is another: its offset must not be that of the first.
            clock = AheadClock(AHEAD_S * life)
            async with StreamServer(url, CAMERA, clock) as server:
                before = sink.statistics(time.monotonic())[DEPTH].count

                def comes(server: StreamServer = server, clock: AheadClock = clock, before: int = before) -> bool:
                    server.publish_depth(clock.now_s(), DEPTH_M)
                    return sink.statistics(time.monotonic())[DEPTH].count > before

                await until(comes)
                taken = sink.take().depth
                assert taken is not None
                assert abs(taken.t_s - time.monotonic()) < PATIENCE_S
            await until(lambda: driver.residual_s is None)


async def serve(answer: Callable[[asyncio.StreamReader, asyncio.StreamWriter], object]) -> asyncio.Server:
    """A server that is not ours: writes what it likes, listens, and never answers."""

    async def connected(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(ConnectionError):
            answer(reader, writer)
            await writer.drain()
            while await reader.read(4096):
                pass
        writer.close()

    return await asyncio.start_server(connected, "127.0.0.1", 0)


@pytest.mark.parametrize(
    ("data", "said"),
    [
        pytest.param(b"HTTP/1.1 400 Bad Request\r\n\r\n", "does not speak", id="a web server"),
        pytest.param(b"\x8eCSS\x07" + bytes(11), "version 7", id="another release"),
        pytest.param(encode_ping(Ping(1.0)), "wants to receive", id="two receivers"),
    ],
)
async def test_a_foreign_server_is_named_and_tried_again(data: bytes, said: str) -> None:
    """Garbage on the port ends a connection, never the driver; the reason is there for a person."""
    connections = []

    def answer(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        connections.append(writer)
        writer.write(data)

    server = await serve(answer)
    async with server, running(f"tcp://127.0.0.1:{server.sockets[0].getsockname()[1]}") as (driver, sink):
        await until(lambda: len(connections) >= 3)
        assert said in str(driver.problem)
        assert sink.statistics(time.monotonic())[DEPTH].count == 0


async def test_frames_that_cannot_be_placed_in_time_are_dropped_by_name() -> None:
    """A server that never answers pings, or never says what its camera is, gives nothing to fly by."""

    def answer(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(encode_camera(CAMERA) + encode_depth(time.monotonic(), DEPTH_M))

    server = await serve(answer)
    async with server, running(f"tcp://127.0.0.1:{server.sockets[0].getsockname()[1]}") as (_, sink):
        await until(lambda: sink.statistics(time.monotonic())[DEPTH].dropped)
        assert set(sink.statistics(time.monotonic())[DEPTH].reasons) == {NOT_ALIGNED}
    async with StreamServer("tcp://127.0.0.1:0", None, MonotonicClock()) as ours, running(ours.url) as (driver, sink):
        await until(lambda: driver.residual_s is not None)
        for client in ours._clients:
            client.send(encode_depth(time.monotonic(), DEPTH_M), 0)
        await until(lambda: sink.statistics(time.monotonic())[DEPTH].dropped)
        assert set(sink.statistics(time.monotonic())[DEPTH].reasons) == {NO_CAMERA}


async def test_a_dead_connection_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    """A cable that is pulled sends no farewell: without answers the driver hangs up and connects anew."""
    monkeypatch.setattr("companion.sensors.drivers.stream.FAST_PING_S", 0.02)
    connections = []
    server = await serve(lambda reader, _: connections.append(reader))
    async with server, running(f"tcp://127.0.0.1:{server.sockets[0].getsockname()[1]}") as (driver, _):
        await until(lambda: len(connections) >= 2)
        assert "nothing comes" in str(driver.problem)


async def test_a_slow_client_misses_frames_and_costs_no_memory() -> None:
    """A client that stopped reading must not fill the memory of the camera process, nor hold up the others."""
    camera = Camera(640, 480, 400.0, 400.0, 319.5, 239.5, 0.25, 10.0)
    depth_m = np.ones((480, 640), np.float32)
    async with StreamServer("tcp://127.0.0.1:0", camera, MonotonicClock()) as server:
        port = int(server.url.rpartition(":")[2])
        reader, writer = await asyncio.open_connection("127.0.0.1", port, limit=1024)
        async with running(server.url) as (driver, sink):
            await until(lambda: driver.residual_s is not None)

            def skips() -> bool:
                server.publish_depth(time.monotonic(), depth_m)
                server.publish_ranges([RangeReading(Beam.UP, time.monotonic(), 1.0, 8.0)] * 60)
                return server.skipped > 300

            await until(skips)
            waiting = [c._transport.get_write_buffer_size() for c in server._clients if c._transport is not None]
            # One image, the backlog of small messages, and one of those.
            assert max(waiting) < depth_m.nbytes + 4 * 65_536
            assert sink.statistics(time.monotonic())[DEPTH].count > 3
        writer.transport.abort()
        del reader


async def test_clients_are_bounded_and_garbage_from_one_is_its_end() -> None:
    """Whoever connects by mistake, or a hundred times, costs the camera process nothing."""
    async with StreamServer("tcp://127.0.0.1:0", CAMERA, MonotonicClock()) as server:
        port = int(server.url.rpartition(":")[2])
        pairs = [await asyncio.open_connection("127.0.0.1", port) for _ in range(MOST_CLIENTS)]
        await until(lambda: server.client_count == MOST_CLIENTS)
        extra, extra_writer = await asyncio.open_connection("127.0.0.1", port)
        with contextlib.suppress(ConnectionError):
            assert await extra.read() == b""
        assert server.client_count == MOST_CLIENTS
        pairs[0][1].write(b"GET / HTTP/1.1\r\n\r\n")
        # Nothing with a payload is wanted from a client.
        pairs[1][1].write(encode_depth(1.0, DEPTH_M))
        await until(lambda: server.client_count == MOST_CLIENTS - 2)
        for _, writer in [*pairs, (extra, extra_writer)]:
            writer.transport.abort()
        await asyncio.sleep(0)


async def test_the_server_refuses_what_does_not_fit_its_camera() -> None:
    """The error belongs to the camera process, not to the vehicle in flight."""
    async with StreamServer("tcp://127.0.0.1:0", CAMERA, MonotonicClock()) as server:
        with pytest.raises(ValueError, match="does not fit the camera"):
            server.publish_depth(1.0, DEPTH_M.T)
        with pytest.raises(ValueError, match="not JSON compliant"):
            server.publish_planar(math.nan, np.zeros(1), np.ones(1), 8.0)
        with pytest.raises(InputError, match="cannot offer a sensor stream"):
            async with StreamServer(server.url, CAMERA, MonotonicClock()):
                pass
