"""What the gate does at each stage: streams zero velocity, asks for hold, asks for land. Pure."""

from __future__ import annotations

import math

from companion.gate.escalation import Escalation
from companion.gate.fault_monitor import FaultMonitor
from companion.gate.faults import Stage
from companion.gate.outgoing import Outgoing
from companion.gate.plan import Plan
from companion.gate.vehicle import Vehicle
from companion.mavlink.ids import MavCmd, MavComponent

ASK_AGAIN_S = 0.5
"""A command may be lost; to ask for a mode twice does no harm."""
HOLD_PATIENCE_S = 2.5
"""A hold that does not show for this long is not to be had: PX4 has none without a global origin. It lands then."""


class FailsafeActions:
    """Carries out the stage of the escalation.

    Args:
        plan: periods.
        vehicle: which mode it is in.
        monitor: whether it was ever steered.
        escalation: whose stage; raised when a hold cannot be had.
        outgoing: makes the messages.
    """

    def __init__(
        self, plan: Plan, vehicle: Vehicle, monitor: FaultMonitor, escalation: Escalation, outgoing: Outgoing
    ) -> None:
        self._plan = plan
        self._vehicle = vehicle
        self._monitor = monitor
        self._escalation = escalation
        self._outgoing = outgoing
        self._silent_s: float | None = None
        self.reset()

    def reset(self) -> None:
        """The flight is over."""
        self._stop_s = self._ask_s = -math.inf
        self._hold_since_s: float | None = None

    def link_silent(self, now_s: float) -> bool:
        """Whether nothing has come from the autopilot for so long that it may not have heard us either.

        Its own failsafe acts then, and PX4 goes back to offboard on the first setpoint that comes after. So nothing is
        sent until a heartbeat has told what it made of the silence.
        """
        if now_s - self._vehicle.heard_s > self._plan.silence_s:
            self._silent_s = now_s
        if self._silent_s is not None and self._vehicle.heartbeat_s > self._silent_s:
            self._silent_s = None
        return self._silent_s is not None

    def due(self, now_s: float) -> list[bytes]:
        """What is to be sent now."""
        if self.link_silent(now_s):
            return []
        stage = self._escalation.stage
        if stage is Stage.PASS:
            return []
        if stage is Stage.BRAKE:
            return self._stop(now_s)
        return self._take_mode(stage, now_s)

    def _stop(self, now_s: float) -> list[bytes]:
        """Zero velocity, once a period. A vehicle that was never steered by setpoints is not stopped by them.

        PX4's own take-off ignores them and ArduPilot's would be suppressed; each goes straight up and ends by itself,
        and hold comes with its own delay.
        """
        if self._monitor.asked is None or now_s - self._stop_s < self._plan.period_s:
            return []
        self._stop_s = now_s
        return [self._outgoing.stop(now_s)]

    def _take_mode(self, stage: Stage, now_s: float) -> list[bytes]:
        """Ask for the mode until it shows; stop by setpoints until then."""
        ours = self._vehicle.personality
        if self._vehicle.confirms(ours.land) or (stage is Stage.HOLD and self._vehicle.confirms(ours.hold)):
            return []
        wanted = ours.hold if stage is Stage.HOLD and self._vehicle.asked_modes != {ours.land} else ours.land
        if stage is Stage.HOLD:
            self._hold_since_s = now_s if self._hold_since_s is None else self._hold_since_s
            if now_s - self._hold_since_s > HOLD_PATIENCE_S:
                self._escalation.force(Stage.LAND)
        sent = self._stop(now_s)
        if now_s - self._ask_s >= ASK_AGAIN_S:
            self._ask_s = now_s
            raw, fields = self._outgoing.mode(ours, wanted)
            self._vehicle.on_command_sent(MavCmd.DO_SET_MODE, fields, MavComponent.ONBOARD_COMPUTER2)
            sent.append(raw)
        return sent
