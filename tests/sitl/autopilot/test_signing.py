"""A link that is signed, on loopback: against the implementation of the vehicle's computer."""

from __future__ import annotations

import asyncio
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from companion.errors import InputError
from companion.mavlink.codec import Encoder, Framer, decode
from companion.mavlink.signing import Signer
from sitl.autopilot.codec import Signing
from sitl.cli.autopilot import autopilot
from tests.sitl.autopilot.test_endpoint import LOOPBACK, serving
from tests.sitl.cli.test_autopilot import START

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
