"""Worlds of several vehicles in one mine: each tells the others where its vehicle truly is, so that they see it."""

from __future__ import annotations

import asyncio
import math
import struct
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import Any

from companion.control.separation import Spacing
from companion.errors import InputError
from companion.model import ABSURD, Pose
from sitl.scene.fellows import Body
from sitl.scene.live import LiveWorld
from sitl.sim.encounters import Encounters

LOOPBACK = "127.0.0.1"

PERIOD_S = 0.04
"""Time between two messages: at 1.5 m/s a vehicle is 6 cm further by then."""

_PLACE = struct.Struct("<4sB5d")
_MAGIC = b"MCNB"


@dataclass(frozen=True, slots=True)
class Neighbourhood:
    """Where the worlds of the other vehicles are.

    Attributes:
        number: of this world's vehicle.
        port: UDP port of this computer on which the others are heard.
        others: theirs.
    """

    number: int
    port: int
    others: tuple[int, ...]


class Neighbours:
    """The other vehicles of a mine, and how near they come.

    Args:
        number: of this world's vehicle.
        body: of each.
        spacing: how far from each other they are to be.
        live: where they are to be seen.
    """

    def __init__(self, number: int, body: Body, spacing: Spacing, live: LiveWorld) -> None:
        self._number = number
        self._body = body
        self._spacing = spacing
        self._live = live
        self._poses: dict[int, Pose] = {}
        self._encounters: dict[int, Encounters] = {}
        self._tell: Callable[[bytes], None] | None = None
        self._told_s = -math.inf

    def moved(self, pose: Pose) -> None:
        """This world's vehicle truly is there now: the others are told, and how near they are is noted."""
        for number, there in list(self._poses.items()):
            self._encounters[number].look((pose, there), 0.0)
        if self._tell is not None and pose.t_s - self._told_s >= PERIOD_S:
            self._told_s = pose.t_s
            self._tell(_PLACE.pack(_MAGIC, self._number, pose.t_s, pose.x_m, pose.y_m, pose.z_m, pose.yaw_rad))

    def on_message(self, data: bytes) -> None:
        """Where another one is; what is none of this is ignored."""
        if len(data) != _PLACE.size:
            return
        magic, number, *numbers = _PLACE.unpack(data)
        pose = Pose(*numbers)
        if magic != _MAGIC or number == self._number or not (pose.is_finite and abs(pose.z_m) < ABSURD):
            return
        self._encounters.setdefault(number, Encounters(self._body, self._spacing))
        self._poses[number] = pose
        self._live.look(pose, number)

    def figures(self) -> dict[str, object]:
        """What `companion sim` calls these figures in its summary."""
        met = list(self._encounters.values())
        least_m = min((one.least_apart_m for one in met), default=math.inf)
        return {
            "least_distance_between_vehicles_m": round(least_m, 3) if math.isfinite(least_m) else None,
            "collisions": sum(one.collisions for one in met),
        }

    @asynccontextmanager
    async def heard(self, neighbourhood: Neighbourhood) -> AsyncIterator[None]:
        """Hear and tell while the block lasts.

        Raises:
            InputError: the port is taken.
        """
        try:
            transport, _ = await asyncio.get_running_loop().create_datagram_endpoint(
                lambda: _Datagrams(self.on_message), local_addr=(LOOPBACK, neighbourhood.port)
            )
        except OSError as error:
            raise InputError(f"--neighbours-port {neighbourhood.port}: {error.strerror or error}") from error

        def tell(message: bytes) -> None:
            for port in neighbourhood.others:
                transport.sendto(message, (LOOPBACK, port))

        self._tell = tell
        try:
            yield
        finally:
            self._tell = None
            transport.close()


class _Datagrams(asyncio.DatagramProtocol):
    def __init__(self, on_message: Callable[[bytes], None]) -> None:
        self._on_message = on_message

    def datagram_received(self, data: bytes, addr: Any) -> None:  # noqa: ARG002 - as asyncio calls it
        self._on_message(data)

    def error_received(self, exc: Exception) -> None:
        """Another world that does not listen yet, or any more."""
