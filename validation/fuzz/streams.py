"""The sensor stream: spoiled bytes and well-framed nonsense, into the driver and on to a vehicle that explores."""

from __future__ import annotations

import asyncio
import contextlib
import json
import random
import struct
import zlib
from collections.abc import Iterator
from typing import Any

import numpy as np

from companion.clock import MonotonicClock
from companion.model import Beam, Input, RangeReading
from companion.sensors.drivers.framing import (
    MAGIC,
    VERSION,
    Decoder,
    FramingError,
    encode_camera,
    encode_depth,
    encode_planar,
    encode_pong,
    encode_ranges,
)
from companion.sensors.drivers.messages import DepthImage, Kind, Pong
from companion.sensors.drivers.stream import StreamDriver, _Receiver
from companion.sensors.drivers.stream_server import StreamServer
from companion.sensors.sink import SensorSink
from validation.fuzz.flying import CAMERA, WALL_M, Flying, flying
from validation.fuzz.hostile import spoiled_json, spoiled_often

DEPTH_M = np.full((CAMERA.height_px, CAMERA.width_px), WALL_M, np.float32)
LARGEST_PAYLOAD_BYTES = 200_000


class StalledTransport(asyncio.Transport):
    """A connection whose other end takes everything and answers nothing."""

    closed = False

    def write(self, data: Any) -> None:
        """Lost."""

    def is_closing(self) -> bool:
        return self.closed

    def abort(self) -> None:
        self.closed = True


def framed(kind: int, header: object, payload: bytes) -> bytes:
    """A message whose checksum is right, whatever it says."""
    text = json.dumps(header).encode()[:16_384]
    prefix = struct.pack("<4sBBHI", MAGIC, VERSION, kind, len(text), len(payload))
    return prefix + struct.pack("<I", zlib.crc32(prefix + text)) + text + payload


def messages(t_s: float, asked_s: float) -> list[bytes]:
    """What the other end sends in one period, by its own clock, which is 500 s ahead."""
    bearings_rad = np.linspace(-3.0, 3.0, 90)
    return [
        encode_pong(Pong(asked_s, t_s)),
        encode_camera(CAMERA),
        encode_depth(t_s, DEPTH_M),
        encode_ranges([RangeReading(Beam.DOWN, t_s, 1.5, 8.0), RangeReading(Beam.UP, t_s, None, 8.0)]),
        encode_planar(t_s, bearings_rad, np.full(90, WALL_M), 12.0),
    ]


def nonsense(rng: random.Random, data: bytes) -> bytes:
    """The same message with a header that says something else, and numbers of any size in its payload."""
    kind, header_bytes = data[5], struct.unpack_from("<H", data, 6)[0]
    header, payload = json.loads(data[16 : 16 + header_bytes]), data[16 + header_bytes :]
    way = rng.randrange(4)
    if way == 0:
        return framed(rng.choice(list(Kind)), header, payload)
    if way == 1 and payload:
        payload = spoiled_often(rng, payload)[: len(payload)].ljust(len(payload), rng.choice((b"\0", b"\xff")))
        return framed(kind, header, payload)
    return framed(kind, spoiled_json(rng, header), payload)


def decoding(rng: random.Random) -> None:
    """A spoiled stream, in pieces of any length: messages, then at most one refusal, and memory in bounds."""
    stream = b"".join(messages(1.0, 2.0) * 3)
    data = spoiled_often(rng, stream)
    decoder = Decoder(LARGEST_PAYLOAD_BYTES)
    with contextlib.suppress(FramingError):
        for piece in pieces(rng, data):
            for message in decoder.feed(piece):
                if isinstance(message, DepthImage):
                    assert 4 * message.depth_m.size <= LARGEST_PAYLOAD_BYTES
            assert 0 < decoder.get_buffer().nbytes <= LARGEST_PAYLOAD_BYTES


def pieces(rng: random.Random, data: bytes) -> Iterator[bytes]:
    """Cut as a network would."""
    at = 0
    while at < len(data):
        length = rng.choice((1, 7, 1000, 65_536))
        yield data[at : at + length]
        at += length


def driving(rng: random.Random) -> None:
    """What the driver makes of nonsense moves a vehicle that explores within its limits, and never without inputs."""
    asyncio.run(_driving(rng))


async def _driving(rng: random.Random) -> None:
    async with flying() as bench:
        bench.good = {"pose", "heartbeat"}
        receiver, line = _connected(bench)
        for _ in range(30):
            bench.step()
            bench.step()
            if line.closed:
                receiver, line = _connected(bench)
            receiver.ping()
            now_s = bench.clock.now_s()
            for data in messages(now_s + 500.0, now_s):
                draw = rng.random()
                _write(receiver, line, nonsense(rng, data) if draw < 0.2 else data)
                if draw > 0.97:
                    _write(receiver, line, spoiled_often(rng, data))
            bench.tick()
        line.closed = True
        for _ in range(30):
            bench.step()
            bench.step()
            record = bench.tick()
        assert Input.DEPTH in record.missing
        assert record.setpoint is not None
        assert (record.setpoint.speed_mps, record.setpoint.yaw_rate_radps) == (0.0, 0.0)
        with contextlib.suppress(asyncio.CancelledError):
            receiver.ended.cancel()


def _connected(bench: Flying) -> tuple[_Receiver, StalledTransport]:
    receiver, line = _Receiver(bench.sink, bench.clock), StalledTransport()
    receiver.connection_made(line)
    return receiver, line


def _write(receiver: _Receiver, line: StalledTransport, data: bytes) -> None:
    """As the socket does: into the buffer that the receiver gives."""
    rest = memoryview(data)
    while rest.nbytes and not line.closed:
        buffer = receiver.get_buffer(-1)
        count = min(rest.nbytes, buffer.nbytes)
        buffer[:count] = rest[:count]
        receiver.buffer_updated(count)
        rest = rest[count:]


def reconnecting(rng: random.Random) -> None:
    """Over real sockets: one connection after the other brings garbage, and the first good one is taken."""
    asyncio.run(_reconnecting(rng))


async def _reconnecting(rng: random.Random) -> None:
    clock = MonotonicClock()
    connections = 0
    enough = asyncio.Event()

    async def garbage(_reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        nonlocal connections
        connections += 1
        data = spoiled_often(rng, b"".join(messages(clock.now_s(), 0.0)))
        if connections >= 4:
            enough.set()
        with contextlib.suppress(ConnectionError):
            writer.write(data)
            await writer.drain()
        writer.close()

    server = await asyncio.start_server(garbage, "127.0.0.1", 0)
    port = server.sockets[0].getsockname()[1]
    url = f"tcp://127.0.0.1:{port}"
    sink = SensorSink(clock)
    driving_task = asyncio.create_task(StreamDriver(url, clock).run(sink))
    try:
        async with asyncio.timeout(20.0):
            await enough.wait()
            server.close()
            await server.wait_closed()
            async with StreamServer(url, CAMERA, clock) as good:
                before = sink.statistics(clock.now_s())["depth"].count
                while sink.statistics(clock.now_s())["depth"].count == before:
                    good.publish_depth(clock.now_s(), DEPTH_M)
                    await asyncio.sleep(0.01)
    finally:
        driving_task.cancel()
        await asyncio.gather(driving_task, return_exceptions=True)
