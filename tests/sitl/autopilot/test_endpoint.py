"""The autopilot on loopback: who gets what, and what garbage does."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from itertools import pairwise
from typing import Any

import pytest

from companion.clock import MonotonicClock
from companion.model import Pose
from sitl.autopilot import PX4, Autopilot
from sitl.autopilot.codec import Decoder
from sitl.autopilot.endpoint import Endpoint
from sitl.autopilot.mavlink import Message
from sitl.autopilot.mavlink import dialect as m
from tests.sitl.autopilot.rig import command_long

LOOPBACK = "127.0.0.1"


@asynccontextmanager
async def serving(**options: Any) -> AsyncIterator[tuple[Endpoint, socket.socket]]:
    """An endpoint that serves during the block, and a socket of ours to which it sends."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind((LOOPBACK, 0))
        listener.setblocking(False)
        vehicle = Autopilot(PX4, Pose(0.0, 0.0, 0.0, 0.0, 0.0), boot_s=0.2)
        endpoint = Endpoint(vehicle, MonotonicClock(), [listener.getsockname()], bind=(LOOPBACK, 0), **options)
        ready = asyncio.Event()
        task = asyncio.create_task(endpoint.run(ready.set))
        try:
            async with asyncio.timeout(25.0):
                await ready.wait()
                yield endpoint, listener
        finally:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)


async def receive(listener: socket.socket, wanted: str) -> Message:
    loop = asyncio.get_running_loop()
    while True:
        for message in Decoder().messages(await loop.sock_recv(listener, 4096)):
            if message.get_type() == wanted:
                return message


def packet(message: Message) -> bytes:
    data: bytes = message.pack(m.MAVLink(None, 1, 191))
    return data


async def test_udp_sends_telemetry_and_answers_whoever_talks() -> None:
    """The answer goes to who asked, and telemetry from then on too."""
    async with serving() as (endpoint, listener):
        assert (await receive(listener, "HEARTBEAT")).get_srcSystem() == 1
        stranger = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        stranger.setblocking(False)
        with stranger:
            stranger.bind((LOOPBACK, 0))
            stranger.sendto(packet(command_long(31_999)), (LOOPBACK, endpoint.udp_port or 0))
            assert (await receive(stranger, "COMMAND_ACK")).result == m.MAV_RESULT_UNSUPPORTED
            await receive(stranger, "ATTITUDE")


async def test_tcp_serves_the_same_and_survives_garbage() -> None:
    """A stream that begins with garbage still finds its messages."""
    with socket.socket() as free:
        free.bind((LOOPBACK, 0))
        port = free.getsockname()[1]
    async with serving(tcp_port=port) as (endpoint, _):
        reader, writer = await asyncio.open_connection(LOOPBACK, endpoint.tcp_port)
        writer.write(b"\xfd\x05garbage\x00\xff" * 50)
        for _ in range(10):
            writer.write(packet(command_long(31_999)))
        decoder, found = Decoder(), set[str]()
        while not {"COMMAND_ACK", "HEARTBEAT"} <= found:
            found |= {message.get_type() for message in decoder.messages(await reader.read(4096))}
        writer.close()
        await writer.wait_closed()
    assert endpoint.bad > 0


async def test_garbage_and_oversized_datagrams_are_counted_and_make_no_peer() -> None:
    """Whoever sends no message gets no telemetry."""
    async with serving() as (endpoint, listener):
        stranger = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        stranger.setblocking(False)
        with stranger:
            stranger.bind((LOOPBACK, 0))
            for data in (b"\xfd" * 40, b"", b"\x00" * 60_000, packet(command_long(31_999))[:-1]):
                stranger.sendto(data, (LOOPBACK, endpoint.udp_port or 0))
            await asyncio.sleep(0.3)
            await receive(listener, "HEARTBEAT")
            with pytest.raises(BlockingIOError):
                stranger.recv(4096)
    # The truncated one, the oversized one, and that of start bytes alone; an empty one holds nothing bad.
    assert endpoint.bad >= 3


async def test_a_test_can_be_the_pilot() -> None:
    """The control port stands for the transmitter; what it does not know changes nothing."""
    async with serving(control_port=0) as (endpoint, _):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as hand:
            for text in (b"nonsense", b"battery nan", b"battery 30", b"gps off", b"takeover"):
                hand.sendto(text, (LOOPBACK, endpoint.control_port or 0))
            for _ in range(500):
                await asyncio.sleep(0.01)
                if endpoint.autopilot.mode.name == "POSCTL":
                    return
    assert endpoint.autopilot.mode.name == "POSCTL"
    assert endpoint.bad == 2
    assert endpoint.autopilot.state.battery.percent == pytest.approx(30.0, abs=0.1)
    assert not endpoint.autopilot.state.gps_present


async def test_a_lossy_link_loses_about_its_share() -> None:
    """Both ways; here what leaves."""
    async with serving(drop_share=0.3) as (endpoint, listener):
        sequence: list[int] = []
        loop = asyncio.get_running_loop()
        while len(sequence) < 200:
            received = Decoder().messages(await loop.sock_recv(listener, 4096))
            sequence += [message.get_seq() for message in received]
        lost = sum((b - a) % 256 - 1 for a, b in pairwise(sequence))
        # 200 of about 286 arrive: five sigmas of the binomial are 30.
        assert 50 < lost < 130
        assert endpoint.udp_port
