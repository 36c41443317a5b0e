"""A small autopilot on loopback, and a link over MAVSDK to it: no gate stands between the two."""

from __future__ import annotations

import contextlib
import socket
import struct
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.link import MavsdkLink
from companion.clock import MonotonicClock
from companion.config.autopilot import AutopilotSettings
from companion.mavlink.codec import checksum
from sitl.launch.processes import free_udp_ports
from tests.shared.beside import OwnThread

ARM, LAND = 400, 21
"""Two commands: what they do plays no part here."""
FLOAT, INT32 = 9, 6
EVENT, EVENT_CRC_EXTRA = 410, 160
FIRMWARE = {"px4": 12, "ardupilot": 3}


class Responder(OwnThread):
    """Sends to ``127.0.0.1:port`` and answers from there, in a thread, while the block lasts.

    Attributes:
        received: every message that came in.
        params: name -> (value, MAV_PARAM_TYPE).
        frozen: names of parameters that keep their value when they are set.
        answers: MAV_CMD -> for each arrival of the command, the results that it is acknowledged with: none is silence.
            A command without an entry is accepted.
        heartbeats: set to False for an autopilot that has gone quiet.
        yaw_rad: what its attitude says.
    """

    def __init__(self, port: int, firmware: str = "px4", system_id: int = 1, component_id: int = 1) -> None:
        self._firmware = firmware
        self._target = ("127.0.0.1", port)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.settimeout(0.01)
        super().__init__("responder", self._socket)
        self._out = mavlink.MAVLink(self, srcSystem=system_id, srcComponent=component_id)
        self.autopilot = FIRMWARE.get(firmware, 8)
        self.received: list[Any] = []
        self.params: dict[str, tuple[float, int]] = {}
        self.frozen: set[str] = set()
        self.answers: dict[int, list[list[int]]] = {}
        self.heartbeats = True
        self.yaw_rad = 0.5

    def write(self, data: bytes) -> None:
        """Where pymavlink puts what is to be sent."""
        self.raw(bytes(data))

    def raw(self, data: bytes) -> None:
        self._socket.sendto(data, self._target)

    def event(self, number: int, log_levels: int) -> None:
        """PX4's EVENT (410), which pymavlink does not know: time, sequence and arguments are zero."""
        payload = struct.pack("<IIHBBB", number, 0, 0, 0, 0, log_levels)
        header = struct.pack("<BBBBBBHB", len(payload), 0, 0, 0, 1, 1, EVENT & 0xFFFF, EVENT >> 16)
        crc = checksum(header + payload + bytes([EVENT_CRC_EXTRA]))
        self.raw(b"\xfd" + header + payload + struct.pack("<H", crc))

    def named(self, name: str) -> list[Any]:
        """Everything of this name that came in."""
        return [message for message in self.received if message.get_type() == name]

    def value(self, name: str) -> float:
        return self.params[name][0]

    def _run(self) -> None:
        incoming = mavlink.MAVLink(None)
        incoming.robust_parsing = True
        beats = 0
        while not self._stop.wait(0.01):
            if self.heartbeats and beats % 10 == 0:
                self._out.heartbeat_send(2, self.autopilot, 81, 0x60000, 3)
            if self.heartbeats:
                self._out.attitude_send(1000 + 10 * beats, 0.1, float("nan"), self.yaw_rad, 0.0, 0.0, 0.2)
            beats += 1
            while not self._stop.is_set():
                try:
                    data = self._socket.recv(4096)
                except (TimeoutError, ConnectionRefusedError):
                    break
                for message in incoming.parse_buffer(data) or []:
                    self.received.append(message)
                    self._answer(message)

    def _answer(self, message: Any) -> None:
        name = message.get_type()
        if name == "COMMAND_LONG":
            scripted = self.answers.get(message.command)
            results = [0] if scripted is None else (scripted.pop(0) if scripted else [])
            for result in results:
                self._out.command_ack_send(message.command, result)
        elif name == "PARAM_REQUEST_READ" and message.param_id in self.params:
            self._say(message.param_id)
        elif name == "PARAM_SET" and message.param_id in self.params:
            if message.param_id not in self.frozen:
                _, kind = self.params[message.param_id]
                self.params[message.param_id] = (self._decoded(message.param_value, kind), kind)
            self._say(message.param_id)

    def _say(self, name: str) -> None:
        value, kind = self.params[name]
        self._out.param_value_send(name.encode(), self._encoded(value, kind), kind, len(self.params), 0)

    def _encoded(self, value: float, kind: int) -> float:
        if kind == FLOAT or self._firmware != "px4":
            return value
        as_float: float = struct.unpack("<f", struct.pack("<i", int(value)))[0]
        return as_float

    def _decoded(self, value: float, kind: int) -> float:
        if kind == FLOAT or self._firmware != "px4":
            return value
        as_int: int = struct.unpack("<i", struct.pack("<f", value))[0]
        return as_int


class UdpTransport(OwnThread):
    """Listens on a port of loopback and answers whoever has spoken there. Implements `Transport`.

    Args:
        port: of 127.0.0.1.
    """

    def __init__(self, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.settimeout(0.01)
        super().__init__("udp transport", self._socket)
        self._port = port
        self._peers: set[tuple[str, int]] = set()
        self._on_frames: Callable[[bytes], None] = _nothing

    def open(self, on_frames: Callable[[bytes], None]) -> None:
        self._socket.bind(("127.0.0.1", self._port))
        self._on_frames = on_frames
        self.__enter__()

    def send(self, raw: bytes) -> None:
        for peer in tuple(self._peers):
            with contextlib.suppress(OSError):
                self._socket.sendto(raw, peer)

    def close(self) -> None:
        self._on_frames = _nothing
        self.__exit__(None, None, None)

    def _run(self) -> None:
        while not self._stop.is_set():
            try:
                data, peer = self._socket.recvfrom(65536)
            except OSError:
                continue
            self._peers.add(peer)
            self._on_frames(data)


def _nothing(_frames: bytes) -> None:
    """Nobody is there yet, or any more."""


def link_on(port: int, timeout_s: float = 20.0, system_id: int = 1) -> MavsdkLink:
    """A link that listens there, once its block is entered."""
    settings = AutopilotSettings(
        url=f"udpin://127.0.0.1:{port}", connect_timeout_s=timeout_s, system_id=system_id, command_timeout_s=2.0
    )
    return MavsdkLink(settings, MonotonicClock(), UdpTransport(port))


@asynccontextmanager
async def linked(firmware: str = "px4") -> AsyncIterator[tuple[MavsdkLink, Responder]]:
    """A link that is connected, and the autopilot at its other end."""
    (port,) = free_udp_ports(1)
    with Responder(port, firmware) as autopilot:
        async with link_on(port) as link:
            yield link, autopilot
