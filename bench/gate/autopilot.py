"""The other end of `bench.gate`: an autopilot that says 1,000 things a second and obeys everything, and a wire."""

from __future__ import annotations

import contextlib
import functools
import math
import select
import socket
import threading
import time
from collections.abc import Callable
from typing import Self

from bench.gate.child import OFFBOARD, SPEED_MPS, SYSTEM, received, timed_socket
from companion.mavlink.codec import Encoder, Framer, decode
from companion.mavlink.ids import MavModeFlag
from sitl.autopilot.mavlink import dialect as m

AUTOPILOT, APPLICATION, GATE = 1, 191, 192
TELEMETRY_HZ = {
    "ATTITUDE": 250.0,
    "HIGHRES_IMU": 200.0,
    "ATTITUDE_QUATERNION": 100.0,
    "LOCAL_POSITION_NED": 100.0,
    "ODOMETRY": 100.0,
    "TIMESYNC": 100.0,
    "SERVO_OUTPUT_RAW": 50.0,
    "GLOBAL_POSITION_INT": 30.0,
    "VFR_HUD": 20.0,
    "RC_CHANNELS": 20.0,
    "DISTANCE_SENSOR": 14.0,
    "ESTIMATOR_STATUS": 5.0,
    "GPS_RAW_INT": 5.0,
    "SYS_STATUS": 2.0,
    "EXTENDED_SYS_STATE": 2.0,
    "BATTERY_STATUS": 1.0,
    "HEARTBEAT": 1.0,
}
"""A thousand, in a mixture as PX4 sends it over a fast link, with visual odometry and many clocks to compare."""

PX4, QUADROTOR, CUSTOM_MODE, STANDBY, ACTIVE = 12, 2, 1, 3, 4
OFFBOARD_MODE, HOLD_MODE = 6 << 16, 4 << 16 | 3 << 24
HEALTHY = 0x1F
"""Attitude, velocities and positions are known."""
LONGEST_WAIT_S = 0.001

SETPOINT = 84
"""SET_POSITION_TARGET_LOCAL_NED."""


