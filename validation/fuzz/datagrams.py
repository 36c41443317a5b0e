"""Bytes into the real link: garbage, floods, other people's messages. Afterwards it is as good as new."""

from __future__ import annotations

import asyncio
import random
import struct
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.interface import Message
from companion.autopilot.link import MavsdkLink
from companion.autopilot.telemetry import Telemetry
from companion.clock import MonotonicClock
from companion.config.settings import Settings
from companion.flight.events import EventEmitter
from companion.flight.mavlink_commands import MavlinkCommands, Refusals
from companion.flight.operator_commands import OperatorCommands
from companion.flight.phase import PhaseMachine
from tests.autopilot.loopback import Responder, linked
from tests.shared.beside import until
from validation.fuzz.hostile import spoiled_often

LARGEST_DATAGRAM = 65_507
GROWTH_MB = 150.0
"""The process may grow by this much under a flood: what has not been read yet waits in MAVSDK."""
RECOVERS_S = 10.0
RECEIVED = (
    "HEARTBEAT",
    "ATTITUDE",
    "LOCAL_POSITION_NED",
    "TIMESYNC",
    "STATUSTEXT",
    "COMMAND_LONG",
    "COMMAND_INT",
    "COMMAND_ACK",
    "PARAM_VALUE",
    "SYS_STATUS",
    "BATTERY_STATUS",
    "EXTENDED_SYS_STATE",
    "ESTIMATOR_STATUS",
    "AUTOPILOT_VERSION",
    "DISTANCE_SENSOR",
    "OBSTACLE_DISTANCE",
)
KINDS = {kind.msgname: (number, kind) for number, kind in mavlink.mavlink_map.items()}


def packed(rng: random.Random, name: str, payload: bytes, system_id: int, component_id: int) -> bytes:
    """A frame of MAVLink 2 whose checksum is right."""
    number, kind = KINDS[name]
    head = struct.pack(
        "<BBBBBBBHB", 253, len(payload), 0, 0, rng.randrange(256), system_id, component_id, number & 65535, number >> 16
    )
    crc = mavlink.x25crc(head[1:] + payload + bytes([kind.crc_extra])).crc
    return head + payload + struct.pack("<H", crc)


def random_frame(rng: random.Random, system_id: int, component_id: int) -> bytes:
    """Any bytes as the content of a message that is listened to, or of any other."""
    name = rng.choice(RECEIVED) if rng.random() < 0.8 else rng.choice(list(KINDS))
    size = KINDS[name][1].unpacker.size
    payload = rng.choice((rng.randbytes(size), b"\xff" * size, bytes(size), b"\xed\xa0\x80" * size))[:size]
    if rng.random() < 0.3:
        payload = payload[: rng.randrange(1, size + 1)]
    elif rng.random() < 0.1:
        payload += rng.randbytes(255 - size)  # longer than the message is, as of a later version
    return packed(rng, name, payload, system_id, component_id)


def datagram(rng: random.Random, received: list[bytes]) -> bytes:
    """One datagram that must change nothing."""
    way = rng.randrange(6)
    stranger = rng.choice(((2, 1), (255, 190), (0, 0), (1, 100), (200, 1)))
    if way == 0:
        return rng.randbytes(rng.choice((1, 12, 280, 1500, LARGEST_DATAGRAM)))
    if way == 1:
        return spoiled_often(rng, random_frame(rng, *stranger))[:LARGEST_DATAGRAM]
    if way == 2:
        frame = bytearray(random_frame(rng, 1, 1))
        frame[-1] ^= 1 + rng.randrange(255)
        return bytes(frame)
    if way == 3 and received:
        return rng.choice(received)
    if way == 4:
        return b"".join(random_frame(rng, *stranger) for _ in range(200))[:LARGEST_DATAGRAM]
    return random_frame(rng, *stranger)


