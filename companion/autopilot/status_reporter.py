"""Our own words on the link: heartbeat with the true state, texts for the pilot, and a few numbers to plot."""

from __future__ import annotations

import contextlib
import math
from collections import deque

from companion.autopilot.interface import Link, LinkError
from companion.clock import Clock
from companion.mavlink.ids import MAVLINK_VERSION, MavAutopilot, MavModeFlag, MavSeverity, MavState, MavType

HEARTBEAT_PERIOD_S = 1.0
VALUES_PERIOD_S = 0.5
TEXT_PERIOD_S = 1.0
TICK_S = 0.1
WAITING = 8
"""Texts that may wait for their turn; the newest are kept."""
TEXT_BYTES = 50
NAME_BYTES = 10


class StatusReporter:
    """Sends HEARTBEAT once a second, STATUSTEXT at most once a second, and NAMED_VALUE_FLOAT twice a second.

    A link that is gone is no concern of it: what could not be sent is forgotten.

    Args:
        link: to the autopilot, which passes on what ground stations should see.
    """

    def __init__(self, link: Link, clock: Clock) -> None:
        self.dropped = 0
        """Texts that were overtaken by newer ones before their turn came."""
        self._link = link
        self._clock = clock
        self._state = MavState.STANDBY
        self._armed = False
        self._values: dict[str, float] = {}
        self._texts: deque[tuple[MavSeverity, str]] = deque()
        self._last_text: str | None = None
        self._next_heartbeat_s = self._next_text_s = self._next_values_s = -math.inf

    def state(self, state: MavState, armed: bool) -> None:
        """What the next heartbeats say of us.

        Args:
            state: of this application.
            armed: whether the vehicle is.
        """
        self._state, self._armed = state, armed

    def say(self, text: str, severity: MavSeverity = MavSeverity.INFO, again: bool = False) -> None:
        """A text for the pilot, cut to 50 bytes.

        Args:
            text: what there is to say.
            severity: as ground stations sort it.
            again: whether one that repeats the text before it is sent again, once the first has gone out.
        """
        words = _cut(text, TEXT_BYTES)
        repeated = any(words == waiting for _, waiting in self._texts) if again else words == self._last_text
        if not words or repeated:
            return
        self._last_text = words
        if len(self._texts) == WAITING:
            # What matters least gives way; among equals the oldest.
            least = max(range(WAITING), key=lambda i: (self._texts[i][0], -i))
            del self._texts[least]
            self.dropped += 1
        self._texts.append((severity, words))

    def value(self, name: str, value: float | None) -> None:
        """A number that ground stations can plot; None or not finite: not known now, and not sent.

        Args:
            name: at most 10 bytes.
            value: in the unit that its name implies; ``d`` and ``h`` are in m.

        Raises:
            ValueError: the name is empty, too long or not ASCII.
        """
        if not name.isascii() or not 0 < len(name) <= NAME_BYTES:
            raise ValueError(f"name {name!r} must have 1 to {NAME_BYTES} ASCII characters")
        if value is None or not math.isfinite(value):
            self._values.pop(name, None)
        else:
            self._values[name] = value

    async def run(self) -> None:
        """Report until cancelled; what was said last, perhaps why nothing flies, still goes out."""
        try:
            while True:
                self.tick()
                await self._clock.sleep(TICK_S)
        finally:
            self.tick()

    def tick(self) -> None:
        """Send what is due."""
        now_s = self._clock.now_s()
        with contextlib.suppress(LinkError):
            if now_s >= self._next_heartbeat_s:
                self._next_heartbeat_s = now_s + HEARTBEAT_PERIOD_S
                self._link.send("HEARTBEAT", self._heartbeat())
            if self._texts and now_s >= self._next_text_s:
                self._next_text_s = now_s + TEXT_PERIOD_S
                severity, text = self._texts.popleft()
                self._link.send("STATUSTEXT", {"severity": int(severity), "text": text, "id": 0, "chunk_seq": 0})
            if now_s >= self._next_values_s:
                self._next_values_s = now_s + VALUES_PERIOD_S
                stamp_ms = int(now_s * 1000.0) & 0xFFFFFFFF
                for name, value in self._values.items():
                    self._link.send("NAMED_VALUE_FLOAT", {"time_boot_ms": stamp_ms, "name": name, "value": value})

    def _heartbeat(self) -> dict[str, int]:
        return {
            "type": MavType.ONBOARD_CONTROLLER,
            "autopilot": MavAutopilot.INVALID,
            "base_mode": MavModeFlag.SAFETY_ARMED if self._armed else 0,
            "custom_mode": 0,
            "system_status": int(self._state),
            "mavlink_version": MAVLINK_VERSION,
        }


def _cut(text: str, limit_bytes: int) -> str:
    """The text in ASCII, on one line, within the limit: ground stations show other bytes as they please."""
    plain = " ".join(text.split()).encode("ascii", "replace").decode("ascii")
    return plain if len(plain) <= limit_bytes else plain[: limit_bytes - 2] + ".."
