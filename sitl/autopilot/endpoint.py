"""The autopilot on the network: UDP to configured addresses and to every sender, TCP as a server, in real time."""

from __future__ import annotations

import asyncio
import logging
import math
import random
from collections.abc import Callable, Iterable
from contextlib import AsyncExitStack

from companion.clock import Clock
from sitl.autopilot.codec import LARGEST_DATAGRAM, Decoder, Encoder, Signing
from sitl.autopilot.core import STEP_S, Autopilot
from sitl.autopilot.mavlink import Message
from sitl.autopilot.routing import Routes
from sitl.autopilot.state import CHANNELS

log = logging.getLogger(__name__)

Address = tuple[str, int]
Way = Address | asyncio.StreamWriter
"""A connection: a UDP address, or a TCP client."""
_MOST_PEERS = 16
_MOST_CLIENTS = 8
_SILENT_PEER_S = 30.0
_LONGEST_US = 65535.0
_UNSENT_BYTES = 1 << 18
_CONTROL_COMMANDS = (
    "takeover, rc on, rc off, rc channel NUMBER MICROSECONDS, battery PERCENT, battery volts VOLTS, gps on, gps off"
)


class Endpoint:
    """Serves one autopilot.

    Args:
        autopilot: the vehicle.
        clock: real time.
        to: where telemetry goes from the beginning.
        bind: own UDP address; port 0 for any.
        tcp_port: where to listen for TCP, at ``bind``'s host; ``None`` for not at all.
        control_port: loopback UDP port for text commands from a test; ``None`` for none.
        drop_share: of packets lost, each way.
        speed: simulated time per real time.
        clock_rate: how fast the autopilot's clock, and with it the vehicle, runs; a simulator that cannot keep up is
            slower than 1.
        signing: ``None``: nothing is signed, and signatures are not looked at.
    """

    def __init__(
        self,
        autopilot: Autopilot,
        clock: Clock,
        to: Iterable[Address],
        *,
        bind: Address = ("127.0.0.1", 0),
        tcp_port: int | None = None,
        control_port: int | None = None,
        drop_share: float = 0.0,
        speed: float = 1.0,
        clock_rate: float = 1.0,
        signing: Signing | None = None,
    ) -> None:
        self.autopilot = autopilot
        self.bad = 0
        """Pieces of data that were no message, or one refused for its signature."""
        self.udp_port: int | None = None
        """The port in use, once `run` has begun."""
        self.tcp_port: int | None = None
        self.control_port: int | None = None
        self._clock = clock
        self._to = tuple(to)
        self._bind = bind
        self._wanted_tcp_port = tcp_port
        self._wanted_control_port = control_port
        self._drop_share = drop_share
        self._speed = speed * clock_rate
        self._random = random.Random(1)  # noqa: S311 - packet loss, no secret
        self._signing = signing
        self._encoder = Encoder(autopilot.system_id, signing)
        self._routes: Routes[Way] = Routes(autopilot.system_id, autopilot.personality.texts_only_to_ground_stations)
        self._peers_s: dict[Address, float] = {}
        self._clients: set[asyncio.StreamWriter] = set()
        self._udp: asyncio.DatagramTransport | None = None
        self._zero_s = clock.now_s()

    def _now_s(self) -> float:
        """Simulated time since the start."""
        return (self._clock.now_s() - self._zero_s) * self._speed

    async def run(self, ready: Callable[[], None] = lambda: None) -> None:
        """Serves until cancelled.

        Args:
            ready: called once everything listens.

        Raises:
            OSError: a port is taken.
        """
        loop = asyncio.get_running_loop()
        async with AsyncExitStack() as stack:
            transport, _ = await loop.create_datagram_endpoint(lambda: _Datagrams(self._datagram), self._bind)
            stack.callback(transport.close)
            self._udp, self.udp_port = transport, transport.get_extra_info("sockname")[1]
            if self._wanted_control_port is not None:
                control, _ = await loop.create_datagram_endpoint(
                    lambda: _Datagrams(self._control), ("127.0.0.1", self._wanted_control_port)
                )
                stack.callback(control.close)
                self.control_port = control.get_extra_info("sockname")[1]
            if self._wanted_tcp_port is not None:
                server = await asyncio.start_server(self._client, self._bind[0], self._wanted_tcp_port)
                stack.callback(self._hang_up)
                stack.callback(server.close)
                self.tcp_port = server.sockets[0].getsockname()[1]
            ready()
            await self._tick()

    async def _tick(self) -> None:
        due_s = self._clock.now_s()
        while True:
            for message in self.autopilot.step(self._now_s()):
                self._broadcast(message)
            # No catching up on ticks that were missed: the autopilot does its steps itself.
            due_s = max(due_s + STEP_S, self._clock.now_s())
            await asyncio.sleep(max(0.0, due_s - self._clock.now_s()))

    def _broadcast(self, message: Message) -> None:
        packet, now_s = self._encoder.bytes(message), self._now_s()
        ways: set[Way] = {*self._to, *self._peers_s, *self._clients}
        for way in ways:
            if self._routes.takes(way, message, now_s):
                self._send(way, packet)

    def _send(self, way: Way, packet: bytes) -> None:
        if self._lost():
            return
        if isinstance(way, asyncio.StreamWriter):
            self._write(way, packet)
        elif self._udp is not None:
            self._udp.sendto(packet, way)

    def _write(self, writer: asyncio.StreamWriter, packet: bytes) -> None:
        if writer.transport.get_write_buffer_size() > _UNSENT_BYTES:
            log.warning("a TCP client does not read: hung up")
            self._clients.discard(writer)
            writer.transport.abort()
        elif not writer.is_closing():
            writer.write(packet)

    def _datagram(self, data: bytes, address: Address) -> None:
        if len(data) > LARGEST_DATAGRAM:
            self.bad += 1
            return
        decoder = Decoder(self._signing)
        messages = decoder.messages(data)
        self.bad += decoder.bad + decoder.unfinished
        if messages:
            self._remember(address)
        self._received(messages, address)

    def _remember(self, address: Address) -> None:
        """A sender gets telemetry, as long as it goes on sending."""
        now_s = self._clock.now_s()
        if address in self._to:
            return
        gone = [who for who, t_s in self._peers_s.items() if now_s - t_s >= _SILENT_PEER_S]
        self._routes.forget(gone)
        self._peers_s = {who: t_s for who, t_s in self._peers_s.items() if who not in gone}
        if address in self._peers_s or len(self._peers_s) < _MOST_PEERS:
            self._peers_s[address] = now_s

    def _received(self, messages: list[Message], way: Way) -> None:
        """Takes messages that came in on ``way``, answers there, and forwards what is for others."""
        for message in messages:
            if self._lost():
                continue
            now_s = self._now_s()
            self._routes.heard(way, message, now_s)
            onward = self._routes.onward(way, message)
            for other in onward:
                self._send(other, bytes(message.get_msgbuf()))
            for answer in self.autopilot.receive(message, now_s, routed=bool(onward)):
                self._send(way, self._encoder.bytes(answer))

    async def _client(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if len(self._clients) >= _MOST_CLIENTS:
            writer.close()
            return
        self._clients.add(writer)
        decoder = Decoder(self._signing)
        try:
            while data := await reader.read(LARGEST_DATAGRAM):
                self._received(decoder.messages(data), writer)
        except OSError:
            log.info("a TCP client went away")
        finally:
            self.bad += decoder.bad
            self._clients.discard(writer)
            self._routes.forget([writer])
            writer.close()

    def _hang_up(self) -> None:
        for writer in tuple(self._clients):
            writer.transport.abort()

    def _control(self, data: bytes, _address: Address) -> None:
        """A test's hand on the vehicle: the transmitter, the battery, the GPS antenna."""
        words, battery = data[:64].decode("ascii", "replace").split(), self.autopilot.state.battery
        if words == ["takeover"]:
            self.autopilot.pilot_takes_over()
        elif words in (["gps", "on"], ["gps", "off"]):
            self.autopilot.set_gps(words[1] == "on")
        elif words in (["rc", "on"], ["rc", "off"]):
            self.autopilot.set_transmitter(words[1] == "on")
        elif len(words) == 4 and words[:2] == ["rc", "channel"] and (moved := _channel(*words[2:])) is not None:
            self.autopilot.set_channel(*moved)
        elif len(words) == 2 and words[0] == "battery" and (percent := _number(words[1], 100.0)) is not None:
            battery.percent, battery.measured_v = percent, None
        elif len(words) == 3 and words[:2] == ["battery", "volts"] and (volts := _number(words[2], 60.0)) is not None:
            battery.measured_v = volts
        else:
            self.bad += 1
            log.warning("control knows: %s", _CONTROL_COMMANDS)

    def _lost(self) -> bool:
        return self._drop_share > 0.0 and self._random.random() < self._drop_share


class _Datagrams(asyncio.DatagramProtocol):
    """Hands on what arrives. Nobody listening at the other end is no error."""

    def __init__(self, received: Callable[[bytes, Address], None]) -> None:
        self._received = received

    def datagram_received(self, data: bytes, addr: Address) -> None:
        self._received(data, addr)

    def error_received(self, exc: Exception) -> None:
        log.debug("%s", exc)


def _channel(number: str, pulse_us: str) -> tuple[int, int] | None:
    which, pulse = _number(number, CHANNELS), _number(pulse_us, _LONGEST_US)
    return None if not which or pulse is None else (int(which), int(pulse))


def _number(text: str, most: float) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) and 0.0 <= value <= most else None
