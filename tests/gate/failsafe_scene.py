"""The gate's own actions, alone: a vehicle in the mode of setpoints, and a stage that a test sets."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from companion.gate.escalation import Escalation
from companion.gate.failsafe_actions import FailsafeActions
from companion.gate.fault_monitor import FaultMonitor
from companion.gate.faults import Stage
from companion.gate.outgoing import Outgoing
from companion.gate.setpoint_limits import VelocitySetpoint
from companion.gate.vehicle import Vehicle
from companion.mavlink.firmware import AutopilotKind
from companion.mavlink.modes import Personality, personality
from tests.gate.built import AUTOPILOT_NUMBER, read
from tests.gate.built import PLAN as BUILT

PLAN = replace(BUILT, period_s=0.0625, silence_s=0.5)


class Scene:
    """An answer with all that it needs; the vehicle is armed in the mode of setpoints, and heard all the time."""

    def __init__(self, kind: AutopilotKind = AutopilotKind.PX4, *, steered: bool = True, at_s: float = 64.0) -> None:
        self.vehicle = Vehicle(PLAN.thresholds)
        self.monitor = FaultMonitor(PLAN, self.vehicle)
        self.escalation = Escalation(PLAN.reactions, PLAN.recover_s)
        self.failsafe = FailsafeActions(PLAN, self.vehicle, self.monitor, self.escalation, Outgoing(1))
        self.kind = kind
        self.show(self.ours.offboard, at_s)
        self.ask(self.ours.offboard)
        self.show(self.ours.offboard, at_s)
        self.stamp_ms = 0
        if steered:
            self.monitor.asked = VelocitySetpoint(at_s, 0.1, 0.0, 0.0, 0.0)

    @property
    def ours(self) -> Personality:
        return personality(self.kind)

    def stage(self) -> Stage:
        return self.escalation.stage

    def show(self, mode: int, now_s: float) -> None:
        fields = {"autopilot": AUTOPILOT_NUMBER[self.kind], "base_mode": 128, "custom_mode": mode, "system_status": 4}
        self.vehicle.on_message("HEARTBEAT", fields, now_s)

    def ask(self, mode: int) -> None:
        _, main, sub = self.ours.set_mode_parameters(mode)
        self.vehicle.on_command_sent(176, {"param2": main, "param3": sub}, 191)

    def at(self, now_s: float, yaw: float = 0.0, **moved: float) -> None:
        """The autopilot tells where it is, how it moves, and where it looks."""
        self.stamp_ms += 1
        place = dict.fromkeys(("x", "y", "z", "vx", "vy", "vz"), 0.0) | moved | {"time_boot_ms": self.stamp_ms}
        self.vehicle.on_message("LOCAL_POSITION_NED", place, now_s)
        self.vehicle.on_message("ATTITUDE", {"yaw": yaw}, now_s)

    def due(self, now_s: float) -> list[Any]:
        """``"stop"``, or forward, right, down where it is not asked to stand; or the mode that was asked for."""
        if now_s - self.vehicle.heard_s > 0.25:
            self.vehicle.on_message(None, {}, now_s)
        found: list[Any] = []
        for raw in self.failsafe.due(now_s):
            frame, fields = read(raw)
            if frame.message_id == 84:
                velocity = tuple(round(fields[name], 6) for name in ("vx", "vy", "vz"))
                found.append("stop" if velocity == (0.0, 0.0, 0.0) else velocity)
                continue
            wanted = fields["param1"], fields["param2"], fields["param3"]
            ours = (self.ours.hold, self.ours.land, self.ours.offboard)
            found.append({self.ours.set_mode_parameters(mode): mode for mode in ours}[wanted])
        return found
