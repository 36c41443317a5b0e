"""The application's end of the link: gives telemetry, takes commands, and never waits for the other side.

The flight does not depend on the link. When its process dies it is started again, when it hangs it is killed first, and
what it does not take is lost.
"""

from __future__ import annotations

import asyncio
import logging
import math
import socket
import zlib
from collections.abc import Callable
from contextlib import suppress
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Protocol, Self

from companion.clock import Clock, MonotonicClock
from companion.config.link import LinkSettings
from companion.link.drawing import Drawing
from companion.link.vehicle.pipe import PACKET_BYTES, Kind, pair, receive, send
from companion.link.wire import Order, WireError, decoded, encoded
from companion.link.words import Answer, Command, Telemetry
from companion.mapping.process.supervisor import start

REST_S = (1.0, 2.0, 5.0, 10.0, 30.0)
"""Before another start, after each one that did not last."""

LASTED_S = 60.0
"""One that ran for so long begins the rests anew."""

LOADING_S = 60.0
HUNG_S = 5.0
"""A process that says nothing for this long hangs; while it loads it gets longer."""

_log = logging.getLogger(__name__)

Obey = Callable[[Command, str], Answer]
"""Does what an operator, whose name comes second, has ordered; what became of it."""


class FleetListener(Protocol):
    """What is given what other vehicles tell; it takes no longer than a tick may."""

    def on_message(self, data: bytes) -> None:
        """A message of one."""
        ...

    def on_refused(self, count: int, why: str) -> None:
        """So many were not let through, and why the last one."""
        ...


