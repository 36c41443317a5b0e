"""What a test has seen go by on the link between the gate and the autopilot."""

from __future__ import annotations

import math
from collections import Counter, deque
from dataclasses import dataclass

from sitl.autopilot.mavlink import Message
from sitl.autopilot.mavlink import dialect as m

REMEMBERED = 20_000
_COMMANDS = ("COMMAND_LONG", "COMMAND_INT", "SET_MODE")


@dataclass(frozen=True, slots=True)
class SetpointSeen:
    """One SET_POSITION_TARGET_LOCAL_NED on its way to the autopilot, stamped on arrival by `time.monotonic`.

    Attributes:
        sender: system and component that say to have sent it.
        passed: whether the relay let it through.
    """

    t_s: float
    vx: float
    vy: float
    vz: float
    yaw_rate: float
    frame: int
    mask: int
    target: tuple[int, int]
    sender: tuple[int, int]
    passed: bool

    @property
    def stops(self) -> bool:
        """Whether it asks for no motion at all."""
        return self.vx == self.vy == self.vz == self.yaw_rate == 0.0


@dataclass(frozen=True, slots=True)
class CommandSeen:
    """One COMMAND_LONG, COMMAND_INT or SET_MODE on its way to the autopilot.

    Attributes:
        command: MAV_CMD; for SET_MODE the number of that message.
        params: of a COMMAND_LONG all seven; of a COMMAND_INT the first four; of a SET_MODE the custom mode.
    """

    t_s: float
    command: int
    params: tuple[float, ...]
    target: tuple[int, int]
    sender: tuple[int, int]
    passed: bool


@dataclass(frozen=True, slots=True)
class TextSeen:
    """One STATUSTEXT on its way to the autopilot, and so to whoever looks on there."""

    t_s: float
    severity: int
    text: str
    sender: tuple[int, int]


@dataclass(frozen=True, slots=True)
class HeartbeatSeen:
    """One heartbeat of the autopilot that was passed on to the gate, as it was passed on."""

    t_s: float
    custom_mode: int
    armed: bool


class Seen:
    """The newest of each kind. One thread writes, others read.

    Attributes:
        names: how often a message of each name came up to the autopilot.
    """

    def __init__(self) -> None:
        self.names: Counter[str] = Counter()
        self._setpoints: deque[SetpointSeen] = deque(maxlen=REMEMBERED)
        self._commands: deque[CommandSeen] = deque(maxlen=REMEMBERED)
        self._texts: deque[TextSeen] = deque(maxlen=REMEMBERED)
        self._heartbeats: deque[HeartbeatSeen] = deque(maxlen=REMEMBERED)

    def setpoints(self, since_s: float = -math.inf) -> list[SetpointSeen]:
        """That have come up since a moment of `time.monotonic`, oldest first."""
        return [seen for seen in tuple(self._setpoints) if seen.t_s >= since_s]

    def commands(self, since_s: float = -math.inf) -> list[CommandSeen]:
        """That have come up since then."""
        return [seen for seen in tuple(self._commands) if seen.t_s >= since_s]

    def texts(self, since_s: float = -math.inf) -> list[TextSeen]:
        """That have come up since then."""
        return [seen for seen in tuple(self._texts) if seen.t_s >= since_s]

    def heartbeats(self, since_s: float = -math.inf) -> list[HeartbeatSeen]:
        """Of the autopilot, that were passed down since then."""
        return [seen for seen in tuple(self._heartbeats) if seen.t_s >= since_s]

    def up(self, message: Message, now_s: float, passed: bool) -> None:
        """One message on its way to the autopilot."""
        name = message.get_type()
        self.names[name] += 1
        sender = (message.get_srcSystem(), message.get_srcComponent())
        if name == "SET_POSITION_TARGET_LOCAL_NED":
            target = (message.target_system, message.target_component)
            velocity = (message.vx, message.vy, message.vz, message.yaw_rate)
            frame, mask = message.coordinate_frame, message.type_mask
            self._setpoints.append(SetpointSeen(now_s, *velocity, frame, mask, target, sender, passed))
        elif name in _COMMANDS:
            self._commands.append(_command(message, now_s, sender, passed))
        elif name == "STATUSTEXT":
            self._texts.append(TextSeen(now_s, message.severity, message.text, sender))

    def down(self, heartbeat: Message, now_s: float) -> None:
        """One heartbeat that is passed on to the gate; those of others, which an autopilot forwards, say no mode."""
        if heartbeat.get_srcComponent() != m.MAV_COMP_ID_AUTOPILOT1:
            return
        armed = bool(heartbeat.base_mode & m.MAV_MODE_FLAG_SAFETY_ARMED)
        self._heartbeats.append(HeartbeatSeen(now_s, heartbeat.custom_mode, armed))


def _command(message: Message, now_s: float, sender: tuple[int, int], passed: bool) -> CommandSeen:
    if message.get_type() == "SET_MODE":
        params: tuple[float, ...] = (float(message.custom_mode),)
        return CommandSeen(now_s, message.get_msgId(), params, (message.target_system, 0), sender, passed)
    last = 8 if message.get_type() == "COMMAND_LONG" else 5
    params = tuple(float(getattr(message, f"param{i}")) for i in range(1, last))
    target = (message.target_system, message.target_component)
    return CommandSeen(now_s, message.command, params, target, sender, passed)
