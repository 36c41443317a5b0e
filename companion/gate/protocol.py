"""What the application tells the gate, over a socket that only its child has: beats, and its last word.

A beat says that a tick was completed, and how old what it rested on was. Without one no setpoint passes: a stream of
setpoints alone proves only that a thread is alive.
"""

from __future__ import annotations

import enum
import math
import struct
from dataclasses import astuple, dataclass

BEAT_FD = "COMPANION_GATE_FD"
"""Environment variable: number of the inherited file descriptor, an AF_UNIX SOCK_SEQPACKET socket."""
GATE_URL = "COMPANION_GATE_URL"
"""Environment variable: where the child finds the autopilot, a ``udpout://`` address on loopback."""

_FORMAT = struct.Struct("<4sB6d")
_BEAT, _GOODBYE = b"beat", b"bye!"
_FAREWELL = struct.Struct("<4sB")


class Phase(enum.IntEnum):
    """What the application is doing, and so what may be expected of it."""

    GROUND = 0
    """Nothing is armed yet."""
    CLIMBING = 1
    """Taking off, by commands or by setpoints that only climb."""
    EXPLORING = 2
    """A setpoint each tick, from all inputs."""
    ENDING = 3
    """Told the autopilot to hold or land, and waits for it."""
    ENDED = 4
    """The flight is over, and the vehicle left as configured: nothing more is to be expected."""


@dataclass(frozen=True, slots=True)
class Beat:
    """One completed tick.

    Attributes:
        t_s: when it began, in s of CLOCK_MONOTONIC, which all processes of a computer share.
        depth_age_s: of the newest look ahead by the depth camera or scanner, by its own stamp; infinite: never.
        ranges_age_s: of the oldest beam that is counted on; infinite: one is missing.
        pose_age_s: of the pose that the tick used.
        ahead_m: least free distance ahead within the body's width, from its centre; infinite: seen free as far as
            anything sees; NaN: not known.
        map_age_s: since the process of the map was last heard.
        phase: what the application is doing.
    """

    t_s: float
    depth_age_s: float
    ranges_age_s: float
    pose_age_s: float
    ahead_m: float
    map_age_s: float
    phase: Phase

    def packed(self) -> bytes:
        """For the socket."""
        *numbers, phase = astuple(self)
        return _FORMAT.pack(_BEAT, phase, *numbers)


@dataclass(frozen=True, slots=True)
class Goodbye:
    """The application ends in good order, with this exit code."""

    exit_code: int

    def packed(self) -> bytes:
        """For the socket."""
        return _FAREWELL.pack(_GOODBYE, self.exit_code & 0xFF)


def unpacked(data: bytes) -> Beat | Goodbye | None:
    """What a datagram says; None when it is neither, or says something that cannot be."""
    if len(data) == _FAREWELL.size and data.startswith(_GOODBYE):
        return Goodbye(data[-1])
    if len(data) != _FORMAT.size or not data.startswith(_BEAT):
        return None
    _, phase, t_s, depth_s, ranges_s, pose_s, ahead_m, map_s = _FORMAT.unpack(data)
    # An age below zero is a stamp from the future: it says nothing of how old the thing is.
    ages = (depth_s, ranges_s, pose_s, map_s)
    if phase not in tuple(Phase) or not math.isfinite(t_s) or not all(age >= 0.0 for age in ages) or ahead_m < 0.0:
        return None
    return Beat(t_s, depth_s, ranges_s, pose_s, ahead_m, map_s, Phase(phase))
