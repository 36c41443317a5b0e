"""Delivery of messages to those who asked for their names. Filled by the receiving thread, read by the event loop."""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable

from companion.autopilot.interface import Handler, Message, Stream
from companion.mavlink.ids import MavComponent

PENDING = 256
"""Messages that may wait for one handler."""

_logger = logging.getLogger(__name__)


class _Events:
    """Messages on their way to one handler: from any thread to the event loop, bounded."""

    def __init__(self, handler: Handler, anyone: bool) -> None:
        self._handler = handler
        self._lock = threading.Lock()
        self._waiting: deque[Message] = deque()
        self._scheduled = False
        self.anyone = anyone
        self.dropped = 0

    def put(self, message: Message, call_soon: Callable[[Callable[[], None]], None]) -> None:
        with self._lock:
            if len(self._waiting) >= PENDING:
                # The newest is what counts after a hang.
                self._waiting.popleft()
                self.dropped += 1
            self._waiting.append(message)
            if self._scheduled:
                return
            self._scheduled = True
        call_soon(self._drain)

    def _drain(self) -> None:
        with self._lock:
            messages = list(self._waiting)
            self._waiting.clear()
            self._scheduled = False
        for message in messages:
            try:
                self._handler(message)
            except Exception:
                # One malformed message, or a fault in one listener, must not keep it from the others.
                _logger.exception("handler of %s failed on %s", message.name, message.fields)


class Inbox:
    """Hands each message to the streams and handlers that asked for its name.

    Args:
        system_id: of our vehicle; its autopilot component is the only one that reaches streams and ordinary handlers.
        call_soon: runs a function on the event loop soon; called from the thread that receives.
    """

    def __init__(self, system_id: int, call_soon: Callable[[Callable[[], None]], None]) -> None:
        self._system_id = system_id
        self._call_soon = call_soon
        self._streams: dict[str, Stream] = {}
        self._events: dict[str, tuple[_Events, ...]] = {}

    def watch(self, name: str) -> Stream:
        """The stream of this name, from our autopilot only."""
        return self._streams.setdefault(name, Stream())

    def events(self, name: str, handler: Handler, anyone: bool = False) -> None:
        """Call ``handler`` with each message of this name."""
        # A new tuple, so that the receiving thread never sees a list that changes under it.
        self._events[name] = (*self._events.get(name, ()), _Events(handler, anyone))

    @property
    def dropped(self) -> int:
        """Messages that came faster than their handlers took them."""
        return sum(events.dropped for group in self._events.values() for events in group)

    def wants(self, name: str, system_id: int, component_id: int) -> bool:
        """Whether anybody listens for this: spares reading what other vehicles on the same port say."""
        if system_id == self._system_id and component_id == MavComponent.AUTOPILOT1:
            return True
        return any(events.anyone for events in self._events.get(name, ()))

    def put(self, message: Message) -> None:
        """A message came in, from anybody."""
        ours = message.system_id == self._system_id and message.component_id == MavComponent.AUTOPILOT1
        if ours and (stream := self._streams.get(message.name)) is not None:
            stream.put(message)
        for events in self._events.get(message.name, ()):
            if ours or events.anyone:
                events.put(message, self._call_soon)
