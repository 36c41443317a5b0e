"""What every link to an autopilot offers: messages, streams of which only the newest counts, questions and answers."""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from companion.errors import CompanionError
from companion.mavlink.firmware import AutopilotKind

RATE_WINDOW_S = 2.0
ARRIVALS = 1024
"""Arrival times kept for each stream: rates above 512 Hz are seen as 512 Hz."""


class LinkError(CompanionError):
    """The link to the autopilot is missing, silent or refused: says which link and what was expected of it."""


@dataclass(frozen=True, slots=True)
class Message:
    """One MAVLink message as it arrived.

    Attributes:
        name: as in the MAVLink definitions, for example ``"HEARTBEAT"``.
        fields: by name; a number that was not finite on the wire (infinite too) is NaN here.
        received_s: stamped when the bytes came in, in the receiving thread, not when somebody looked.
        system_id: of the sender.
        component_id: of the sender.
    """

    name: str
    fields: dict[str, Any]
    received_s: float
    system_id: int
    component_id: int


class Stream:
    """The newest message of one name, how old it is and how often it comes. Safe to fill from any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._arrivals_s: deque[float] = deque(maxlen=ARRIVALS)
        self.newest: Message | None = None
        self.count = 0

    def put(self, message: Message) -> None:
        """A message came in."""
        with self._lock:
            self.newest = message
            self.count += 1
            self._arrivals_s.append(message.received_s)

    def age_s(self, now_s: float) -> float:
        """Time since the newest came in, in s; infinite when none ever did."""
        newest = self.newest
        return math.inf if newest is None else now_s - newest.received_s

    def rate_hz(self, now_s: float) -> float:
        """Messages per second over the last two seconds."""
        with self._lock:
            recent = sum(1 for arrival_s in self._arrivals_s if arrival_s > now_s - RATE_WINDOW_S)
        return recent / RATE_WINDOW_S


Handler = Callable[[Message], None]


class Transport(Protocol):
    """Carries MAVLink frames, whole and in their order, between a link and the autopilot or who stands in for it."""

    def open(self, on_frames: Callable[[bytes], None]) -> None:
        """From now on call ``on_frames`` with what arrives, when it arrives, in a thread of its own."""
        ...

    def send(self, raw: bytes) -> None:
        """Send frames at once, from any thread. Never waits, never raises: what is not taken now is lost."""
        ...

    def close(self) -> None:
        """Call nobody any more, and wait for a call that has begun: what it leads to is about to be destroyed."""
        ...


class Link(Protocol):
    """A connection to the autopilot of one vehicle."""

    @property
    def kind(self) -> AutopilotKind:
        """Which firmware answered."""
        ...

    @property
    def arming_problems(self) -> tuple[str, ...]:
        """What the autopilot's own checks have against arming now, in its words; empty also where it does not tell."""
        ...

    @property
    def system_id(self) -> int:
        """Of the vehicle, and so of this application too."""
        ...

    def watch(self, name: str) -> Stream:
        """Messages of this name from the autopilot of our vehicle; the same stream for the same name."""
        ...

    def events(self, name: str, handler: Handler, anyone: bool = False) -> None:
        """Call ``handler`` with every message of this name, on the event loop, in order.

        At most 256 wait; when more come the oldest are dropped and counted. A handler that raises is logged.

        Args:
            name: of the message.
            handler: called with each.
            anyone: also from other systems and components, for example commands from a ground station.
        """
        ...

    def send(self, name: str, fields: Mapping[str, Any]) -> None:
        """Send one message at once, from us. None or NaN in a field goes out as NaN, MAVLink's "not set".

        Nobody hears whether it arrived: a link that has died shows in the age of the heartbeats. A field that is left
        out is zero.

        Raises:
            LinkError: the link was closed, or the message cannot be put on the wire as asked.
        """
        ...

    async def command(self, command: int, *params: float, timeout_s: float = 2.0) -> int:
        """Ask the autopilot for a MAV_CMD, as COMMAND_LONG, and give its MAV_RESULT.

        Raises:
            LinkError: no answer within ``timeout_s``.
        """
        ...

    async def get_param(self, name: str) -> float | int | None:
        """The value of a parameter; None when the autopilot has none of this name.

        Raises:
            LinkError: no answer at all.
        """
        ...

    async def set_param(self, name: str, value: float | int) -> None:
        """Set a parameter and read it back.

        Raises:
            LinkError: no answer, no such parameter, or another value came back.
        """
        ...
