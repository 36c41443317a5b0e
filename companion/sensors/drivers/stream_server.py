"""The sending end of a sensor stream: for the world beside a simulator, and for camera processes of your own."""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import Sequence
from typing import Self

import numpy as np
from numpy.typing import NDArray

from companion.clock import Clock
from companion.config.sensors import TcpAddress, UnixAddress, parse_address
from companion.errors import InputError
from companion.model import Camera, FloatArray, RangeReading
from companion.sensors.drivers.framing import (
    Decoder,
    FramingError,
    encode_camera,
    encode_depth,
    encode_planar,
    encode_pong,
    encode_ranges,
)
from companion.sensors.drivers.messages import Ping, Pong

MOST_CLIENTS = 8
SILENT_S = 10.0
"""A client pings every two seconds; one silent for this long gives its place up to a new one."""

SMALL_BACKLOG_BYTES = 65_536
"""What may wait for a client besides one depth image. A client further behind misses what is sent meanwhile."""

SEND_BUFFER_BYTES = 262_144
"""The kernel's buffer: as large as it likes it would keep seconds of old images for a slow client."""


class StreamServer:
    """Offers depth and ranges to every process that connects.

        async with StreamServer("tcp://127.0.0.1:14600", camera, MonotonicClock()) as server:
            server.publish_depth(exposed_s, depth_m)

    Publishing never waits: a client that is slow misses messages, which are counted in ``skipped``. All methods are to
    be called on the event loop; another thread uses ``loop.call_soon_threadsafe(server.publish_depth, t_s, depth_m)``.

    Args:
        url: `tcp://host:port` (port 0: any free one, see ``url``) or `unix:///path`.
        camera: the camera of the depth images; None when there will be none.
        clock: the clock of the stamps.

    Raises:
        InputError: the URL is none of these.
    """

    def __init__(self, url: str, camera: Camera | None, clock: Clock) -> None:
        self._address = parse_address(url)
        self.url = url
        """The address that clients connect to."""
        self._camera = camera
        self._hello = b"" if camera is None else encode_camera(camera)
        self._clock = clock
        self._clients: set[_Client] = set()
        self._server: asyncio.Server | None = None
        self.skipped = 0

    @property
    def client_count(self) -> int:
        """The number of connected clients."""
        return len(self._clients)

    async def __aenter__(self) -> Self:
        """Begin to listen.

        Raises:
            InputError: the address is taken or not ours.
        """
        loop, address = asyncio.get_running_loop(), self._address
        try:
            if isinstance(address, TcpAddress):
                self._server = await loop.create_server(self._new_client, address.host, address.port)
            else:
                self._server = await loop.create_unix_server(self._new_client, str(address.path))
        except OSError as error:
            raise InputError(f"cannot offer a sensor stream at {self.url}: {error}") from error
        if isinstance(address, TcpAddress) and address.port == 0:
            port = self._server.sockets[0].getsockname()[1]
            host = f"[{address.host}]" if ":" in address.host else address.host
            self.url = f"tcp://{host}:{port}"
        return self

    async def __aexit__(self, *_: object) -> None:
        if self._server is not None:
            self._server.close()
            closing = [client.ended for client in self._clients]
            for client in list(self._clients):
                client.abort()
            if closing:
                await asyncio.wait(closing, timeout=1.0)
            await self._server.wait_closed()
        if isinstance(self._address, UnixAddress):
            self._address.path.unlink(missing_ok=True)

    def publish_depth(self, t_s: float, depth_m: NDArray[np.float32]) -> None:
        """Send a depth image of the server's camera.

        Args:
            t_s: when it was exposed.
            depth_m: (height, width) float32, in m along the optical axis; NaN: nothing measured there; at or beyond the
                camera's largest range: free out to there.

        Raises:
            ValueError: there is no camera, or shape or type do not fit it.
        """
        if self._camera is None or depth_m.shape != (self._camera.height_px, self._camera.width_px):
            raise ValueError(f"depth of shape {depth_m.shape} does not fit the camera {self._camera}")
        if self._clients:
            data = encode_depth(t_s, depth_m)
            self._send(data, SMALL_BACKLOG_BYTES)

    def publish_ranges(self, readings: Sequence[RangeReading]) -> None:
        """Send readings of single beams; `encode_ranges` says what is raised."""
        self._send_small(encode_ranges(readings))

    def publish_planar(self, t_s: float, bearings_rad: FloatArray, ranges_m: FloatArray, max_range_m: float) -> None:
        """Send one turn of a planar scanner; `encode_planar` says what is raised."""
        self._send_small(encode_planar(t_s, bearings_rad, ranges_m, max_range_m))

    def _send_small(self, data: bytes) -> None:
        image_bytes = 0 if self._camera is None else 4 * self._camera.width_px * self._camera.height_px
        self._send(data, image_bytes + 2 * SMALL_BACKLOG_BYTES)

    def _send(self, data: bytes, most_waiting_bytes: int) -> None:
        for client in self._clients:
            self.skipped += not client.send(data, most_waiting_bytes)

    def _new_client(self) -> _Client:
        return _Client(self._clock, self._hello, self._clients)


class _Client(asyncio.BufferedProtocol):
    """One connection: sends what it is given, answers pings."""

    def __init__(self, clock: Clock, hello: bytes, clients: set[_Client]) -> None:
        self.ended: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._clock = clock
        self._hello = hello
        self._clients = clients
        self._decoder = Decoder(largest_payload_bytes=0)
        self._transport: asyncio.Transport | None = None
        self._heard_s = clock.now_s()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)  # noqa: S101 - what a stream connection has
        self._transport = transport
        for client in list(self._clients) if len(self._clients) >= MOST_CLIENTS else []:
            client.abort_if_silent()
        if len(self._clients) >= MOST_CLIENTS:
            transport.abort()
            return
        with contextlib.suppress(OSError):
            transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
        self._clients.add(self)
        transport.write(self._hello)

    def connection_lost(self, exc: Exception | None) -> None:  # noqa: ARG002 - asyncio's
        self._clients.discard(self)
        if not self.ended.done():
            self.ended.set_result(None)

    def get_buffer(self, sizehint: int) -> memoryview:  # noqa: ARG002 - asyncio's
        return self._decoder.get_buffer()

    def buffer_updated(self, nbytes: int) -> None:
        self._heard_s = self._clock.now_s()
        try:
            message = self._decoder.received(nbytes)
        except FramingError:
            self.abort()
            return
        if isinstance(message, Ping):
            self.send(encode_pong(Pong(message.sent_s, self._clock.now_s())), SMALL_BACKLOG_BYTES)

    def send(self, data: bytes, most_waiting_bytes: int) -> bool:
        """Send unless more than ``most_waiting_bytes`` are still queued; whether it was sent."""
        transport = self._transport
        if transport is None or transport.is_closing() or transport.get_write_buffer_size() > most_waiting_bytes:
            return False
        transport.write(data)
        return True

    def abort(self) -> None:
        """Close at once."""
        self._clients.discard(self)
        if self._transport is not None:
            self._transport.abort()

    def abort_if_silent(self) -> None:
        """Close a connection on which nothing has been received for `SILENT_S`."""
        if self._clock.now_s() - self._heard_s > SILENT_S:
            self.abort()
