"""What the gate says itself: stops, modes, texts for the pilot, and that it lives. Pure."""

from __future__ import annotations

import math
from collections import deque

from companion.gate.faults import Fault, Stage
from companion.mavlink.codec import Encoder
from companion.mavlink.ids import (
    MAVLINK_VERSION,
    VELOCITY_AND_YAW_RATE,
    MavAutopilot,
    MavCmd,
    MavComponent,
    MavFrame,
    MavSeverity,
    MavState,
    MavType,
)
from companion.mavlink.modes import Personality

HEARTBEAT_S = 1.0
TEXT_S = 0.5
TEXTS = 8
URGENT = 4
TEXT_BYTES = 50
NOTICES = 64

_STATES = {
    Stage.PASS: MavState.ACTIVE,
    Stage.BRAKE: MavState.CRITICAL,
    Stage.HOLD: MavState.EMERGENCY,
    Stage.LAND: MavState.EMERGENCY,
}


class Outgoing:
    """Makes the gate's own messages.

    Args:
        system_id: of the vehicle.
    """

    def __init__(self, system_id: int) -> None:
        self._encoder = Encoder(system_id, MavComponent.ONBOARD_COMPUTER2)
        self._system_id = system_id
        self._urgent: deque[str] = deque(maxlen=URGENT)
        self._texts: deque[str] = deque(maxlen=TEXTS)
        self._notices: deque[tuple[Fault | None, str]] = deque(maxlen=NOTICES)
        self._text_s = self._heartbeat_s = -math.inf

    def say(self, words: str, fault: Fault | None = None, urgent: bool = False) -> None:
        """To the pilot, the log and the application; the oldest give way when nobody listens.

        Args:
            words: what there is to say.
            fault: that it is about.
            urgent: it waits for nothing that was said before: what is being done now, before what was found.
        """
        (self._urgent if urgent else self._texts).append(words)
        self.note(words, fault)

    def note(self, words: str, fault: Fault | None = None) -> None:
        """To the log and the application only."""
        self._notices.append((fault, words))

    def drain_notices(self) -> list[tuple[Fault | None, str]]:
        """Everything that was said since the last call, and the fault that each is about."""
        taken = list(self._notices)
        self._notices.clear()
        return taken

    def due(self, stage: Stage, airborne: bool, now_s: float) -> list[bytes]:
        """Heartbeat and texts whose time has come."""
        sent: list[bytes] = []
        if now_s - self._heartbeat_s >= HEARTBEAT_S:
            self._heartbeat_s = now_s
            sent.append(
                self._encoder.pack(
                    "HEARTBEAT",
                    type=MavType.ONBOARD_CONTROLLER,
                    autopilot=MavAutopilot.INVALID,
                    system_status=_STATES[stage] if airborne else MavState.STANDBY,
                    mavlink_version=MAVLINK_VERSION,
                )
            )
        while self._urgent:
            self._text_s = now_s
            sent.append(self._text(self._urgent.popleft()))
        if self._texts and now_s - self._text_s >= TEXT_S:
            self._text_s = now_s
            sent.append(self._text(self._texts.popleft()))
        return sent

    def _text(self, words: str) -> bytes:
        return self._encoder.pack("STATUSTEXT", severity=MavSeverity.WARNING, text=f"gate: {words}"[:TEXT_BYTES])

    def velocity(self, forward_mps: float, right_mps: float, down_mps: float, now_s: float) -> bytes:
        """A setpoint of the gate's own, without turning."""
        return self._encoder.pack(
            "SET_POSITION_TARGET_LOCAL_NED",
            time_boot_ms=int(now_s * 1e3) & 0xFFFFFFFF,
            target_system=self._system_id,
            target_component=MavComponent.AUTOPILOT1,
            coordinate_frame=MavFrame.BODY_NED,
            type_mask=VELOCITY_AND_YAW_RATE,
            vx=forward_mps,
            vy=right_mps,
            vz=down_mps,
        )

    def mode(self, ours: Personality, custom_mode: int) -> tuple[bytes, dict[str, float]]:
        """Ask for a mode; also the fields of the command."""
        values = ours.set_mode_parameters(custom_mode)
        fields = dict(zip(("param1", "param2", "param3"), values, strict=True))
        raw = self._encoder.pack(
            "COMMAND_LONG",
            target_system=self._system_id,
            target_component=MavComponent.AUTOPILOT1,
            command=MavCmd.DO_SET_MODE,
            **fields,
        )
        return raw, fields

    def acknowledge(self, command: int, result: int, system_id: int, component_id: int) -> bytes:
        """The answer to a command, a MAV_RESULT, for whoever gave it."""
        return self._encoder.pack(
            "COMMAND_ACK",
            command=command,
            result=result,
            target_system=system_id,
            target_component=component_id,
        )