class Line:
    """A link with everything that listens to it, and what it went through."""

    def __init__(self, link: MavsdkLink, autopilot: Responder) -> None:
        self.link, self.autopilot = link, autopilot
        self.clock = MonotonicClock()
        self.telemetry = Telemetry(link, self.clock, Settings())
        self.operator = OperatorCommands(by_command=False, flight=PhaseMachine())
        MavlinkCommands(self.operator, link, Refusals(EventEmitter(), self.clock))
        self.seen: list[Message] = []
        link.events("ATTITUDE", self._note)

    def _note(self, message: Message) -> None:
        del self.seen[:-100]
        self.seen.append(message)

    async def is_as_good_as_new(self) -> None:
        """The heartbeat is received, a command is answered, and what comes is not late."""
        heartbeats = self.link.watch("HEARTBEAT")
        count = heartbeats.count
        await until(lambda: heartbeats.count > count, "a heartbeat", RECOVERS_S)
        assert heartbeats.newest is not None
        assert (heartbeats.newest.system_id, heartbeats.newest.component_id) == (1, 1)
        assert await self.link.command(21, 1.0, timeout_s=RECOVERS_S) == 0
        await until(
            lambda: bool(self.seen) and abs(self.seen[-1].fields["yaw"] - self.autopilot.yaw_rad) < 1e-3,
            "the attitude of now",
            RECOVERS_S,
        )
        self.telemetry.state(self.clock.now_s())
        assert all(text.text.isprintable() for text in self.telemetry.texts)
        assert not self.operator.start.is_set()
        self.telemetry.ask(self.clock.now_s())


@asynccontextmanager
async def line() -> AsyncIterator[Line]:
    """A link over loopback to a small autopilot."""
    async with linked() as (link, autopilot):
        yield Line(link, autopilot)


def memory_mb() -> float:
    """Resident memory of this process."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * 4096 / 1e6


def garbage(rng: random.Random) -> None:
    """Hundreds of datagrams that mean nothing, from the autopilot's own port and from another one."""
    asyncio.run(_garbage(rng))


async def _garbage(rng: random.Random) -> None:
    async with line() as here:
        received = [true_frame(rng) for _ in range(20)]
        before_mb = memory_mb()
        with Responder(here.autopilot._target[1], "none", 77) as stranger:
            for i in range(600):
                rng.choice((here.autopilot, stranger)).raw(datagram(rng, received))
                if i % 20 == 0:
                    await asyncio.sleep(0.002)
        await here.is_as_good_as_new()
        assert memory_mb() - before_mb < GROWTH_MB


def true_frame(rng: random.Random) -> bytes:
    """A message of our autopilot as somebody may have recorded it."""
    attitude = KINDS["ATTITUDE"][1](rng.randrange(2000), 0.1, 0.2, 0.5, 0.0, 0.0, 0.0)
    return bytes(attitude.pack(mavlink.MAVLink(None, srcSystem=1, srcComponent=1)))


def own_content(rng: random.Random) -> None:
    """Any bytes in messages of our own autopilot: believed or not, they crash nothing and the link stays."""
    asyncio.run(_own_content(rng))


async def _own_content(rng: random.Random) -> None:
    async with line() as here:
        for i in range(600):
            here.autopilot.raw(random_frame(rng, 1, rng.choice((1, 1, 191))))
            if i % 20 == 0:
                await asyncio.sleep(0.002)
                here.telemetry.state(here.clock.now_s())
        await here.is_as_good_as_new()


def flood(rng: random.Random, per_s: int = 10_000, for_s: float = 2.0) -> None:
    """More messages than anybody can read, of ours and of others: memory stays in bounds, and the backlog goes."""
    asyncio.run(_flood(rng, per_s, for_s))


async def _flood(rng: random.Random, per_s: int, for_s: float) -> None:
    async with line() as here:
        before_mb, began_s = memory_mb(), time.monotonic()
        frames = [true_frame(rng) for _ in range(50)] + [random_frame(rng, 9, 1) for _ in range(50)]
        sent = 0
        while (now_s := time.monotonic() - began_s) < for_s:
            while sent < now_s * per_s:
                here.autopilot.raw(rng.choice(frames))
                sent += 1
            await asyncio.sleep(0.005)
        # A marker that only what comes after the backlog can show.
        here.autopilot.yaw_rad = 1.25
        await here.is_as_good_as_new()
        assert sent > 0.5 * per_s * for_s, "this computer is too slow to flood anything"
        assert memory_mb() - before_mb < GROWTH_MB, memory_mb() - before_mb
