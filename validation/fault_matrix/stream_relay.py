"""The way between the world's sensor stream and the application's driver, in the hands of a test.

What the sensors say can be changed, held back or kept from arriving, depth and ranges each on their own. Pings and
their answers pass untouched, so the application knows the sender's clock as well as ever.
"""

from __future__ import annotations

import contextlib
import heapq
import itertools
import selectors
import socket
import struct
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from types import TracebackType

from companion.model import Camera
from companion.sensors.drivers.framing import PREFIX_BYTES, Decoder, encode_depth, encode_ranges
from companion.sensors.drivers.messages import DepthImage, Kind, Ranges

LOOPBACK = "127.0.0.1"
POLL_S = 0.02
CONNECT_S = 2.0
MOST_HELD = 500
"""Messages that wait for their time; with more than these the oldest go early."""
BUFFER_BYTES = 262_144
"""As the server has it: larger ones would keep old images for a slow reader."""

_LENGTHS = struct.Struct("<4sBBHI")


@dataclass(frozen=True, slots=True)
class Tampering:
    """What happens to one kind of message.

    Attributes:
        depth: makes another image of each, given its camera; None keeps it from arriving.
        ranges: the same for readings of beams.
        delay_s: how much later it arrives, with the stamps that it had.
    """

    depth: Callable[[DepthImage, Camera], DepthImage | None] | None = None
    ranges: Callable[[Ranges], Ranges | None] | None = None
    delay_s: float = 0.0


HONEST = Tampering()


class StreamRelay:
    """Lives in threads of its own while the block lasts: one listens, and two carry each connection.

    Args:
        to_server: TCP port of this computer on which the world offers its stream; it need not be there yet.

    Attributes:
        port: where the application connects to.
        depth: what happens to depth images; may be set at any time, from any thread.
        ranges: what happens to readings of beams.
        changed: messages that did not pass as they were: depth, ranges.
        errors: what a change raised, newest last; such a message is passed on as it was.
    """

    def __init__(self, to_server: int) -> None:
        self.depth = self.ranges = HONEST
        self.changed = [0, 0]
        self.errors: deque[BaseException] = deque(maxlen=20)
        self._server = (LOOPBACK, to_server)
        self._listener = socket.create_server((LOOPBACK, 0))
        self._listener.settimeout(POLL_S)
        self.port: int = self._listener.getsockname()[1]
        self._ways: list[_Way] = []
        self._cut = False
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._listen, name="stream-relay")

    @property
    def url(self) -> str:
        """For the application's settings."""
        return f"tcp://{LOOPBACK}:{self.port}"

    def __enter__(self) -> StreamRelay:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop.set()
        self._thread.join()
        self._listener.close()
        for way in self._ways:
            way.close()

    def cut(self) -> None:
        """Close what is connected, and hang up on everybody from now on."""
        self._cut = True
        for way in tuple(self._ways):
            way.hang_up()

    def _listen(self) -> None:
        while not self._stop.is_set():
            try:
                client, _ = self._listener.accept()
            except TimeoutError:
                continue
            self._end_old_ones()
            if self._cut:
                client.close()
                continue
            try:
                server = socket.create_connection(self._server, CONNECT_S)
            except OSError:
                # As if nobody listened: the application tries again.
                client.close()
                continue
            self._ways.append(_Way(self, client, server))

    def _end_old_ones(self) -> None:
        for way in [way for way in self._ways if way.ended]:
            way.close()
            self._ways.remove(way)


