"""What comes and goes over the link: only ours, unchanged, and with the time at which it came."""

from __future__ import annotations

import asyncio
import math
import random
import time

import pytest

from companion.autopilot.interface import LinkError
from companion.autopilot.link import MavsdkLink
from companion.mavlink.firmware import AutopilotKind
from tests.autopilot.linked import LAND, flown, until
from tests.autopilot.responder import Responder, free_port


def test_of_several_vehicles_on_one_port_only_ours_is_heard() -> None:
    """Protects against flying by the attitude of another vehicle, or of another component of ours."""
    port = free_port()

    async def work(link: MavsdkLink) -> None:
        assert link.kind is AutopilotKind.ARDUPILOT
        stream = link.watch("ATTITUDE")
        senders: set[tuple[int, int]] = set()
        ours: set[int] = set()
        link.events("ATTITUDE", lambda message: senders.add((message.system_id, message.component_id)), anyone=True)
        link.events("ATTITUDE", lambda message: ours.add(message.system_id))
        await until(lambda: senders == {(1, 1), (7, 1), (7, 50)} and stream.count > 20)
        assert ours == {7}
        assert stream.newest is not None
        assert stream.newest.fields["yaw"] == pytest.approx(2.0)

    with Responder(port, "px4"), Responder(port, "none", 7, 50), Responder(port, "ardupilot", 7) as ours:
        ours.yaw_rad = 2.0
        flown(port, work, system_id=7)


def test_numbers_that_are_none_survive_in_both_directions() -> None:
    """Protects NaN, which MAVLink uses for "not set": as zero it would be a latitude and a heading."""
    port = free_port()

    async def work(link: MavsdkLink) -> None:
        stream = link.watch("ATTITUDE")
        await until(lambda: stream.newest is not None)
        assert stream.newest is not None
        assert math.isnan(stream.newest.fields["pitch"])
        assert stream.newest.fields["roll"] == pytest.approx(0.1)
        assert await link.command(LAND, 1.0, math.nan) == 0
        (command,) = [message for message in autopilot.named("COMMAND_LONG") if message.command == LAND]
        assert command.param1 == 1.0
        assert math.isnan(command.param2)
        assert command.param3 == 0.0

    with Responder(port) as autopilot:
        flown(port, work)


def test_what_is_sent_arrives_as_from_the_onboard_computer() -> None:
    """Protects our address, and the refusal of what cannot be put on the wire as asked."""
    port = free_port()

    async def work(link: MavsdkLink) -> None:
        link.send("NAMED_VALUE_FLOAT", {"time_boot_ms": 5, "name": "d", "value": 1.25})
        await until(lambda: bool(autopilot.named("NAMED_VALUE_FLOAT")))
        (message,) = autopilot.named("NAMED_VALUE_FLOAT")
        assert (message.get_srcSystem(), message.get_srcComponent()) == (1, 191)
        assert (message.name, message.value) == ("d", 1.25)
        for name, fields in (("NO_SUCH_MESSAGE", {}), ("ATTITUDE", {"yaw": math.inf}), ("ATTITUDE", {"yaw": object()})):
            with pytest.raises(LinkError, match=name):
                link.send(name, fields)

    with Responder(port) as autopilot:
        flown(port, work)


def test_a_dead_link_shows_in_the_age_of_the_heartbeats_only() -> None:
    """Protects the tick: sending to nobody must neither raise nor block."""
    port = free_port()

    async def work(link: MavsdkLink) -> None:
        heartbeats = link.watch("HEARTBEAT")
        await until(lambda: heartbeats.count > 0)
        autopilot.__exit__(None, None, None)
        await asyncio.sleep(0.5)
        begun_s = time.monotonic()
        for _ in range(20):
            link.send("NAMED_VALUE_FLOAT", {"time_boot_ms": 5, "name": "d", "value": 1.25})
        assert time.monotonic() - begun_s < 0.5
        assert heartbeats.age_s(time.monotonic()) > 0.4

    autopilot = Responder(port)
    autopilot.__enter__()
    flown(port, work)


def test_garbage_on_the_port_changes_nothing() -> None:
    """Protects the receiving thread from noise, truncated, corrupted and empty packets."""
    port = free_port()
    noise = random.Random(3)  # noqa: S311 - no secret

    async def work(link: MavsdkLink) -> None:
        stream = link.watch("ATTITUDE")
        texts: list[str] = []
        link.events("STATUSTEXT", lambda message: texts.append(message.fields["text"]))
        packed = autopilot._out.attitude_encode(99, 9.0, 9.0, 9.0, 9.0, 9.0, 9.0).pack(autopilot._out)
        for _ in range(300):
            autopilot.raw(noise.randbytes(noise.choice([0, 1, 12, 280, 1400])))
            damaged = bytearray(packed)
            damaged[noise.randrange(6, len(packed))] ^= 1 << noise.randrange(8)
            autopilot.raw(bytes(damaged))
            autopilot.raw(packed[: noise.randrange(len(packed))])
        count = stream.count

        def again() -> bool:
            # What ends like the beginning of a message swallows the next: so more than one is sent.
            autopilot._out.statustext_send(3, b"\xff\xfe not text \x00\x01")
            return stream.count > count + 10 and bool(texts)

        await until(again)
        assert stream.newest is not None
        assert stream.newest.fields["roll"] == pytest.approx(0.1)
        assert "not text" in texts[0]

    with Responder(port) as autopilot:
        flown(port, work)


def test_messages_keep_the_time_of_their_arrival_through_a_hang_of_the_loop() -> None:
    """Protects freshness: after a hang of our own loop, what came before it must look old."""
    port = free_port()

    async def work(link: MavsdkLink) -> None:
        stream = link.watch("ATTITUDE")
        arrivals: list[float] = []
        link.events("ATTITUDE", lambda message: arrivals.append(message.received_s))
        await until(lambda: stream.count > 5)
        begun_s = time.monotonic()
        time.sleep(0.5)  # noqa: ASYNC251 - the hang
        assert stream.age_s(time.monotonic()) < 0.2, "the newest came in while the loop hung"
        await asyncio.sleep(0.05)
        during = [arrival_s for arrival_s in arrivals if begun_s + 0.05 < arrival_s < begun_s + 0.45]
        assert len(during) >= 5, "each was stamped when it came, not when the loop went on"

    with Responder(port):
        flown(port, work)
