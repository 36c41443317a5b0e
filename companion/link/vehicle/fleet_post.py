"""What vehicles tell each other, in the process of the link: the newest goes first, and nothing piles up.

What waits is the newest of this vehicle and the newest of each other one; it is replaced by what is newer.
"""

from __future__ import annotations

import logging
import math
import socket
import threading
from collections.abc import Callable

import zenoh

from companion.clock import Clock
from companion.link.vehicle.fleet_guard import FleetGuard
from companion.link.vehicle.pipe import Kind, send, unread_bytes
from companion.link.wire import RefusedError, fleet_topic, vehicle_of

SHARE = 0.2
"""Of the bandwidth, for where this vehicle is; and as much again for what it has seen of the ground."""

MOST_UNREAD_BYTES = 50_000
"""While the application has left this much unread it gets no more of other vehicles: an order has to find room."""

_log = logging.getLogger(__name__)


class FleetPost:
    """Sends what this vehicle tells, and hands over what others tell.

    Args:
        end: of the socket pair, to the application.
        name: of this vehicle.
        guard: seals and opens.
        take: is told of the bytes that go out.
        bytes_per_s: the limit of bandwidth.
        clock: the time.
    """

    def __init__(
        self,
        end: socket.socket,
        name: str,
        guard: FleetGuard,
        take: Callable[[int], None],
        bytes_per_s: float,
        clock: Clock,
    ) -> None:
        self._end = end
        self._name = name
        self._guard = guard
        self._take = take
        self._share_bytes_per_s = SHARE * bytes_per_s
        self._clock = clock
        self._to_send: dict[bool, bytes] = {}
        self._next_s = {False: -math.inf, True: -math.inf}
        self._lock = threading.Lock()
        """Over the guard and what follows."""
        self._came: dict[int, bytes] = {}
        self._refused = 0
        self._why = ""

    def open(self, session: zenoh.Session) -> None:
        """Be heard, and hear."""
        self._publisher = session.declare_publisher(
            fleet_topic(self._name),
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.DATA_HIGH,
            express=True,
            allowed_destination=zenoh.Locality.REMOTE,
        )
        self._subscriber = session.declare_subscriber(
            fleet_topic("*"), self._on_sample, allowed_origin=zenoh.Locality.REMOTE
        )

    def offer(self, message: bytes, *, with_ground: bool) -> None:
        """The newest of this vehicle; it goes out with the next step that may send it."""
        self._to_send[with_ground] = message

    def step(self) -> None:
        """Send what may be sent, and hand over what waits."""
        for with_ground, message in list(self._to_send.items()):
            now_s = self._clock.now_s()
            if now_s < self._next_s[with_ground]:
                continue
            del self._to_send[with_ground]
            with self._lock:
                sealed = self._guard.sealed(message, now_s)
                copies = max(1, self._guard.others)
            size_bytes = copies * len(sealed)
            self._take(size_bytes)
            self._next_s[with_ground] = now_s + size_bytes / self._share_bytes_per_s
            self._publisher.put(sealed)
        with self._lock:
            self._hand_over()

    def tell_refused(self) -> None:
        """Tell the application how many were refused since it was last told."""
        with self._lock:
            if self._refused and send(self._end, Kind.FLEET_REFUSED, f"{self._refused} {self._why}".encode()):
                self._refused = 0

    def _on_sample(self, sample: zenoh.Sample) -> None:
        """In a thread of Zenoh's."""
        sender, data = vehicle_of(str(sample.key_expr)), sample.payload.to_bytes()
        with self._lock:
            try:
                opened = self._guard.opened(sender, data, self._clock.now_s())
            except RefusedError as refusal:
                self._refused += 1
                self._why = str(refusal)
                return
            if opened is not None:
                vehicle, message = opened
                self._came[vehicle] = message
                self._hand_over()

    def _hand_over(self) -> None:
        while self._came and unread_bytes(self._end) < MOST_UNREAD_BYTES:
            vehicle = next(iter(self._came))
            if not send(self._end, Kind.FLEET, self._came[vehicle]):
                return
            del self._came[vehicle]