class _Way:
    """One connection of the application to the world, until either end goes."""

    def __init__(self, relay: StreamRelay, client: socket.socket, server: socket.socket) -> None:
        self.ended = False
        self._relay = relay
        self._client, self._server = client, server
        for end in (client, server):
            end.settimeout(None)
            end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        client.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, BUFFER_BYTES)
        self._camera: Camera | None = None
        self._held: list[tuple[float, int, bytes]] = []
        self._count = itertools.count()
        self._threads = [threading.Thread(target=self._carry, args=(work,)) for work in (self._up, self._down)]
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        """End it, and wait until it has ended."""
        self.hang_up()
        for thread in self._threads:
            thread.join()
        self._client.close()
        self._server.close()

    def hang_up(self) -> None:
        """End it; from any thread."""
        self.ended = True
        for end in (self._client, self._server):
            # Wakes whoever waits for it, also in the middle of sending.
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)

    def _carry(self, work: Callable[[], None]) -> None:
        try:
            with contextlib.suppress(OSError):
                work()
        finally:
            self.hang_up()

    def _up(self) -> None:
        while data := self._client.recv(4096):
            self._server.sendall(data)

    def _down(self) -> None:
        splitter = _Splitter()
        with selectors.DefaultSelector() as selector:
            selector.register(self._server, selectors.EVENT_READ)
            while not self.ended:
                if selector.select(POLL_S if self._held else None):
                    data = self._server.recv(BUFFER_BYTES)
                    if not data:
                        return
                    for kind, raw in splitter.messages(data):
                        self._take(kind, raw)
                self._send_what_is_due(time.monotonic())

    def _take(self, kind: int, raw: bytes) -> None:
        """One whole message of the server."""
        relay, delay_s = self._relay, 0.0
        changed: bytes | None = raw
        if kind == Kind.CAMERA:
            (self._camera,) = (message for message in Decoder().feed(raw) if isinstance(message, Camera))
        elif kind == Kind.DEPTH:
            delay_s = relay.depth.delay_s
            changed = self._asked(lambda: self._depth(raw), raw)
            relay.changed[0] += changed is not raw or delay_s > 0.0
        elif kind == Kind.RANGES:
            delay_s = relay.ranges.delay_s
            changed = self._asked(lambda: self._ranges(raw), raw)
            relay.changed[1] += changed is not raw or delay_s > 0.0
        if changed is not None and delay_s > 0.0:
            heapq.heappush(self._held, (time.monotonic() + delay_s, next(self._count), changed))
        elif changed is not None:
            self._client.sendall(changed)

    def _depth(self, raw: bytes) -> bytes | None:
        change, camera = self._relay.depth.depth, self._camera
        if change is None or camera is None:
            return raw
        (image,) = (message for message in Decoder().feed(raw) if isinstance(message, DepthImage))
        made = change(image, camera)
        return None if made is None else encode_depth(made.t_s, made.depth_m)

    def _ranges(self, raw: bytes) -> bytes | None:
        change = self._relay.ranges.ranges
        if change is None:
            return raw
        (readings,) = (message for message in Decoder().feed(raw) if isinstance(message, Ranges))
        made = change(readings)
        return None if made is None else encode_ranges(made.readings)

    def _asked(self, change: Callable[[], bytes | None], raw: bytes) -> bytes | None:
        try:
            return change()
        except Exception as error:  # noqa: BLE001 - a test reads what its own change raised; the stream goes on
            self._relay.errors.append(error)
            return raw

    def _send_what_is_due(self, now_s: float) -> None:
        while self._held and (self._held[0][0] <= now_s or len(self._held) > MOST_HELD):
            self._client.sendall(heapq.heappop(self._held)[2])


class _Splitter:
    """Cuts the stream into whole messages, without looking at what they say."""

    def __init__(self) -> None:
        self._rest = bytearray()

    def messages(self, data: bytes) -> Iterator[tuple[int, bytes]]:
        """Kind and bytes of each message that ``data`` completes."""
        self._rest += data
        while len(self._rest) >= PREFIX_BYTES:
            _, _, kind, header_bytes, payload_bytes = _LENGTHS.unpack_from(self._rest)
            size = PREFIX_BYTES + header_bytes + payload_bytes
            if len(self._rest) < size:
                return
            raw = bytes(self._rest[:size])
            del self._rest[:size]
            yield kind, raw
