"""The gate at one moment: one message at a time, to the moment and the digit."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from companion.gate.faults import Stage
from companion.gate.gate import Gate
from companion.gate.plan import Plan, Stopping
from companion.gate.protocol import Goodbye, Phase
from companion.mavlink.codec import Frame
from companion.mavlink.firmware import AutopilotKind
from companion.mavlink.modes import Personality, personality
from tests.gate.built import AUTOPILOT, AUTOPILOT_NUMBER, BEAT, GATE, SYSTEM, command, frame, read, setpoint, texts_of
from tests.gate.built import PLAN as BUILT

NOW_S = 64.0
JUST_S = 2.0**-20
PLAN = replace(
    BUILT,
    period_s=0.125,
    silence_s=0.5,
    stopping=Stopping(delay_s=0.25, brake_mps2=0.25, creep_m=0.0),
    limits=replace(BUILT.limits, accel_mps2=100.0),
)
ORDER: dict[str, Any] = {"target_system": SYSTEM, "target_component": GATE, "command": 193, "param1": 0.0}
"""A person's, to stop: MAV_CMD_DO_PAUSE_CONTINUE."""


class Scene:
    """A gate at `NOW_S` that knows its autopilot and its application; nothing flies yet."""

    def __init__(self, plan: Plan = PLAN, kind: AutopilotKind = AutopilotKind.PX4, phase: Phase = Phase.GROUND) -> None:
        self.gate = Gate(plan, NOW_S)
        self.kind = kind
        self.heartbeat(self.ours.hold, armed=False)
        self.beat(phase)

    @property
    def ours(self) -> Personality:
        """The modes of the autopilot."""
        return personality(self.kind)

    def beat(self, phase: Phase, now_s: float = NOW_S, **changes: Any) -> None:
        """The application has ticked."""
        self.gate.on_word(replace(BEAT, t_s=now_s, phase=phase, **changes).packed(), now_s)

    def stage(self) -> Stage:
        return self.gate.stage

    def goodbye(self) -> Goodbye | None:
        return self.gate.goodbye

    def patient_since_s(self) -> float | None:
        """Since when the gate has waited for a hold."""
        return self.gate._failsafe._hold_since_s

    def heartbeat(self, mode: int, now_s: float = NOW_S, *, armed: bool = True) -> None:
        """The autopilot's."""
        self.hear("HEARTBEAT", now_s, autopilot=AUTOPILOT_NUMBER[self.kind], base_mode=128 * armed, custom_mode=mode)

    def hear(self, name: str, now_s: float = NOW_S, **fields: Any) -> None:
        """Something comes from the autopilot."""
        self.gate.on_autopilot_message(frame(name, AUTOPILOT, **fields), now_s)

    def at(self, now_s: float = NOW_S, **place: float) -> None:
        """The autopilot tells where it is, and that it looks north."""
        self.hear("LOCAL_POSITION_NED", now_s, time_boot_ms=round(1e3 * now_s), **place)
        self.hear("ATTITUDE", now_s, yaw=0.0)

    def mode(self, mode: int, now_s: float = NOW_S) -> bool:
        """The application asks for a mode; whether that passes."""
        order = command(176, *self.ours.set_mode_parameters(mode))
        return self.gate.on_application_message(order, now_s).raw == order.raw

    def passes(self, sent: Frame, now_s: float = NOW_S) -> bool:
        """The application sends something; whether it passes as it is."""
        return self.gate.on_application_message(sent, now_s).raw == sent.raw

    def fly(self) -> None:
        """Armed, in the mode of setpoints, exploring; all is well."""
        assert self.passes(command(400, 1.0))
        assert self.mode(self.ours.offboard)
        self.heartbeat(self.ours.offboard)
        self.at()
        self.beat(Phase.EXPLORING)
        assert self.passes(setpoint())
        self.gate.cycle(NOW_S)
        assert self.gate.airborne
        assert self.stage() is Stage.PASS
        texts_of(self.gate)

    def sent(self, now_s: float) -> list[int]:
        """What the gate says, by the numbers of the messages."""
        return [read(raw)[0].message_id for raw in self.gate.cycle(now_s)]


def flying(plan: Plan = PLAN, kind: AutopilotKind = AutopilotKind.PX4) -> Scene:
    scene = Scene(plan, kind)
    scene.fly()
    return scene
