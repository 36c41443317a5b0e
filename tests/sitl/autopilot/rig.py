"""An autopilot on a test bench: time is set by hand, every message goes through its bytes."""

from __future__ import annotations

import math
from collections import deque
from typing import Any

from companion.model import Pose
from sitl.autopilot import Autopilot, Personality
from sitl.autopilot.codec import Decoder, Encoder
from sitl.autopilot.mavlink import Message
from sitl.autopilot.mavlink import dialect as m

STEP_S = 0.01
IDENTITY = [1.0, 0.0, 0.0, 0.0]
NO_COVARIANCE = [0.0] * 21


class Rig:
    """A booted vehicle and a companion computer of the same system."""

    def __init__(self, personality: Personality, start: Pose | None = None, **options: Any) -> None:
        options.setdefault("boot_s", 1.0)
        self.vehicle = Autopilot(personality, start or Pose(0.0, 0.0, 0.0, 0.0, 0.0), **options)
        self.t_s = 0.0
        self.received: deque[tuple[float, Message]] = deque(maxlen=200_000)
        self._packed: set[str] = set()
        self._encoder = Encoder(self.vehicle.system_id)
        self._companion = m.MAVLink(None, self.vehicle.system_id, 191)
        self.feeding: str | None = None
        self._fed_s = -1.0
        self.streaming: tuple[float, float, float, float] | None = None
        self.period_s = 0.1
        self._streamed_s = -1.0

    @property
    def pose(self) -> Pose:
        return self.vehicle.pose

    @property
    def height_m(self) -> float:
        return self.vehicle.state.airframe.height_m

    @property
    def mode(self) -> str:
        return self.vehicle.mode.name

    @property
    def armed(self) -> bool:
        return self.vehicle.state.armed

    def send(self, message: Message, source: tuple[int, int] | None = None) -> list[Message]:
        sender = self._companion if source is None else m.MAVLink(None, *source)
        answers: list[Message] = []
        for received in Decoder().messages(message.pack(sender)):
            answers += self._kept(self.vehicle.receive(received, self.t_s))
        return answers

    def run(self, seconds: float) -> list[Message]:
        """Lets time pass, feeding odometry and setpoints as switched on; what the autopilot said meanwhile."""
        said: list[Message] = []
        for _ in range(round(seconds / STEP_S)):
            self.t_s += STEP_S
            if self.feeding is not None and self.t_s - self._fed_s >= 1.0 / 30.0 - 1e-9:
                self._fed_s = self.t_s
                self.feed(self.feeding)
            if self.streaming is not None and self.t_s - self._streamed_s >= self.period_s - 1e-9:
                self._streamed_s = self.t_s
                self.setpoint(*self.streaming)
            said += self._kept(self.vehicle.step(self.t_s))
        return said

    def until(self, wanted: Any, limit_s: float) -> float:
        """Runs until ``wanted()``; how long it took."""
        begun_s = self.t_s
        while not wanted():
            assert self.t_s - begun_s < limit_s, "it never happened"
            self.run(STEP_S)
        return self.t_s - begun_s

    def feed(self, kind: str, x_m: float | None = None) -> None:
        """Perfect odometry from the start, with the heading at the start as its forward axis (``frd``) or north."""
        start, now = self.vehicle.state.estimator.origin, self.pose
        dx, dy, up = now.x_m - start.x_m, now.y_m - start.y_m, now.z_m - start.z_m
        if kind == "ned":
            north, east, yaw = dy, dx, math.pi / 2 - now.yaw_rad
            self.send(m.MAVLink_vision_position_estimate_message(0, north, east, -up, 0.0, 0.0, yaw))
            self.send(m.MAVLink_vision_speed_estimate_message(0, now.vy_mps, now.vx_mps, -now.vz_mps))
            return
        c, s = math.cos(start.yaw_rad), math.sin(start.yaw_rad)
        yaw = start.yaw_rad - now.yaw_rad
        forward, right = c * dx + s * dy, s * dx - c * dy
        q = [math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)]
        frame = m.MAV_FRAME_LOCAL_FRD if kind == "frd" else 14
        self.send(odometry(forward if x_m is None else x_m, right, -up, q, frame=frame))

    def setpoint(
        self, vx: float, vy: float = 0.0, vz: float = 0.0, yaw_rate: float = 0.0, frame: int = 8, mask: int = 0x5C7,
        system: int = 1,
    ) -> None:  # fmt: skip
        self.send(setpoint(vx, vy, vz, yaw_rate, frame, mask, system))

    def command(self, command: int, *values: float, system: int = 1) -> int:
        """The MAV_RESULT, the last one where there are two; -1 when there was no answer."""
        results = self.results(command_long(command, *values, system=system))
        return results[-1] if results else -1

    def results(self, message: Message, source: tuple[int, int] | None = None) -> list[int]:
        """Every MAV_RESULT that a command is acknowledged with, at once and soon after."""
        answers = self.send(message, source)
        answers += self.run(0.02) if self.vehicle.state.later else []
        return [int(a.result) for a in answers if a.get_type() == "COMMAND_ACK" and a.command == message.command]

    def arm(self) -> int:
        return self.command(m.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)

    def set_mode(self, name: str) -> int:
        number = self.vehicle.personality.modes[name].custom_mode
        if self.vehicle.personality.name == "px4":
            return self.command(m.MAV_CMD_DO_SET_MODE, 1.0, number >> 16 & 0xFF, number >> 24)
        return self.command(m.MAV_CMD_DO_SET_MODE, 1.0, number)

    def parameter(self, name: str, value: float) -> None:
        self.vehicle.state.parameters.set(name, value)

    def fly(self, height_m: float = 1.5) -> None:
        """Armed, taken off, at its height, holding or in guided."""
        if self.vehicle.personality.name == "px4":
            self.parameter("MIS_TAKEOFF_ALT", height_m)
            assert self.command(m.MAV_CMD_NAV_TAKEOFF, *[math.nan] * 7) == 0
            assert self.arm() == 0
        else:
            assert self.set_mode("GUIDED") == 0
            assert self.arm() == 0
            assert self.command(m.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, height_m) == 0
        self.run(12.0)
        assert abs(self.height_m - height_m) < 0.2

    def offboard(self) -> None:
        """In the computer's mode, with zero setpoints streaming."""
        self.streaming = (0.0, 0.0, 0.0, 0.0)
        self.run(0.5)
        assert self.set_mode(self.vehicle.personality.setpoint_mode) == 0
        self.run(0.5)

    def texts(self) -> list[str]:
        return [message.text for _, message in self.received if message.get_type() == "STATUSTEXT"]

    def newest(self, name: str) -> Message:
        return next(message for _, message in reversed(self.received) if message.get_type() == name)

    def _kept(self, messages: list[Message]) -> list[Message]:
        for message in messages:
            # The first of each kind is packed and found again; all of them would take most of the test's time.
            if message.get_type() not in self._packed:
                self._packed.add(message.get_type())
                assert len(Decoder().messages(self._encoder.bytes(message))) == 1, "it did not survive its own bytes"
        self.received.extend((self.t_s, message) for message in messages)
        return messages


