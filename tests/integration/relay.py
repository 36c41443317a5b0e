"""The link between the autopilot and the gate in the hands of a test: records, cuts, drops, changes and forges."""

from __future__ import annotations

import math
import random
import selectors
import socket
import time
from collections import deque
from collections.abc import Callable
from typing import Any

from sitl.autopilot.codec import Decoder
from sitl.autopilot.mavlink import Message
from sitl.autopilot.mavlink import dialect as m
from tests.integration.seen import Seen
from tests.shared.beside import OwnThread

LOOPBACK = "127.0.0.1"
LARGEST = 65536
GROUND_STATION = (255, 190)

Alter = Callable[[Message], list[bytes] | None]
"""What becomes of one message: None leaves it as it is, an empty list drops it."""

_POLL_S = 0.02


def pack(message: Message, sender: tuple[int, int] = GROUND_STATION, sequence: int = 0) -> bytes:
    """One MAVLink 2 packet from this system and component."""
    mavlink = m.MAVLink(None, *sender)
    mavlink.seq = sequence
    packet: bytes = message.pack(mavlink)
    return packet


def repacked(message: Message) -> bytes:
    """A message that was received and then changed, as if its sender had said that."""
    header = message.get_header()
    return pack(message, (header.srcSystem, header.srcComponent), header.seq)


class UdpRelay(OwnThread):
    """Lives in a thread of its own while the block lasts.

    Args:
        to_gate: the UDP port on which the gate listens, or an application without one.
        lost_share: of the packets, each way.
        seed: draws which.
        port: to which the autopilot sends; by default a free one.

    Attributes:
        port: where the autopilot sends to.
        alter_down: what becomes of each message from the autopilot to the gate. Called in the relay's thread.
        dead: set it and nothing passes any more, either way.
        dead_up: the same for the way to the autopilot alone.
        stranger_received: datagrams that were sent to the address of `speak_down`'s stranger.
        lost_share: may be changed at any time.
        lost: packets that were not passed on: to the gate, to the autopilot.
        passed: packets that were: to the gate, to the autopilot.
        seen: what went by.
        errors: what `alter_down` raised, newest last; such a message is passed on as it was.
    """

    def __init__(self, to_gate: int, lost_share: float = 0.0, seed: int = 1, port: int = 0) -> None:
        self.alter_down: Alter | None = None
        self.dead = self.dead_up = False
        self.stranger_received = 0
        self.lost_share = lost_share
        self.lost, self.passed = [0, 0], [0, 0]
        self.errors: deque[BaseException] = deque(maxlen=20)
        self.seen = Seen()
        self._random = random.Random(seed)  # noqa: S311 - packet loss, no secret
        self._gate = (LOOPBACK, to_gate)
        self._autopilot: Any = None
        self._dead_until_s = -math.inf
        self._near, self._far, self._stranger = _socket(port), _socket(), _socket()
        self.port: int = self._near.getsockname()[1]
        self._speech: _Speech | None = None
        super().__init__("relay", self._near, self._far, self._stranger)

    def cut_for(self, duration_s: float) -> None:
        """Nothing passes, either way, for so long from now on."""
        self._dead_until_s = time.monotonic() + duration_s

    def send_down(self, data: bytes) -> None:
        """To the gate, on the way of the autopilot's messages: bytes of any kind."""
        self._sendto(self._far, data, self._gate)

    def send_up(self, data: bytes) -> None:
        """To the autopilot."""
        assert self._autopilot is not None, "nothing came from the autopilot"
        self._sendto(self._near, data, self._autopilot)

    def speak_down(self, say: Callable[[], bytes] | None, period_s: float = 0.1, *, as_stranger: bool = False) -> None:
        """Something of one's own to the gate from now on, again and again; None ends it.

        Args:
            say: the next datagram.
            period_s: between two.
            as_stranger: from another address than the autopilot's.
        """
        end = self._stranger if as_stranger else self._far
        self._speech = None if say is None else _Speech(say, period_s, end)

    def _run(self) -> None:
        with selectors.DefaultSelector() as selector:
            selector.register(self._near, selectors.EVENT_READ)
            selector.register(self._far, selectors.EVENT_READ)
            selector.register(self._stranger, selectors.EVENT_READ)
            while not self._stop.is_set():
                speech = self._speech
                for key, _ in selector.select(_POLL_S if speech is None else min(_POLL_S, speech.wait_s())):
                    if key.fileobj is self._stranger:
                        self._hear_as_stranger()
                    else:
                        self._pass_on(key.fileobj is self._far)
                if speech is not None and speech.wait_s() == 0.0:
                    self._sendto(speech.end, speech.next(), self._gate)

    def _hear_as_stranger(self) -> None:
        try:
            self._stranger.recvfrom(LARGEST)
        except OSError:
            # Nobody listened where it spoke.
            return
        self.stranger_received += 1

    def _pass_on(self, to_autopilot: bool) -> None:
        try:
            data, sender = (self._far if to_autopilot else self._near).recvfrom(LARGEST)
        except OSError:
            # Nobody listens yet at the other end.
            return
        now_s = time.monotonic()
        if not to_autopilot:
            self._autopilot = sender
        target = self._autopilot if to_autopilot else self._gate
        dead = self.dead or (to_autopilot and self.dead_up) or now_s < self._dead_until_s
        passes = not dead and target is not None
        passes = passes and self._random.random() >= self.lost_share
        if to_autopilot:
            for message in Decoder().messages(data):
                self.seen.up(message, now_s, passes)
        elif passes:
            data = self._altered(data, now_s)
        if not passes:
            self.lost[to_autopilot] += 1
        elif data:
            self.passed[to_autopilot] += 1
            self._sendto(self._near if to_autopilot else self._far, data, target)

    def _altered(self, data: bytes, now_s: float) -> bytes:
        """What the gate is given in the place of a datagram of the autopilot."""
        alter = self.alter_down
        if alter is None and not _is_heartbeat(data):
            return data
        parts, rest = [], data
        for message in Decoder().messages(data):
            raw = bytes(message.get_msgbuf())
            pieces = None if alter is None else self._asked(alter, message)
            before, _, rest = rest.partition(raw)
            parts += [before, *([raw] if pieces is None else pieces)]
            if pieces != [] and message.get_type() == "HEARTBEAT":
                self.seen.down(message, now_s)
        return b"".join([*parts, rest])

    def _asked(self, alter: Alter, message: Message) -> list[bytes] | None:
        try:
            return alter(message)
        except Exception as error:  # noqa: BLE001 - a test reads what its own hook raised; the link goes on
            self.errors.append(error)
            return None

    @staticmethod
    def _sendto(end: socket.socket, data: bytes, target: Any) -> None:
        try:
            end.sendto(data, target)
        except OSError:
            # A full buffer, or nobody there: a datagram that is lost.
            return


class _Speech:
    """Datagrams of one's own, at a steady pace."""

    def __init__(self, say: Callable[[], bytes], period_s: float, end: socket.socket) -> None:
        self.end = end
        self._say = say
        self._period_s = period_s
        self._due_s = time.monotonic()

    def wait_s(self) -> float:
        return max(0.0, self._due_s - time.monotonic())

    def next(self) -> bytes:
        self._due_s = max(self._due_s + self._period_s, time.monotonic() - self._period_s)
        return self._say()


def _is_heartbeat(data: bytes) -> bool:
    return data[:1] == b"\xfd" and data[7:10] == b"\0\0\0"


def _socket(port: int = 0) -> socket.socket:
    found = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    found.bind((LOOPBACK, port))
    found.setblocking(False)
    return found
