"""A switch of the pilot's transmitter, as the autopilot tells its receiver's channels: where it stands, and since when.

A transmitter that is lost moves nothing: what a receiver puts on its channels then is anybody's guess, so a position
counts only while the autopilot says that it hears its transmitter, and only once it has lasted.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Callable
from dataclasses import dataclass

from companion.autopilot.interface import Link, Message
from companion.autopilot.vehicle_state import integer
from companion.config.mission import RcSwitchSettings
from companion.mavlink.ids import MavSysStatusSensor

LEAST_US, MOST_US = 800, 2200
"""Pulses of a receiver; MAVLink says 65535 for a channel that there is not, ArduPilot 0."""
SETTLED_S = 0.7
"""A position has to last so long: a switch with three of them passes the middle."""
HEARD_AFTER_S = 0.6
"""So long after the position appeared the autopilot has to say that it hears its transmitter: a receiver that has lost
it may put out something else at once, and an autopilot notices after half a second (PX4's COM_RC_LOSS_T)."""
SILENT_S = 1.0
"""Channels that are older than this, or a word on the receiver that is, are none."""


class Position(enum.Enum):
    """Where a switch stands, by the length of its pulses."""

    LOW = "low"
    MIDDLE = "middle"
    HIGH = "high"


@dataclass(frozen=True, slots=True)
class Move:
    """The switch has come to stand elsewhere.

    Attributes:
        before: where it stood; None: nobody knows, it is the first that is heard of it.
        after: where it stands.
        unseen: whether nobody saw it being moved: the transmitter was lost in between, or never heard before.
    """

    before: Position | None
    after: Position
    unseen: bool


class RcSwitch:
    """Follows RC_CHANNELS and SYS_STATUS.

    Args:
        settings: the channel, and where its positions end.
        link: on which the autopilot tells them.
    """

    def __init__(self, settings: RcSwitchSettings, link: Link) -> None:
        assert settings.channel is not None  # noqa: S101 - without one there is no switch
        self._field = f"chan{settings.channel}_raw"
        self._channel = settings.channel
        self._settings = settings
        self._last: Position | None = None
        self._settled = False
        self._unseen = True
        self._shown: Position | None = None  # not yet settled
        self._shown_since_s = self._channels_s = -math.inf
        self._heard_s = -math.inf  # when the autopilot last said that it hears its transmitter
        self._on_move: Callable[[Move], None] = lambda _: None
        link.events("RC_CHANNELS", self._on_channels)
        link.events("SYS_STATUS", self._on_status)

    def position(self, now_s: float) -> Position | None:
        """Where it stands now; None while that is not known: nothing is heard, or it has only just been moved."""
        known = self._settled and now_s - min(self._channels_s, self._heard_s) <= SILENT_S
        return self._last if known else None

    def problem(self, now_s: float) -> str:
        """Why nobody knows where it stands."""
        if now_s - self._channels_s > SILENT_S:
            return "no RC_CHANNELS"
        if now_s - self._heard_s > SILENT_S:
            return "the autopilot says that it hears no transmitter (SYS_STATUS)"
        return f"channel {self._channel} is not there, or just being moved"

    def follow(self, on_move: Callable[[Move], None]) -> None:
        """From now on this one is called with every move."""
        self._on_move = on_move

    def _on_channels(self, message: Message) -> None:
        now_s = message.received_s
        if now_s - self._channels_s > SILENT_S:
            self._lose()
        self._channels_s = now_s
        shown = self._read(message)
        if shown is None or now_s - self._heard_s > SILENT_S:
            self._lose()
            return
        if shown is not self._shown:
            self._shown, self._shown_since_s, self._settled = shown, now_s, False
            return
        lasts = now_s - self._shown_since_s >= SETTLED_S and self._heard_s >= self._shown_since_s + HEARD_AFTER_S
        if lasts and not self._settled:
            self._settle(shown)

    def _settle(self, shown: Position) -> None:
        move = Move(self._last, shown, self._unseen)
        self._settled, self._last, self._unseen = True, shown, False
        if move.before is not shown:
            self._on_move(move)

    def _lose(self) -> None:
        self._shown, self._settled, self._unseen = None, False, True

    def _read(self, message: Message) -> Position | None:
        pulse_us, count = integer(message, self._field), integer(message, "chancount")
        if pulse_us is None or count is None or count < self._channel or not LEAST_US <= pulse_us <= MOST_US:
            return None
        if pulse_us < self._settings.low_us:
            return Position.LOW
        return Position.HIGH if pulse_us > self._settings.high_us else Position.MIDDLE

    def _on_status(self, message: Message) -> None:
        """Both autopilots show a receiver as there and healthy only while it hears its transmitter."""
        there = integer(message, "onboard_control_sensors_present")
        healthy = integer(message, "onboard_control_sensors_health")
        hears = there is not None and healthy is not None and there & healthy & MavSysStatusSensor.RC_RECEIVER
        if hears:
            self._heard_s = message.received_s
        else:
            self._heard_s = -math.inf
            self._lose()
