"""The world's end of a MAVLink connection: bytes in, the few messages that matter out."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import urlsplit

from pymavlink.dialects.v20 import common as mavlink

from companion.clock import Clock
from companion.errors import InputError

log = logging.getLogger(__name__)

OnMessage = Callable[[Any, float], None]
"""Called with a decoded message and when it arrived, in s."""

_V1, _V2 = 0xFE, 0xFD
_SIGNED = 0x01
_LARGEST_UNSENT = 65536
"""What may wait in a connection before messages are dropped: old odometry is worth less than none."""
_RECONNECT_S = 1.0


@dataclass(slots=True)
class ConnectionCounts:
    """What came over the connection, for the status line."""

    decoded: int = 0
    malformed: int = 0
    unsent: int = 0
    other_systems: dict[int, int] = field(default_factory=dict)
    """How many messages of other vehicles came, by system id: at most 255 entries."""


def frames(buffer: bytearray) -> Iterator[bytearray]:
    """Takes whole MAVLink frames out of ``buffer``; what may still become one stays in it.

    Checksums are not looked at here: that costs more than the whole search, and most frames are not wanted.
    """
    while True:
        start = next((i for i, byte in enumerate(buffer) if byte in (_V1, _V2)), len(buffer))
        del buffer[:start]
        if len(buffer) < 3:
            return
        signature = 13 if buffer[0] == _V2 and buffer[2] & _SIGNED else 0
        length = buffer[1] + (8 if buffer[0] == _V1 else 12) + signature
        if len(buffer) < length:
            return
        yield buffer[:length]
        del buffer[:length]


class Decoder:
    """Decodes the wanted messages of one vehicle's autopilot, and counts the rest.

    Args:
        system_id: of the vehicle.
        wanted: ids of messages. Decoding is pure Python, and an autopilot sends hundreds a second.
        counts: where they are counted.
    """

    def __init__(self, system_id: int, wanted: frozenset[int], counts: ConnectionCounts) -> None:
        self._system_id = system_id
        self._wanted = wanted
        self._counts = counts
        self._mavlink = mavlink.MAVLink(None)

    def decode(self, frame: bytearray) -> Any | None:
        """The message; None when it is not wanted, of another vehicle, or broken."""
        if frame[0] == _V1:
            system, component, message = frame[3], frame[4], frame[5]
        else:
            system, component, message = frame[5], frame[6], frame[7] | frame[8] << 8 | frame[9] << 16
        if message not in self._wanted or component != mavlink.MAV_COMP_ID_AUTOPILOT1:
            return None
        try:
            decoded = self._mavlink.decode(frame)
        except mavlink.MAVError:
            self._counts.malformed += 1
            return None
        if system != self._system_id:
            self._counts.other_systems[system] = self._counts.other_systems.get(system, 0) + 1
            return None
        self._counts.decoded += 1
        return decoded


@dataclass(frozen=True, slots=True)
class PeerUrl:
    """Where somebody is met.

    Attributes:
        kind: ``udp`` (or ``udpin``) listens and answers to whoever sends; ``udpout`` and ``tcp`` go there.
        option: of the command line that says so, for messages.
    """

    kind: str
    host: str
    port: int
    option: str = "--truth"

    def __str__(self) -> str:
        return f"{self.kind}://{self.host}:{self.port}"

    @classmethod
    def of_truth(cls, url: str) -> PeerUrl:
        """Reads ``udp://HOST:PORT`` (``udpin`` is the same), ``udpout://HOST:PORT`` or ``tcp://HOST:PORT``.

        Raises:
            InputError: it is none of them.
        """
        found = cls._parse(url, "--truth", ("udp", "udpin", "udpout", "tcp"))
        if found is None:
            raise InputError(
                f"--truth {url}: give udp://HOST:PORT (listen there), udpout://HOST:PORT or tcp://HOST:PORT (go there)"
            )
        return found

    @classmethod
    def of_odometry(cls, url: str) -> PeerUrl:
        """Reads ``udpout://HOST:PORT``.

        Raises:
            InputError: it is something else.
        """
        found = cls._parse(url, "--odometry-to", ("udpout",))
        if found is None:
            raise InputError(f"--odometry-to {url}: give udpout://HOST:PORT, where somebody listens for odometry")
        return found

    @classmethod
    def _parse(cls, url: str, option: str, kinds: Collection[str]) -> PeerUrl | None:
        try:
            parts = urlsplit(url)
            port = parts.port
        except ValueError:
            return None
        if parts.scheme not in kinds or not parts.hostname or not port:
            return None
        return cls("udp" if parts.scheme == "udpin" else parts.scheme, parts.hostname, port, option)


class Connection:
    """One connection to one autopilot, or to somebody who passes on to it, over UDP or TCP; it comes back by itself.

    Args:
        url: where.
        system_id: of the vehicle; ours is the same, as of any part of it.
        wanted: ids of the messages that are decoded.
        clock: stamps what arrives.
        on_message: called in the event loop with each decoded message.
    """

    def __init__(
        self, url: PeerUrl, system_id: int, wanted: frozenset[int], clock: Clock, on_message: OnMessage
    ) -> None:
        self.counts = ConnectionCounts()
        self.mavlink = mavlink.MAVLink(self, system_id, mavlink.MAV_COMP_ID_VISUAL_INERTIAL_ODOMETRY)
        """Encodes and sends: its ``..._send`` methods write to this connection."""
        self._url = url
        self._clock = clock
        self._on_message = on_message
        self._decoder = Decoder(system_id, wanted, self.counts)
        self._datagrams: Any = None  # typeshed does not know get_write_buffer_size of it
        self._peer: Any = None
        self._stream: asyncio.StreamWriter | None = None

    async def run(self) -> None:
        """Keeps the connection until cancelled.

        Raises:
            InputError: the address cannot be listened on, or there is no such host.
        """
        if self._url.kind == "tcp":
            await self._run_stream()
        else:
            await self._run_datagrams()

    def write(self, data: bytes) -> None:
        """Sends at once, or drops and counts: there is nobody, or they do not keep up. Called by `mavlink`."""
        if self._stream is not None and self._stream.transport.get_write_buffer_size() < _LARGEST_UNSENT:
            self._stream.write(data)
        elif (
            self._datagrams is not None
            and self._peer is not None
            and self._datagrams.get_write_buffer_size() < _LARGEST_UNSENT
        ):
            self._datagrams.sendto(data, self._peer)
        else:
            self.counts.unsent += 1

    def on_datagram(self, data: bytes, sender: Any) -> None:
        """One datagram that has arrived. Who sends a good message of our vehicle is answered from then on."""
        if self._take(bytearray(data)) and self._url.kind == "udp":
            self._peer = sender

    def _take(self, buffer: bytearray) -> bool:
        received_s = self._clock.now_s()
        good = False
        for frame in frames(buffer):
            message = self._decoder.decode(frame)
            if message is not None:
                good = True
                self._on_message(message, received_s)
        return good

    async def _run_datagrams(self) -> None:
        url, loop = self._url, asyncio.get_running_loop()
        there = (url.host, url.port)
        try:
            if url.kind == "udp":
                transport, _ = await loop.create_datagram_endpoint(lambda: _Datagrams(self), local_addr=there)
            else:
                transport, _ = await loop.create_datagram_endpoint(lambda: _Datagrams(self), remote_addr=there)
        except OSError as error:
            raise InputError(f"{url.option} {url}: {error.strerror or error}") from error
        self._datagrams = transport
        try:
            if url.kind == "udpout":
                self._peer = transport.get_extra_info("peername")
            await asyncio.get_running_loop().create_future()
        finally:
            self._datagrams = None
            transport.close()

    async def _run_stream(self) -> None:
        url = self._url
        reported = False
        while True:
            try:
                reader, self._stream = await asyncio.open_connection(url.host, url.port)
            except OSError as error:
                if not reported:
                    log.info("%s: %s; trying again until it is there", url, error)
                reported = True
            else:
                reported = False
                await self._read(reader, self._stream)
            await asyncio.sleep(_RECONNECT_S)

    async def _read(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        buffer = bytearray()
        try:
            while data := await reader.read(4096):
                buffer += data
                self._take(buffer)
        except OSError as error:
            log.info("the connection to the autopilot broke: %s", error)
        finally:
            self._stream = None
            writer.close()


class _Datagrams(asyncio.DatagramProtocol):
    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    def datagram_received(self, data: bytes, addr: Any) -> None:
        self._connection.on_datagram(data, addr)

    def error_received(self, exc: Exception) -> None:
        # The autopilot is not there yet, or no longer: its messages tell when it is.
        log.debug("udp: %s", exc)
