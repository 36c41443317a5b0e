"""The driver `stream`: depth and ranges from another process, over TCP or a Unix socket.

The other end, the world beside a simulator or a camera's own process, stamps with its own clock. Pings show where that
clock stands against ours, and every stamp is moved over before it reaches the sink.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable

from companion.clock import Clock, ClockAlignment
from companion.config.sensors import TcpAddress, parse_address
from companion.config.settings import Settings
from companion.errors import CompanionError
from companion.model import Camera, RangeReading
from companion.sensors.drivers.driver import DriverContext
from companion.sensors.drivers.framing import Decoder, FramingError, encode_ping
from companion.sensors.drivers.messages import DepthImage, Message, Ping, Pong, Ranges
from companion.sensors.sink import DEPTH, PLANAR, RawDepth, RawPlanar, SensorSink

NOT_ALIGNED = "clock of the sender not known yet"
NO_CAMERA = "depth before its camera"

CONNECT_TIMEOUT_S = 2.0
FIRST_DELAY_S, LONGEST_DELAY_S = 0.05, 1.0
"""Wait before the next attempt to connect: doubled after each failure."""

FAST_PINGS, FAST_PING_S, PING_S = 10, 0.5, 2.0
"""The first five seconds find the offset of the clocks, the rest of the time its drift."""

MOST_UNANSWERED = 3
"""Pings in a row with nothing at all coming back: the other end, or the connection to it, is gone."""

_log = logging.getLogger(__name__)


def create(settings: Settings, context: DriverContext) -> StreamDriver:
    """The entry point: a driver for ``sensors.stream.url``."""
    return StreamDriver(settings.sensors.stream.url, context.clock)


class StreamDriver:
    """Client of one sensor stream, which connects again whenever the connection ends.

    Args:
        url: `tcp://host:port` or `unix:///path`.

    Raises:
        InputError: the URL is none of these.
    """

    name = "stream"

    def __init__(self, url: str, clock: Clock) -> None:
        self._url = url
        self._address = parse_address(url)
        self._clock = clock
        self._receiver: _Receiver | None = None
        self.problem: str | None = "not started"
        """The reason why nothing arrives, for a person; None while connected."""

    @property
    def residual_s(self) -> float | None:
        """Bound of the error of the stamps; None while the clock of the other end is not known."""
        return None if self._receiver is None else self._receiver.alignment.residual_s(self._clock.now_s())

    async def run(self, sink: SensorSink) -> None:
        """Receive until cancelled. A stream that is not there, or not ours, is tried again up to a second later."""
        delay_s = FIRST_DELAY_S
        while True:
            receiver = _Receiver(sink, self._clock)
            try:
                await self._receive(receiver)
            except (OSError, FramingError) as error:
                self._report(f"{self._url}: {str(error) or type(error).__name__}")
            delay_s = FIRST_DELAY_S if receiver.count else delay_s
            await asyncio.sleep(delay_s)
            delay_s = min(2.0 * delay_s, LONGEST_DELAY_S)

    async def _receive(self, receiver: _Receiver) -> None:
        """One connection; raises what ended it."""
        try:
            async with asyncio.timeout(CONNECT_TIMEOUT_S):
                await self._connect(lambda: receiver)
            self._receiver = receiver
            await self._keep_pinging(receiver)
        except TimeoutError as error:
            raise ConnectionError(f"no connection within {CONNECT_TIMEOUT_S:g} s") from error
        finally:
            self._receiver = None
            await receiver.close()

    async def _connect(self, protocol: Callable[[], asyncio.BufferedProtocol]) -> None:
        loop, address = asyncio.get_running_loop(), self._address
        if isinstance(address, TcpAddress):
            await loop.create_connection(protocol, address.host, address.port)
        else:
            await loop.create_unix_connection(protocol, str(address.path))

    async def _keep_pinging(self, receiver: _Receiver) -> None:
        pings = unanswered = 0
        while unanswered < MOST_UNANSWERED:
            heard = receiver.count
            receiver.ping()
            pings += 1
            await asyncio.wait([receiver.ended], timeout=FAST_PING_S if pings <= FAST_PINGS else PING_S)
            if receiver.ended.done():
                raise receiver.ended.result()
            if receiver.count > heard:
                self._report(None)
            # Counted in pings, not seconds: after a hang of our own loop nobody else is to blame.
            unanswered = unanswered + 1 if receiver.count == heard else 0
        raise ConnectionError("nothing comes any more")

    def _report(self, problem: str | None) -> None:
        if problem == self.problem:
            return
        self.problem = problem
        if problem is None:
            _log.info("sensor stream connected: %s", self._url)
        else:
            _log.warning("no sensor stream: %s; trying again", problem)


class _Receiver(asyncio.BufferedProtocol):
    """One connection. The socket writes straight into the memory of the depth image."""

    def __init__(self, sink: SensorSink, clock: Clock) -> None:
        self.alignment = ClockAlignment()  # a new one for each connection: who answers may be another computer
        self.count = 0
        self.ended: asyncio.Future[Exception] = asyncio.get_running_loop().create_future()
        self._sink = sink
        self._clock = clock
        self._decoder = Decoder()
        self._camera: Camera | None = None
        self._transport: asyncio.Transport | None = None
        self._asked_s: float | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)  # noqa: S101 - what a stream connection has
        self._transport = transport

    def connection_lost(self, exc: Exception | None) -> None:
        if not self.ended.done():
            self.ended.set_result(exc or ConnectionError("closed by the other end"))

    def get_buffer(self, sizehint: int) -> memoryview:  # noqa: ARG002 - asyncio's
        return self._decoder.get_buffer()

    def buffer_updated(self, nbytes: int) -> None:
        try:
            message = self._decoder.received(nbytes)
            if message is not None:
                self._take(message)
        except FramingError as error:
            self._end(error)

    def ping(self) -> None:
        """Ask for the other end's time."""
        if self._transport is not None and not self._transport.is_closing():
            self._asked_s = self._clock.now_s()
            self._transport.write(encode_ping(Ping(self._asked_s)))

    async def close(self) -> None:
        """Close the connection, if there is one, and wait until its socket is gone."""
        if self._transport is not None:
            self._transport.abort()
            await asyncio.wait([self.ended], timeout=1.0)

    def _end(self, error: CompanionError) -> None:
        if not self.ended.done():
            self.ended.set_result(error)
        if self._transport is not None:
            self._transport.abort()

    def _take(self, message: Message) -> None:
        match message:
            case Camera():
                self._camera = message
            case Pong():
                self._align(message)
            case DepthImage():
                self._take_depth(message)
            case Ranges():
                self._take_ranges(message)
            case RawPlanar():
                self._take_planar(message)
            case Ping():
                raise FramingError("the other end sends pings: it wants to receive, not to send")
        self.count += 1

    def _align(self, pong: Pong) -> None:
        # Only the answer to the last question: a later or made-up one would move the clock.
        if pong.sent_s == self._asked_s:
            self._asked_s = None
            self.alignment.add(pong.sent_s, pong.remote_s, self._clock.now_s())

    def _take_depth(self, message: DepthImage) -> None:
        t_s = self.alignment.to_local_s(message.t_s)
        if t_s is None or self._camera is None:
            self._sink.drop(DEPTH, NOT_ALIGNED if t_s is None else NO_CAMERA)
            return
        self._sink.depth(RawDepth(t_s, message.depth_m, self._camera))

    def _take_ranges(self, message: Ranges) -> None:
        readings = []
        for r in message.readings:
            t_s = self.alignment.to_local_s(r.t_s)
            if t_s is None:
                self._sink.drop(r.beam.value, NOT_ALIGNED)
            else:
                readings.append(RangeReading(r.beam, t_s, r.range_m, r.max_range_m))
        self._sink.ranges(readings)

    def _take_planar(self, message: RawPlanar) -> None:
        t_s = self.alignment.to_local_s(message.t_s)
        if t_s is None:
            self._sink.drop(PLANAR, NOT_ALIGNED)
            return
        self._sink.planar(RawPlanar(t_s, message.bearings_rad, message.ranges_m, message.max_range_m))
