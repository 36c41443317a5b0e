"""A ground station that only looks on: what the vehicle does, whatever the application believes."""

from __future__ import annotations

import math
import socket
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import pytest

from companion.frames import NedPose, pose_from_ned
from companion.mavlink.firmware import KINDS, AutopilotKind
from companion.mavlink.ids import MavModeFlag
from companion.mavlink.modes import mode_name
from companion.model import Pose
from sitl.autopilot.codec import Decoder
from sitl.autopilot.mavlink import Message
from sitl.autopilot.mavlink import dialect as m
from tests.shared.beside import OwnThread

LOOPBACK = "127.0.0.1"
GROUND_STATION = (255, 190)
SAMPLES = 20_000


@dataclass(frozen=True, slots=True)
class Beat:
    """One heartbeat."""

    t_s: float
    mode: str
    armed: bool


class Witness(OwnThread):
    """Listens to one autopilot, on a port of its own, in a thread, while the block lasts.

    Args:
        port: the UDP port to which the autopilot sends besides; by default a free one.
        system_id: of the vehicle; messages of others are dropped.

    Attributes:
        poses: as the autopilot tells them; with GPS that is the truth within centimetres. Stamped on arrival.
        beats: its heartbeats.
        texts: what it said to its pilot.
    """

    def __init__(self, port: int = 0, system_id: int = 1) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind((LOOPBACK, port))
        self._socket.settimeout(0.1)
        self.port: int = self._socket.getsockname()[1]
        self.poses: deque[Pose] = deque(maxlen=SAMPLES)
        self.beats: deque[Beat] = deque(maxlen=SAMPLES)
        self.texts: list[str] = []
        self._system_id = system_id
        self._autopilot: Any = None
        super().__init__("witness", self._socket)

    @property
    def mode(self) -> str:
        """Of the newest heartbeat."""
        return self.beats[-1].mode if self.beats else "no heartbeat"

    @property
    def armed(self) -> bool:
        """Whether the newest heartbeat says so."""
        return bool(self.beats) and self.beats[-1].armed

    @property
    def ever_armed(self) -> bool:
        """Whether any heartbeat has said so."""
        return any(beat.armed for beat in tuple(self.beats))

    def pose(self) -> Pose:
        """The newest."""
        assert self.poses, "no position came from the autopilot"
        return self.poses[-1]

    def pose_at(self, t_s: float) -> Pose:
        """The last one before a moment."""
        before = [pose for pose in tuple(self.poses) if pose.t_s <= t_s]
        assert before, "nothing was known then"
        return before[-1]

    def speed_at(self, t_s: float, window_s: float = 0.2) -> float:
        """Mean horizontal speed in m/s around a moment: of one alone the noise would tell as well."""
        speeds = [speed_mps(pose) for pose in tuple(self.poses) if abs(pose.t_s - t_s) <= 0.5 * window_s]
        assert speeds, "no velocity came then"
        return math.fsum(speeds) / len(speeds)

    def wait(self, what: str, ready: Callable[[], bool], timeout_s: float) -> None:
        """Wait until it has happened; the test fails when it does not."""
        give_up_s = time.monotonic() + timeout_s
        while not ready():
            if time.monotonic() > give_up_s:
                pytest.fail(f"not within {timeout_s:g} s: {what}; mode {self.mode}, texts {self.texts[-5:]}")
            time.sleep(0.02)

    def send(self, message: Message, sender: tuple[int, int] = GROUND_STATION) -> None:
        """Say something to the autopilot, by default as a ground station."""
        assert self._autopilot is not None, "nothing came from the autopilot"
        self._socket.sendto(message.pack(m.MAVLink(None, *sender)), self._autopilot)

    def _run(self) -> None:
        while not self._stop.is_set():
            try:
                data, self._autopilot = self._socket.recvfrom(65536)
            except TimeoutError:
                continue
            for message in Decoder().messages(data):
                if (message.get_srcSystem(), message.get_srcComponent()) == (self._system_id, 1):
                    self._hear(message, time.monotonic())
                else:
                    self._overhear(message)

    def _hear(self, message: Message, now_s: float) -> None:
        name = message.get_type()
        if name == "HEARTBEAT":
            kind = KINDS.get(message.autopilot, AutopilotKind.PX4)
            self.beats.append(
                Beat(now_s, mode_name(kind, message.custom_mode), bool(message.base_mode & MavModeFlag.SAFETY_ARMED))
            )
            if not self.poses or now_s - self.poses[-1].t_s > 0.5:
                self._ask_for_positions()
        elif name == "STATUSTEXT":
            self.texts.append(message.text)
        elif name == "LOCAL_POSITION_NED":
            velocity = (message.vx, message.vy, message.vz)
            ned = NedPose(now_s, message.x, message.y, message.z, 0.0, 0.0, 0.0, *velocity, 0.0)
            self.poses.append(pose_from_ned(ned))

    def _overhear(self, message: Message) -> None:
        """What others have said, and the autopilot has passed on."""

    def _ask_for_positions(self) -> None:
        self.send(
            m.MAVLink_command_long_message(
                *(self._system_id, 1, m.MAV_CMD_SET_MESSAGE_INTERVAL, 0),
                *(m.MAVLINK_MSG_ID_LOCAL_POSITION_NED, 20_000, 0, 0, 0, 0, 0),
            )
        )


def speed_mps(pose: Pose) -> float:
    """Horizontal."""
    return math.hypot(pose.vx_mps, pose.vy_mps)


def apart_m(one: Pose, other: Pose) -> float:
    """Horizontal distance."""
    return math.hypot(one.x_m - other.x_m, one.y_m - other.y_m)