def command_long(command: int, *values: float, system: int = 1) -> Message:
    padded = [*values, *[0.0] * (7 - len(values))]
    return m.MAVLink_command_long_message(system, 1, command, 0, *padded)


def setpoint(
    vx: float, vy: float = 0.0, vz: float = 0.0, yaw_rate: float = 0.0, frame: int = 8, mask: int = 0x5C7,
    system: int = 1,
) -> Message:  # fmt: skip
    return m.MAVLink_set_position_target_local_ned_message(
        0, system, 1, frame, mask, 0.0, 0.0, 0.0, vx, vy, vz, 0.0, 0.0, 0.0, 0.0, yaw_rate
    )


def odometry(
    x: float, y: float, z: float, q: list[float] | None = None, frame: int = 20, estimator: int = 3, stamp_us: int = 0
) -> Message:
    return m.MAVLink_odometry_message(
        stamp_us, frame, 12, x, y, z, IDENTITY if q is None else q, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, NO_COVARIANCE,
        NO_COVARIANCE, 0, estimator, 100,
    )  # fmt: skip


def ready(personality: Personality, **options: Any) -> Rig:
    rig = Rig(personality, **options)
    rig.run(2.0)
    return rig


def flying(personality: Personality, **options: Any) -> Rig:
    rig = ready(personality, **options)
    rig.fly()
    rig.offboard()
    return rig


def still(rig: Rig) -> bool:
    return rig.vehicle.state.airframe.speed_mps < 0.1


def travelled(rig: Rig, since: Pose) -> float:
    return math.hypot(rig.pose.x_m - since.x_m, rig.pose.y_m - since.y_m)