class LinkClient:
    """The link in a process of its own; an asynchronous context manager, which waits for nothing when it begins.

    Args:
        settings: of the link.
        journal: folder of the map's journal.
        obey: is given each command that may be obeyed; takes no longer than a tick may.
        tell: is given what operator and recording should know: commands that were refused, and what is wrong.
        clock: for the age of the ground.
        number: of this vehicle in its fleet; None: it flies alone.

    Attributes:
        restarts: how often its process was started again.
        fleet: is given what other vehicles tell; what comes before there is one is lost.
    """

    def __init__(
        self,
        settings: LinkSettings,
        journal: Path,
        obey: Obey,
        tell: Callable[[str], None],
        clock: Clock | None = None,
        number: int | None = None,
    ) -> None:
        self.restarts = 0
        self.fleet: FleetListener | None = None
        self._number = number
        self._settings = settings
        self._journal = journal.absolute()
        self._obey = obey
        self._tell = tell
        self._clock = clock or MonotonicClock()
        self._context = get_context("spawn")
        self._end: socket.socket | None = None
        self._task: asyncio.Task[None] | None = None
        self._closing = asyncio.Event()
        self._gone = asyncio.Event()
        self._heard_s = -math.inf
        self._beat_s = -math.inf
        self._trouble = ""

    async def __aenter__(self) -> Self:
        """Begin.

        Raises:
            InputError: the certificates cannot be used: nobody should take off with a link that can never be.
        """
        if self._settings.certificates is not None:
            await asyncio.to_thread(_check, self._settings.certificates, self._settings.name, self._number)
        self._task = asyncio.create_task(self._keep_running())
        return self

    async def __aexit__(self, *_: object) -> None:
        """End the process at once; `finish` before it, where the ground shall have everything."""
        self._closing.set()
        self._gone.set()
        if self._task is not None:
            await self._task

    @property
    def silent_s(self) -> float:
        """Since anybody at the ground was heard; infinite before. Grows also when the process is dead or hangs."""
        return self._clock.now_s() - self._heard_s

    def offer(self, telemetry: Telemetry) -> None:
        """Give the newest telemetry, which goes out if there is room for it."""
        if self._end is not None:
            send(self._end, Kind.TELEMETRY, encoded(telemetry))

    def tell_others(self, message: bytes, *, with_ground: bool) -> None:
        """Give the newest for the other vehicles, which goes out if there is room for it."""
        if self._end is not None:
            send(self._end, Kind.FLEET_GROUND if with_ground else Kind.FLEET, message)

    async def draw(self, drawing: Drawing) -> None:
        """Give graph and frontiers; they are made into bytes in a thread. What is too large does not go over."""
        data = await asyncio.to_thread(lambda: zlib.compress(drawing.encoded(), 1))
        if self._end is not None and len(data) < PACKET_BYTES:
            send(self._end, Kind.DRAWING, data)

    async def finish(self) -> None:
        """The flight is over: wait until those at the ground that hear it have the map, ``finish_s`` at most."""
        self._closing.set()
        if self._end is not None and send(self._end, Kind.END):
            with suppress(TimeoutError):
                await asyncio.wait_for(self._gone.wait(), self._settings.finish_s + HUNG_S)

    async def _keep_running(self) -> None:
        failures = 0
        while not self._closing.is_set():
            began_s = self._clock.now_s()
            try:
                await self._run_once()
            except OSError as error:
                _log.error("the process of the link cannot be started: %s", error.strerror)
            if self._closing.is_set():
                return
            failures = 0 if self._clock.now_s() - began_s > LASTED_S else failures
            rest_s = REST_S[min(failures, len(REST_S) - 1)]
            failures += 1
            with suppress(TimeoutError):
                await asyncio.wait_for(self._closing.wait(), rest_s)
            self.restarts += not self._closing.is_set()

    async def _run_once(self) -> None:
        """Start the process, take what it sends, and return when it is gone or hangs."""
        end, theirs = pair()
        self._gone.clear()
        arguments = (theirs, self._settings, self._journal, self._number)
        process = self._context.Process(target=_serve, args=arguments, name="link", daemon=True)
        try:
            # In a thread: starting takes tens of milliseconds.
            await asyncio.to_thread(start, process)
        except BaseException:
            end.close()
            raise
        finally:
            theirs.close()
        loop = asyncio.get_running_loop()
        self._beat_s = self._clock.now_s() + LOADING_S - HUNG_S
        self._end = end
        loop.add_reader(end.fileno(), self._take_one, end)
        try:
            while not self._gone.is_set() and self._clock.now_s() - self._beat_s < HUNG_S:
                with suppress(TimeoutError):
                    await asyncio.wait_for(self._gone.wait(), 1.0)
        finally:
            self._end = None
            loop.remove_reader(end.fileno())
            is_hung = not self._gone.is_set()
            end.close()
            self._gone.set()
            if not is_hung:
                await asyncio.to_thread(process.join, 3.0)
            process.kill()
            await asyncio.to_thread(process.join)
            if not self._closing.is_set():
                what = "hangs and was killed" if is_hung else f"died (exit code {process.exitcode})"
                _log.error("the process of the link %s; the flight goes on", what)
            process.close()

    def _take_one(self, end: socket.socket) -> None:
        # One of them: before the next the loop that steers has its turn.
        try:
            if (packet := receive(end)) is not None:
                self._on_packet(end, *packet)
        except EOFError:
            asyncio.get_running_loop().remove_reader(end.fileno())
            self._gone.set()

    def _on_packet(self, end: socket.socket, kind: Kind, data: bytes) -> None:
        match kind:
            case Kind.ORDER:
                order = decoded(Order, data)
                answer = self._obey(order.command, order.by)
                send(end, Kind.ANSWER, order.id.encode() + encoded(answer))
            case Kind.BEAT:
                self._beat_s = self._clock.now_s()
                self._heard_s = max(self._heard_s, self._beat_s - float(data))
            case Kind.FLEET:
                if self.fleet is not None:
                    self.fleet.on_message(data)
            case Kind.FLEET_REFUSED:
                count, _, why = data.decode().partition(" ")
                if self.fleet is not None:
                    self.fleet.on_refused(int(count), why)
            case Kind.REFUSED:
                self._tell(f"a command was refused: {data.decode()}")
            case Kind.TROUBLE:
                trouble = data.decode()
                if trouble != self._trouble:
                    self._tell(trouble)
                self._trouble = trouble
            case _:
                raise WireError(f"the process of the link sent what only the application sends: {kind.name}")


def _check(folder: str, name: str, number: int | None) -> None:
    # Loaded where certificates are used.
    from companion.link.certificates import vehicle_certificates

    vehicle_certificates(folder, name, number)


def _serve(*arguments: Any) -> None:
    # Loaded there and not here: the application needs nothing of it.
    from companion.link.vehicle.process import serve

    serve(*arguments)
