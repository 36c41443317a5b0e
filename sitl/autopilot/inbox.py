"""What the autopilot does with each message that arrives. What it cannot use, it counts and ignores."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from companion.frames import NedPose, pose_from_ned
from companion.geometry import angles_of
from sitl.autopilot.commands import Commands
from sitl.autopilot.estimator import Odometry
from sitl.autopilot.guidance import body_velocity
from sitl.autopilot.mavlink import Message, finite, ned_velocity
from sitl.autopilot.mavlink import dialect as m
from sitl.autopilot.personality import Personality
from sitl.autopilot.state import Obstacles, State, Target

AUTOPILOT_COMPONENT = 1
VELOCITY_MASK = 0x5C7
"""Velocity and yaw rate. The real ones take other combinations too; nobody here sends them."""
_FASTEST_MPS = 50.0
_CONVERGED = 500
"""TIMESYNC exchanges until PX4 trusts them."""
_SYNC_PARTNERS = 16
_STAMP_OFF_S = 1.0
_NO_RANGE = 65535
_RESULT_LATER_S = 0.004
_LOST_CONTROL_MPS = 0.25
"""How fast it drifts on setpoints of a frame in which each restarts its controller."""


@dataclass(slots=True)
class _Sync:
    """How far the clock of one partner is ahead, once that is believed."""

    count: int = 0
    offset_s: float = 0.0


class Inbox:
    """Takes messages.

    Args:
        personality: which autopilot listens.
        state: what the messages change.
        commands: for COMMAND_LONG, COMMAND_INT and SET_MODE.
        system_id: messages to other systems are ignored.
        acknowledged: is told of every COMMAND_ACK to the autopilot.
    """

    def __init__(
        self,
        personality: Personality,
        state: State,
        commands: Commands,
        system_id: int,
        acknowledged: Callable[[Message], None],
    ) -> None:
        self._personality = personality
        self._state = state
        self._commands = commands
        self._system_id = system_id
        self._acknowledged = acknowledged
        self._to_list: list[str] = []
        self._syncs: dict[tuple[int, int], _Sync] = {}
        self.reboot = False
        """A command has asked for it."""
        self._handlers: dict[str, Callable[[Message], list[Message]]] = {
            "HEARTBEAT": self._heartbeat,
            "COMMAND_LONG": self._command,
            "COMMAND_INT": self._command,
            "COMMAND_ACK": self._command_ack,
            "SET_MODE": self._set_mode,
            "PARAM_REQUEST_LIST": self._param_list,
            "PARAM_REQUEST_READ": self._param_read,
            "PARAM_SET": self._param_set,
            "SET_POSITION_TARGET_LOCAL_NED": self._setpoint,
            "ODOMETRY": self._odometry,
            "VISION_POSITION_ESTIMATE": self._vision_position,
            "VISION_SPEED_ESTIMATE": self._vision_speed,
            "OBSTACLE_DISTANCE": self._obstacles,
            "SET_GPS_GLOBAL_ORIGIN": self._global_origin,
            "TIMESYNC": self._timesync,
            "MISSION_REQUEST_LIST": self._mission_list,
        }

    def take(self, message: Message, routed: bool) -> list[Message]:
        """The answers to one message; ``routed`` says that it went on to the component that it is for."""
        handler = self._handlers.get(message.get_type())
        if handler is None:
            return []
        source = message.get_srcSystem(), message.get_srcComponent()
        if source == (self._system_id, AUTOPILOT_COMPONENT):
            return self._ignored("own message came back")
        # Broadcasts have target 0; messages without a target are for everyone.
        if getattr(message, "target_system", 0) not in (0, self._system_id):
            return self._ignored("for another system")
        if getattr(message, "target_component", 0) in (0, AUTOPILOT_COMPONENT):
            return handler(message)
        # ArduPilot carries out itself what is for a component of its system that it has never heard.
        if routed or not self._personality.takes_what_nobody_takes:
            return self._ignored("for another component")
        return handler(message)

    def listed(self, most: int) -> list[Message]:
        """The next parameters of a list that was asked for."""
        names, self._to_list = self._to_list[:most], self._to_list[most:]
        return [self._param_value(name) for name in names]

    def _ignored(self, reason: str) -> list[Message]:
        self._state.counts[reason] += 1
        return []

    def _command(self, message: Message) -> list[Message]:
        last = ("x", "y", "z") if message.get_type() == "COMMAND_INT" else ("param5", "param6", "param7")
        names = ("param1", "param2", "param3", "param4", *last)
        values = [float(getattr(message, name)) for name in names]
        answer = self._commands.do(message.command, values, message.get_srcComponent())
        self.reboot = answer.reboot
        result = answer.result
        if answer.received:
            result = m.MAV_RESULT_ACCEPTED
            real = self._acknowledge(message, message.command, answer.result)
            self._state.later.append((self._state.t_s + _RESULT_LATER_S, real))
        return [self._acknowledge(message, message.command, result), *answer.messages]

    def _command_ack(self, message: Message) -> list[Message]:
        self._acknowledged(message)
        return []

    def _heartbeat(self, message: Message) -> list[Message]:
        if message.type == m.MAV_TYPE_GCS:
            self._state.ground_station.heard(self._state.t_s)
        elif message.type == m.MAV_TYPE_ONBOARD_CONTROLLER:
            self._state.companion.heard(self._state.t_s)
        return []

    def _acknowledge(self, message: Message, command: int, result: int) -> Message:
        return m.MAVLink_command_ack_message(command, result, 0, 0, message.get_srcSystem(), message.get_srcComponent())

    def _set_mode(self, message: Message) -> list[Message]:
        if not message.base_mode & m.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
            return self._ignored("mode without custom mode")
        result = self._commands.set_mode(message.custom_mode, message.get_srcComponent())
        if not self._personality.acknowledges_set_mode:
            return []
        return [self._acknowledge(message, message.id, result)]

    def _param_list(self, _message: Message) -> list[Message]:
        self._to_list = list(self._state.parameters.names)
        return []

    def _param_read(self, message: Message) -> list[Message]:
        names = self._state.parameters.names
        if 0 <= message.param_index < len(names):
            return [self._param_value(names[message.param_index])]
        if message.param_index == -1 and message.param_id in self._state.parameters:
            return [self._param_value(message.param_id)]
        return self._ignored("unknown parameter")

    def _param_set(self, message: Message) -> list[Message]:
        parameters = self._state.parameters
        if message.param_id not in parameters:
            return self._ignored("unknown parameter")
        if not parameters.set_encoded(message.param_id, message.param_value, message.param_type):
            return self._ignored("parameter with wrong type or value")
        return [self._param_value(message.param_id)]

    def _param_value(self, name: str) -> Message:
        parameters = self._state.parameters
        count, index = len(parameters.names), parameters.names.index(name)
        kind = int(parameters.kind(name))
        return m.MAVLink_param_value_message(name.encode(), parameters.encoded(name), kind, count, index)

    def _setpoint(self, message: Message) -> list[Message]:
        frame, personality = message.coordinate_frame, self._personality
        if message.type_mask != VELOCITY_MASK:
            return self._ignored("setpoint with another type mask")
        velocity = (message.vx, message.vy, message.vz, message.yaw_rate)
        if not finite(*velocity) or max(map(abs, velocity)) > _FASTEST_MPS:
            return self._ignored("setpoint that is no number")
        if frame in personality.drifting_frames:
            velocity = (_LOST_CONTROL_MPS, 0.0, 0.0, 0.0)
        elif frame not in personality.velocity_frames:
            return self._ignored("setpoint in another frame")
        state = self._state
        vertical = ned_velocity(message.vx, message.vy, velocity[2], velocity[3])
        if frame == m.MAV_FRAME_LOCAL_NED:
            vx_mps, vy_mps = vertical.vx_mps, vertical.vy_mps
        else:
            vx_mps, vy_mps = body_velocity(state, velocity[0], velocity[1])
        state.target = Target(state.t_s, vx_mps, vy_mps, vertical.vz_mps, vertical.yaw_rate_radps)
        state.target_times_s.append(state.t_s)
        personality.on_setpoint(state)
        return []

    def _odometry(self, message: Message) -> list[Message]:
        angles = angles_of(message.q)
        yaw_rad = None if angles is None else angles[0]
        where, stamp_s = (message.x, message.y, message.z), message.time_usec * 1e-6
        return self._feed(message, where, yaw_rad, stamp_s, with_speed=True)

    def _vision_position(self, message: Message) -> list[Message]:
        yaw_rad = message.yaw if math.isfinite(message.yaw) else None
        where = (message.x, message.y, message.z)
        return self._feed(message, where, yaw_rad, message.usec * 1e-6, with_speed=False)

    def _vision_speed(self, message: Message) -> list[Message]:
        if not finite(message.x, message.y, message.z):
            return self._ignored("odometry that is no number")
        self._state.estimator.fed_speed_s = self._state.t_s
        return []

    def _feed(
        self,
        message: Message,
        where: tuple[float, float, float],
        ned_yaw_rad: float | None,
        stamp_s: float,
        with_speed: bool,
    ) -> list[Message]:
        state, personality = self._state, self._personality
        ned = personality.takes_odometry(state, message)
        if ned is None or personality.gps_set_up(state):
            return self._ignored("odometry that is not used")
        if ned_yaw_rad is None or not finite(*where):
            return self._ignored("odometry that is no number")
        sync = self._syncs.get((message.get_srcSystem(), message.get_srcComponent()))
        if personality.synchronises_odometry and sync is not None and sync.count >= _CONVERGED:
            off_s = stamp_s - sync.offset_s - state.since_boot_s
            if abs(off_s) > _STAMP_OFF_S:
                return self._ignored("odometry stamped with another clock")
        north_m, east_m, down_m = where
        pose = pose_from_ned(NedPose(state.t_s, north_m, east_m, down_m, 0.0, 0.0, ned_yaw_rad, 0.0, 0.0, 0.0, 0.0))
        z_m = pose.z_m if personality.height_from_odometry(state) else state.estimator.pose.z_m
        state.estimator.feed(Odometry(pose.x_m, pose.y_m, z_m, pose.yaw_rad, ned), state.t_s)
        if with_speed:
            state.estimator.fed_speed_s = state.t_s
        return []

    def _obstacles(self, message: Message) -> list[Message]:
        if message.frame != m.MAV_FRAME_BODY_FRD:
            return self._ignored("obstacles in another frame")
        step_deg = message.increment_f if message.increment_f > 0.0 else float(message.increment)
        start_deg = message.angle_offset
        if not finite(step_deg, start_deg):
            return self._ignored("obstacles that are no numbers")
        near = [
            (cm, i)
            for i, cm in enumerate(message.distances)
            if cm != _NO_RANGE and message.min_distance <= cm <= message.max_distance
        ]
        range_cm, index = min(near, default=(_NO_RANGE, 0))
        bearing_rad = math.radians(start_deg + index * step_deg)
        range_m = range_cm / 100.0 if near else math.inf
        self._state.obstacles = Obstacles(self._state.t_s, bearing_rad, range_m)
        return []

    def _global_origin(self, message: Message) -> list[Message]:
        state = self._state
        if abs(message.latitude) > 900_000_000 or abs(message.longitude) > 1_800_000_000:
            return self._ignored("origin off the globe")
        origin = message.latitude, message.longitude, message.altitude
        if not self._personality.gps_set_up(state):
            if state.origin is None:
                state.origin, state.origin_s = origin, state.t_s
            elif self._personality.takes_another_origin:
                # The altitude stays, so the height above the new origin is another one.
                state.estimator.raise_height((state.origin[2] - origin[2]) / 1e3)
                state.origin = origin
        if state.origin is None:
            return []
        return [m.MAVLink_gps_global_origin_message(*state.origin)]

    def _timesync(self, message: Message) -> list[Message]:
        now_ns = math.floor(self._state.since_boot_s * 1e9)
        if message.tc1 == 0:
            return [m.MAVLink_timesync_message(now_ns, message.ts1)]
        source = (message.get_srcSystem(), message.get_srcComponent())
        if source not in self._syncs and len(self._syncs) >= _SYNC_PARTNERS:
            return self._ignored("too many clocks")
        sync = self._syncs.setdefault(source, _Sync())
        sync.count += 1
        sync.offset_s = (message.tc1 - (message.ts1 + now_ns) / 2) * 1e-9
        return []

    def _mission_list(self, message: Message) -> list[Message]:
        source = message.get_srcSystem(), message.get_srcComponent()
        return [m.MAVLink_mission_count_message(*source, 0, message.mission_type)]
