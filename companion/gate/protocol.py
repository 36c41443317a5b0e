"""What the application and the gate say to each other beside MAVLink, over the one socket that only they have.

The gate makes a pair of AF_UNIX SOCK_SEQPACKET sockets and gives one end to the application that it starts. Each packet
is whole MAVLink frames, or one word of this module; both ways they arrive in the order in which they were sent. There
is no port, and no token that could be read, guessed or sent again.

A beat says that a tick was completed, and how old what it rested on was. Without one no setpoint passes: a stream of
setpoints alone proves only that a thread is alive. A notice says what the gate does, and why.
"""

from __future__ import annotations

import enum
import itertools
import math
import struct
from dataclasses import dataclass

from companion.gate.faults import Fault, Stage
from companion.mavlink.codec import MAVLINK_1, MAVLINK_2
from companion.sides import NOTHING_AROUND, Side, Sides

GATE_FD = "COMPANION_GATE_FD"
"""Environment variable: number of the inherited file descriptor."""
PACKET_BYTES = 2048
"""No packet is larger."""

LINK = "link:"
"""So begins a notice of what is wrong with the link to the autopilot; with nothing behind it all is well again."""

_BEAT, _GOODBYE, _NOTICE = b"beat", b"bye!", b"note"
_BEAT_FORMAT = struct.Struct("<4sB14d")
_GOODBYE_FORMAT = struct.Struct("<4sB")
_NOTICE_FORMAT = struct.Struct("<4sBB")
_NO_FAULT = 0xFF
_FAULTS = tuple(Fault)
_TEXT_BYTES = 240


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
        sides: what is seen near the body, by the application's sensors alone.
    """

    t_s: float
    depth_age_s: float
    ranges_age_s: float
    pose_age_s: float
    ahead_m: float
    map_age_s: float
    phase: Phase
    sides: Sides = NOTHING_AROUND

    def packed(self) -> bytes:
        """For the socket."""
        numbers = (self.t_s, self.depth_age_s, self.ranges_age_s, self.pose_age_s, self.ahead_m, self.map_age_s)
        return _BEAT_FORMAT.pack(_BEAT, self.phase, *numbers, *itertools.chain(*self.sides))


@dataclass(frozen=True, slots=True)
class Goodbye:
    """The application ends in good order, with this exit code."""

    exit_code: int

    def packed(self) -> bytes:
        """For the socket."""
        return _GOODBYE_FORMAT.pack(_GOODBYE, self.exit_code & 0xFF)


@dataclass(frozen=True, slots=True)
class Notice:
    """What the gate does now.

    Attributes:
        stage: of its answer to the faults there are.
        fault: that the stage, or the text, is about; None: none.
        text: for the operator; empty where only the stage is said again.
    """

    stage: Stage
    fault: Fault | None = None
    text: str = ""

    def packed(self) -> bytes:
        """For the socket; a text that is too long is cut."""
        fault = _NO_FAULT if self.fault is None else _FAULTS.index(self.fault)
        return _NOTICE_FORMAT.pack(_NOTICE, self.stage, fault) + self.text.encode()[:_TEXT_BYTES]

    @staticmethod
    def unpacked(data: bytes) -> Notice | None:
        """What a packet says; None when it is no notice, or says something that cannot be."""
        if len(data) < _NOTICE_FORMAT.size or not data.startswith(_NOTICE):
            return None
        _, stage, fault = _NOTICE_FORMAT.unpack_from(data)
        if stage not in tuple(Stage) or (fault != _NO_FAULT and fault >= len(_FAULTS)):
            return None
        text = data[_NOTICE_FORMAT.size :].decode(errors="replace")
        return Notice(Stage(stage), None if fault == _NO_FAULT else _FAULTS[fault], text)


def is_mavlink(packet: bytes) -> bool:
    """Whether a packet is MAVLink frames: their first byte is never that of a word of this module."""
    return packet[:1] in (bytes((MAVLINK_1,)), bytes((MAVLINK_2,)))


def unpacked(data: bytes) -> Beat | Goodbye | None:
    """What the application says; None when it is neither, or says something that cannot be."""
    if len(data) == _GOODBYE_FORMAT.size and data.startswith(_GOODBYE):
        return Goodbye(data[-1])
    if len(data) != _BEAT_FORMAT.size or not data.startswith(_BEAT):
        return None
    _, phase, t_s, depth_s, ranges_s, pose_s, ahead_m, map_s, *beside = _BEAT_FORMAT.unpack(data)
    sides = tuple(map(Side, beside[::2], beside[1::2]))
    # An age below zero is a stamp from the future: it says nothing of how old the thing is.
    ages = (depth_s, ranges_s, pose_s, map_s)
    if phase not in tuple(Phase) or not math.isfinite(t_s) or not all(age >= 0.0 for age in ages) or ahead_m < 0.0:
        return None
    # A distance that is none would pass for nothing near, and no comparison finds a speed that is none.
    if not all(side.distance_m >= 0.0 and math.isfinite(side.closing_mps) for side in sides):
        return None
    return Beat(t_s, depth_s, ranges_s, pose_s, ahead_m, map_s, Phase(phase), Sides(*sides))
