"""What goes wrong with the tracking camera while it runs, by command of a test."""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, replace
from typing import Any

from companion.errors import InputError
from companion.model import Pose

log = logging.getLogger(__name__)

LOOPBACK = "127.0.0.1"
KNOWN = "odometry good | lost | frozen | diverging M/S | jump M"
LARGEST = 100.0
LONGEST = 64
"""Bytes of a command."""


@dataclass(frozen=True, slots=True)
class Trouble:
    """What is wrong from a moment on.

    Attributes:
        lost: nothing comes any more.
        frozen: the last estimate again and again, each time with a new stamp.
        diverging_mps: the tracker believes to move backwards, as the vehicle looked when it began, by so much more than
            it does. A vehicle that is held by it moves forward by as much.
        jump_m: the position leaps to the left by so much, and no reset is counted.
    """

    lost: bool = False
    frozen: bool = False
    diverging_mps: float = 0.0
    jump_m: float = 0.0

    @classmethod
    def parse(cls, text: str) -> Trouble:
        """Read a command, as in `KNOWN`.

        Raises:
            InputError: it is none of them, or its number is not finite or too large.
        """
        match text.split():
            case ["odometry", "good"]:
                return cls()
            case ["odometry", "lost"]:
                return cls(lost=True)
            case ["odometry", "frozen"]:
                return cls(frozen=True)
            case ["odometry", "diverging", number]:
                return cls(diverging_mps=_number(number))
            case ["odometry", "jump", number]:
                return cls(jump_m=_number(number))
            case _:
                raise InputError(f"{text!r}: the world knows {KNOWN}")


class Troubled:
    """Makes of good estimates what the tracker would say."""

    def __init__(self) -> None:
        self.now = Trouble()
        self._began: Pose | None = None
        self._last: Pose | None = None

    def begin(self, trouble: Trouble) -> None:
        """From the next estimate on."""
        self.now, self._began = trouble, None

    def of(self, estimated: Pose) -> Pose:
        """What is said instead of a good estimate; both in the mine."""
        if self._began is None:
            self._began = estimated
        if self.now.frozen and self._last is not None:
            return replace(self._last, t_s=estimated.t_s)
        forward, left = _axes(self._began.yaw_rad)
        back_mps = self.now.diverging_mps
        back_m = back_mps * (estimated.t_s - self._began.t_s)
        self._last = replace(
            estimated,
            x_m=estimated.x_m - back_m * forward[0] + self.now.jump_m * left[0],
            y_m=estimated.y_m - back_m * forward[1] + self.now.jump_m * left[1],
            vx_mps=estimated.vx_mps - back_mps * forward[0],
            vy_mps=estimated.vy_mps - back_mps * forward[1],
        )
        return self._last


@asynccontextmanager
async def commanded(port: int | None, begin: Callable[[Trouble], None]) -> AsyncIterator[None]:
    """Listens for commands on a UDP port of this computer while the block lasts; without a port it does not.

    Args:
        port: where.
        begin: takes what they ask for. What is none of them is told and ignored.

    Raises:
        InputError: the port is taken.
    """
    if port is None:
        yield
        return
    try:
        listener, _ = await asyncio.get_running_loop().create_datagram_endpoint(
            lambda: _Commands(begin), local_addr=(LOOPBACK, port)
        )
    except OSError as error:
        raise InputError(f"--control {port}: {error.strerror or error}") from error
    try:
        yield
    finally:
        listener.close()


class _Commands(asyncio.DatagramProtocol):
    def __init__(self, begin: Callable[[Trouble], None]) -> None:
        self._begin = begin

    def datagram_received(self, data: bytes, addr: Any) -> None:  # noqa: ARG002 - as asyncio calls it
        try:
            self._begin(Trouble.parse(data[:LONGEST].decode("ascii", "replace")))
        except InputError as error:
            log.warning("%s", error)


def _axes(yaw_rad: float) -> tuple[tuple[float, float], tuple[float, float]]:
    forward = (math.cos(yaw_rad), math.sin(yaw_rad))
    return forward, (-forward[1], forward[0])


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not abs(value) <= LARGEST:  # also refuses NaN
        raise InputError(f"{text!r}: must be a number from {-LARGEST:g} to {LARGEST:g}; the world knows {KNOWN}")
    return value