class FakeAutopilot:
    """Sends what is due, and notes when setpoints arrive.

    Args:
        wire: its socket, of `timed_socket`, or one end of a pair.
        to: where it sends; None: to the first sender, or to the other end.

    Attributes:
        sent: messages so far.
        flies: whether setpoints that move the vehicle arrive.
        setpoint_delays_us: from the moment that each of the application's setpoints carries until its arrival.
        stopped_ns: when the gate's first stop came since this was set to 0; 0: none has.
    """

    def __init__(self, wire: socket.socket, to: tuple[str, int] | None) -> None:
        self.wire = wire
        self.sent = 0
        self.flies = False
        self.setpoint_delays_us: list[float] = []
        self.stopped_ns = 0
        self._to = to
        self._encoder, self._framer = Encoder(SYSTEM, AUTOPILOT), Framer(datagram=True)
        self._armed, self._mode = False, HOLD_MODE
        self._begun_s = time.monotonic()
        self._due_s = dict.fromkeys(TELEMETRY_HZ, self._begun_s)
        self._packets: dict[str, Callable[[], bytes]] = {
            "HEARTBEAT": self._heartbeat,
            "ATTITUDE": lambda: self._encoder.pack("ATTITUDE", time_boot_ms=self._boot_ms(), roll=0.01, yaw=0.0),
            "LOCAL_POSITION_NED": self._position,
            "TIMESYNC": lambda: self._encoder.pack("TIMESYNC", tc1=0, ts1=time.monotonic_ns()),
            "SYS_STATUS": lambda: self._encoder.pack("SYS_STATUS", battery_remaining=80, voltage_battery=16000),
            "ESTIMATOR_STATUS": lambda: self._encoder.pack("ESTIMATOR_STATUS", flags=HEALTHY, vel_ratio=0.1),
            **_which_say_always_the_same(),
        }

    def wait_s(self) -> float:
        """Until something is due."""
        return max(0.0, min(min(self._due_s.values()) - time.monotonic(), LONGEST_WAIT_S))

    def land(self) -> None:
        """Be disarmed from now on."""
        self._armed = False

    def turn(self) -> None:
        """Send what is due, and take what came."""
        now_s = time.monotonic()
        for name, due_s in self._due_s.items():
            if due_s <= now_s:
                self._due_s[name] = max(due_s + 1.0 / TELEMETRY_HZ[name], now_s - 0.1)
                self._send(self._packets[name]())
        while (found := received(self.wire)) is not None:
            data, arrived_ns, sender = found
            self._to = self._to or sender
            for frame in self._framer.frames(data):
                fields = decode(frame)
                if fields is not None:
                    self._obey(frame.message_id, frame.component_id, fields, arrived_ns)

    def _obey(self, number: int, component: int, fields: dict[str, int | float | str], arrived_ns: int) -> None:
        if number == m.MAVLINK_MSG_ID_COMMAND_LONG:
            if fields["command"] == m.MAV_CMD_COMPONENT_ARM_DISARM:
                self._armed = True
            elif fields["command"] == m.MAV_CMD_DO_SET_MODE:
                self._mode = OFFBOARD_MODE if fields["param2"] == OFFBOARD[1] else HOLD_MODE
            self._send(self._encoder.pack("COMMAND_ACK", command=int(fields["command"]), result=0))
            self._send(self._heartbeat())
        elif number == m.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED and component == GATE:
            self.stopped_ns = self.stopped_ns or arrived_ns
        elif number == m.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED and fields["vx"]:
            self.flies = self._armed and self._mode == OFFBOARD_MODE
            self.setpoint_delays_us.append(float((arrived_ns // 1000 - int(fields["time_boot_ms"])) & 0xFFFFFFFF))

    def _send(self, packet: bytes) -> None:
        if self.wire.family == socket.AF_UNIX:
            self.wire.send(packet)
        elif self._to is not None:
            self.wire.sendto(packet, self._to)
        else:
            return
        self.sent += 1

    def _boot_ms(self) -> int:
        return int((time.monotonic() - self._begun_s) * 1e3)

    def _heartbeat(self) -> bytes:
        return self._encoder.pack(
            "HEARTBEAT",
            type=QUADROTOR,
            autopilot=PX4,
            base_mode=CUSTOM_MODE | (MavModeFlag.SAFETY_ARMED if self._armed else 0),
            custom_mode=self._mode,
            system_status=ACTIVE if self._armed else STANDBY,
            mavlink_version=3,
        )

    def _position(self) -> bytes:
        now_s = time.monotonic() - self._begun_s
        speed_mps = SPEED_MPS + 1e-3 * (self.sent % 7)
        return self._encoder.pack(
            "LOCAL_POSITION_NED", time_boot_ms=int(now_s * 1e3), x=SPEED_MPS * now_s, z=-1.5, vx=speed_mps
        )


def _which_say_always_the_same() -> dict[str, Callable[[], bytes]]:
    """Messages whose content nobody here looks at: as long as real ones, packed once."""
    zeros = [0.0] * 21
    messages = (
        m.MAVLink_highres_imu_message(1, *[0.1] * 13, 63),
        m.MAVLink_attitude_quaternion_message(1, 1.0, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1),
        m.MAVLink_odometry_message(
            1, 1, 12, 1.0, 2.0, 3.0, [1.0, 0.1, 0.1, 0.1], *[0.1] * 6, zeros, [*zeros[:-1], 1.0], 0, 3, 100
        ),
        m.MAVLink_servo_output_raw_message(1, 0, *[1500] * 16),
        m.MAVLink_global_position_int_message(1, 1, 2, 3, 4, 5, 6, 7, 8),
        m.MAVLink_vfr_hud_message(1.0, 1.0, 90, 50, 1.0, 0.1),
        m.MAVLink_rc_channels_message(1, 18, *[1500] * 18, 200),
        m.MAVLink_distance_sensor_message(1, 10, 5000, 150, 0, 0, 25, 0),
        m.MAVLink_gps_raw_int_message(1, 3, 1, 2, 3, 70, 90, 10, 100, 12),
        m.MAVLink_extended_sys_state_message(0, 2),
        m.MAVLink_battery_status_message(0, 1, 1, 2500, [4000] * 4 + [65535] * 6, 1500, -1, -1, 80),
    )
    mavlink = m.MAVLink(None, SYSTEM, AUTOPILOT)
    packets: dict[str, bytes] = {message.get_type(): message.pack(mavlink) for message in messages}
    return {name: functools.partial(bytes, packet) for name, packet in packets.items()}


class Wire:
    """Between autopilot and gate: passes everything on, and stamps the setpoints.

    Attributes:
        port: where the autopilot sends.
        setpoints: ns of arrival, and the MAVLink component that it is from.
        speeds: ns of arrival of each setpoint of the application, and the speed in the plane that it asks for, in m/s.
    """

    def __init__(self, gate_port: int) -> None:
        self.setpoints: list[tuple[int, int]] = []
        self.speeds: list[tuple[int, float]] = []
        self._near, self._far = timed_socket(), timed_socket()
        self.port: int = self._near.getsockname()[1]
        self._gate = ("127.0.0.1", gate_port)
        self._framer = Framer(datagram=True)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="wire")

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        self._near.close()
        self._far.close()

    def _run(self) -> None:
        autopilot: tuple[str, int] | None = None
        while not self._stop.is_set():
            select.select([self._near, self._far], [], [], 0.1)
            while (found := received(self._near)) is not None:
                data, _, autopilot = found
                with contextlib.suppress(OSError):
                    self._far.sendto(data, self._gate)
            while (found := received(self._far)) is not None:
                data, arrived_ns, _ = found
                for frame in self._framer.frames(data):
                    if frame.message_id == SETPOINT:
                        self.setpoints.append((arrived_ns, frame.component_id))
                        if frame.component_id == APPLICATION:
                            asked = decode(frame) or {}
                            speed_mps = math.hypot(float(asked.get("vx", 0.0)), float(asked.get("vy", 0.0)))
                            self.speeds.append((arrived_ns, speed_mps))
                if autopilot is not None:
                    with contextlib.suppress(OSError):
                        self._near.sendto(data, autopilot)
