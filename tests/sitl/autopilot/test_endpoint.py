"""The autopilot on loopback: who gets what, what garbage does, and a link that is signed."""

from __future__ import annotations

import asyncio
import socket
import subprocess
import sys
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from companion.clock import MonotonicClock
from companion.errors import InputError
from companion.mavlink.codec import Encoder, Framer, decode
from companion.mavlink.signing import Signer
from companion.model import Pose
from sitl.autopilot import PX4, Autopilot
from sitl.autopilot.codec import Decoder, Signing
from sitl.autopilot.endpoint import Endpoint
from sitl.autopilot.mavlink import Message
from sitl.autopilot.mavlink import dialect as m
from sitl.cli.autopilot import autopilot
from tests.sitl.autopilot.rig import command_long
from tests.sitl.cli.test_autopilot import START

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
            for text in (
                b"nonsense",
                b"battery nan",
                b"battery volts x",
                b"battery 30",
                b"battery volts 13.6",
                b"gps off",
                b"rc on",
                b"rc channel 0 2000",
                b"rc channel 17 2000",
                b"rc channel 8 x",
                b"rc channel 8 2000",
                b"takeover",
            ):
                hand.sendto(text, (LOOPBACK, endpoint.control_port or 0))
            for _ in range(500):
                await asyncio.sleep(0.01)
                if endpoint.autopilot.mode.name == "POSCTL":
                    break
            state = endpoint.autopilot.state
            assert endpoint.autopilot.mode.name == "POSCTL"
            assert endpoint.bad == 6
            assert (state.channels_us[6], state.channels_us[7]) == (1500, 2000)
            assert state.battery.percent == pytest.approx(30.0, abs=0.1)
            assert state.battery.voltage_v == 13.6
            assert not state.gps_present
            assert state.transmitter_on is True
            for text in (b"rc off", b"battery 40"):
                hand.sendto(text, (LOOPBACK, endpoint.control_port or 0))
            await asyncio.sleep(0.5)
    assert (state.battery.measured_v, state.transmitter_on) == (None, False)


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


# A link that is signed, on loopback: against the implementation of the vehicle's computer.


KEY, OTHER = bytes(range(1, 33)), bytes(range(2, 34))
ASK = 31_999
"""A command that nobody has: it is answered, and changes nothing."""


def asked() -> bytes:
    return Encoder(1, 192).pack("COMMAND_LONG", command=ASK, target_system=1, target_component=1)


async def answers(listener: socket.socket, ours: Signer, within_s: float) -> int:
    """How many answers to our question come, all else being checked on the way."""
    loop = asyncio.get_running_loop()
    found, until_s = 0, loop.time() + within_s
    while (left_s := until_s - loop.time()) > 0.0:
        try:
            data = await asyncio.wait_for(loop.sock_recv(listener, 4096), left_s)
        except TimeoutError:
            break
        for frame in Framer(datagram=True).frames(data):
            assert ours.accepts(frame.raw)
            found += (decode(frame) or {}).get("command") == ASK
    return found


async def test_everything_sent_is_signed_and_only_what_is_signed_is_accepted() -> None:
    """Unsigned, signed by another, and played again: counted, not answered; and none of it locks us out."""
    ours, stranger = Signer(KEY, 1, time.time), Signer(OTHER, 1, lambda: time.time() + 30.0)
    async with serving(signing=Signing(KEY)) as (endpoint, listener):
        to = (LOOPBACK, endpoint.udp_port or 0)
        good = ours.sign(asked())
        for raw in (asked(), stranger.sign(asked()), good, good):
            listener.sendto(raw, to)
        assert await answers(listener, ours, 0.5) == 1
        assert endpoint.bad == 3
        listener.sendto(ours.sign(asked()), to)
        assert await answers(listener, ours, 0.5) == 1
    assert endpoint.bad == 3


async def test_tcp_is_signed_too() -> None:
    """One key for all ways in."""
    ours = Signer(KEY, 1, time.time)
    with socket.socket() as free:
        free.bind((LOOPBACK, 0))
        port = free.getsockname()[1]
    async with serving(signing=Signing(KEY), tcp_port=port) as (endpoint, _):
        reader, writer = await asyncio.open_connection(LOOPBACK, endpoint.tcp_port)
        writer.write(asked() + ours.sign(asked()))
        framer, found = Framer(), 0
        while not found:
            for frame in framer.frames(await reader.read(4096)):
                assert ours.accepts(frame.raw)
                found += (decode(frame) or {}).get("command") == ASK
        writer.close()
        await writer.wait_closed()
    assert endpoint.bad == 1


@pytest.mark.parametrize(("key", "message"), [(None, "No such file"), (b"short", "holds no key")])
def test_a_key_that_cannot_be_used_is_named(key: bytes | None, message: str, tmp_path: Path) -> None:
    """Before anything listens without it."""
    path = tmp_path / "key"
    if key is not None:
        path.write_bytes(key)
        path.chmod(0o600)
    app = typer.Typer()
    app.command()(autopilot)
    result = CliRunner().invoke(app, ["--signing-key", str(path)])
    assert isinstance(result.exception, InputError)
    assert "--signing-key" in str(result.exception)
    assert message in str(result.exception)


def test_the_command_signs_with_the_key_of_the_file(tmp_path: Path) -> None:
    """As a process of its own, from a key as tools write it."""
    path = tmp_path / "key"
    path.write_text(KEY.hex() + "\n")
    path.chmod(0o600)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind((LOOPBACK, 0))
        listener.settimeout(60.0)
        to = f"{LOOPBACK}:{listener.getsockname()[1]}"
        process = subprocess.Popen([sys.executable, "-c", START, "--to", to, "--signing-key", str(path)])
        with process:
            try:
                assert Signer(KEY, 1, time.time).accepts(listener.recv(4096))
            finally:
                process.terminate()
