"""What the gate knows of the vehicle: whose it is, what it was told, and what the autopilot says of itself. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from companion.gate.aiding import Aiding
from companion.gate.allowlist import mode_asked_for
from companion.gate.battery import Battery
from companion.gate.motion import Motion
from companion.gate.odometry import Odometry
from companion.gate.plan import Thresholds
from companion.mavlink.estimator import ESTIMATOR, estimator_valid
from companion.mavlink.firmware import KINDS, AutopilotKind
from companion.mavlink.ids import MavCmd, MavModeFlag, MavResult, MavState
from companion.mavlink.mode_monitor import ModeMonitor
from companion.mavlink.modes import Personality, personality

READ = frozenset(
    {
        "HEARTBEAT", "LOCAL_POSITION_NED", "ATTITUDE", "COMMAND_ACK", "SYS_STATUS", "BATTERY_STATUS", "GPS_RAW_INT",
        "GPS_GLOBAL_ORIGIN", "GLOBAL_POSITION_INT", *ESTIMATOR.values(),
    }
)  # fmt: skip
"""The messages of the autopilot that are looked into; of the others it only counts that they came."""
NOWHERE_S = 3.0
"""An origin without a global position for this long stays without: PX4 tells the position at once when it has one."""

Fields = Mapping[str, Any]


class Vehicle:
    """Takes the autopilot's messages, and the commands that were let through to it.

    Args:
        thresholds: of positions and of the battery.

    Attributes:
        kind: which firmware; None before its first heartbeat.
        heard_s: when anything last came from the autopilot; -inf: never.
        heartbeat_s: when its last heartbeat came; -inf: never.
        motion: by its own words.
        battery: the same.
        aiding: whether something still tells it where it is.
        odometry: that passes through the gate on its way to it.
        estimator_good: None before it has said anything of its estimator.
    """

    def __init__(self, thresholds: Thresholds) -> None:
        self.kind: AutopilotKind | None = None
        self.heard_s = -math.inf
        self.heartbeat_s = -math.inf
        self.motion = Motion(thresholds.pose_jump_m)
        self.battery = Battery(thresholds.battery_percent, thresholds.battery_v)
        self.aiding = Aiding()
        self.odometry = Odometry(thresholds.pose_jump_m)
        self.estimator_good: bool | None = None
        self._mode_monitor = ModeMonitor(AutopilotKind.PX4)
        self._requests: dict[int, int] = {}  # component that asked for a mode -> number of its request
        self._asked_to_arm = False
        self._handed_over = False
        self._armed_s = math.inf
        self._origin_s = math.inf
        self._is_somewhere = False

    @property
    def personality(self) -> Personality:
        """The tables of the autopilot; PX4's before it is known, which nothing rests on."""
        return personality(self.kind or AutopilotKind.PX4)

    @property
    def armed(self) -> bool:
        """By its newest heartbeat, or by an acknowledgement that is newer than any heartbeat could tell."""
        return self._mode_monitor.maybe_armed(self._armed_s)

    @property
    def airborne(self) -> bool:
        """Armed by the application, or handed over to it in the air, and not yet disarmed."""
        return (self._asked_to_arm or self._handed_over) and self.armed

    @property
    def hands_over(self) -> bool:
        """Whether it flies a mission of its own, an item of which may hand it over; else whoever armed it has it."""
        return self._mode_monitor.mode is not None and self._mode_monitor.mode == self.personality.mission

    @property
    def taken_over(self) -> str | None:
        """The mode that somebody else chose, a pilot or a failsafe of the autopilot; None while the vehicle is ours."""
        return self._mode_monitor.taken_over

    @property
    def by_failsafe(self) -> bool:
        """Whether it was the autopilot's own failsafe that took the vehicle, and no person."""
        return self._mode_monitor.by_failsafe

    @property
    def steered(self) -> bool:
        """Whether it flies by setpoints, as far as heartbeats have shown."""
        return self.confirms(self.personality.offboard)

    def lands_elsewhere(self, now_s: float) -> bool:
        """Whether the autopilot's own landing would fly away first.

        PX4 with an origin and without a global position lands at latitude 0, longitude 0: it takes the position that
        was never told for a place. So it is with odometry whose axes are not north and east (LOCAL_FRD).
        """
        nowhere = self.kind is AutopilotKind.PX4 and not self._is_somewhere
        return nowhere and now_s - self._origin_s > NOWHERE_S

    @property
    def asked_modes(self) -> frozenset[int]:
        """The modes asked for last."""
        return self._mode_monitor.ours

    def confirms(self, mode: int) -> bool:
        """Whether a mode was asked for last, and a heartbeat has shown it since."""
        return self._mode_monitor.confirmed and self._mode_monitor.ours == {mode} and self._mode_monitor.mode == mode

    def reset(self) -> None:
        """A new application: what was asked for before does not concern it."""
        before = self._mode_monitor
        self._mode_monitor = ModeMonitor(self.kind or AutopilotKind.PX4)
        if before.mode is not None:
            self._mode_monitor.on_heartbeat(before.mode, before.armed, before.heartbeat_s)
        self._requests.clear()
        self.end_flight()

    def end_flight(self) -> None:
        """The flight is over: an arming from here on is a new one."""
        self._asked_to_arm = self._handed_over = False
        self._armed_s = math.inf
        self.aiding.reset()
        self.odometry.reset()

    def on_message(self, name: str | None, fields: Fields, now_s: float) -> None:
        """One message of the autopilot of our vehicle; its name is None when it is not one of `READ`."""
        self.heard_s = now_s
        if name == "HEARTBEAT":
            self._heartbeat(fields, now_s)
        elif name == "LOCAL_POSITION_NED":
            self.motion.position(fields, now_s, self.armed)
        elif name == "ATTITUDE":
            self.motion.attitude(fields)
        elif name == "COMMAND_ACK":
            self._acknowledged(fields, now_s)
        elif name == "SYS_STATUS":
            self.battery.on_sys_status(fields, now_s)
        elif name == "BATTERY_STATUS":
            self.battery.on_battery_status(fields)
        elif name == "GPS_RAW_INT":
            self.aiding.on_gps(fields, now_s)
        elif name == "GPS_GLOBAL_ORIGIN":
            self._origin_s = min(self._origin_s, now_s)
        elif name == "GLOBAL_POSITION_INT":
            self._is_somewhere = True
        elif self.kind is not None and name == ESTIMATOR[self.kind]:
            self.estimator_good = estimator_valid(self.kind, fields["flags"])
            self.aiding.on_estimator(self.kind, fields, now_s)

    def on_command_sent(self, command: int, fields: Fields, component: int) -> None:
        """A command that moves the vehicle was let through, or sent by the gate itself."""
        ours = self.personality
        if command == MavCmd.COMPONENT_ARM_DISARM:
            self._asked_to_arm = self._asked_to_arm or fields["param1"] == 1.0
        elif command == MavCmd.NAV_TAKEOFF:
            self._mode_monitor.request(ours.taking_off)
        elif command == MavCmd.NAV_LAND:
            self._mode_monitor.request(frozenset({ours.land}), may_disarm=True, passing=ours.passing_to(ours.land))
        elif (mode := mode_asked_for(ours.kind, fields)) is not None:
            self._handed_over = self._handed_over or (mode == ours.offboard and self.armed)
            request = self._mode_monitor.request(frozenset({mode}), mode == ours.land, ours.passing_to(mode))
            self._requests[component] = request

    def _heartbeat(self, fields: Fields, now_s: float) -> None:
        kind = KINDS.get(fields["autopilot"])
        if self.kind is None and kind is not None:
            self.kind = kind
            self._mode_monitor = ModeMonitor(kind)
        if kind is None or kind is not self.kind:
            # The firmware does not change while it flies: somebody else speaks with our vehicle's number.
            return
        self.heartbeat_s = now_s
        status = fields["system_status"]
        self.battery.on_system_status(status)
        self._mode_monitor.on_heartbeat(
            fields["custom_mode"],
            bool(fields["base_mode"] & MavModeFlag.SAFETY_ARMED),
            now_s,
            critical=status in (MavState.CRITICAL, MavState.EMERGENCY),
        )

    def _acknowledged(self, fields: Fields, now_s: float) -> None:
        good = fields["result"] in (MavResult.ACCEPTED, MavResult.IN_PROGRESS)
        if fields["command"] == MavCmd.COMPONENT_ARM_DISARM and self._asked_to_arm and not self._mode_monitor.armed:
            self._armed_s = now_s if good else math.inf
        elif fields["command"] == MavCmd.DO_SET_MODE and not good:
            request = self._requests.pop(fields["target_component"], None)
            if request is not None:
                self._mode_monitor.on_refused(request)
                self._handed_over = self._handed_over and not self.hands_over
