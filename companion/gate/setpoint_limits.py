"""What a velocity setpoint may be. Pure: fields in, the reason against it out."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from companion.gate.plan import Limits
from companion.mavlink.ids import VELOCITY_AND_YAW_RATE, MavComponent, MavFrame

SLACK_MPS = 0.02
"""Rounding to 32 bits, and ticks that are not evenly spaced."""
LONGEST_S = 0.5
"""A pause between setpoints allows no larger jump than this one."""

UNUSED = ("x", "y", "z", "afx", "afy", "afz", "yaw")


@dataclass(frozen=True, slots=True)
class VelocitySetpoint:
    """A velocity that was asked for in the body's forward-right-down frame, and when."""

    t_s: float
    vx_mps: float
    vy_mps: float
    vz_mps: float
    yaw_rate_radps: float

    @property
    def speed_mps(self) -> float:
        """In the plane."""
        return math.hypot(self.vx_mps, self.vy_mps)

    @property
    def only_sinks(self) -> bool:
        """Whether it asks for nothing but to go straight down."""
        return self.vz_mps >= 0.0 and not (self.vx_mps or self.vy_mps or self.yaw_rate_radps)

    @property
    def stands_still(self) -> bool:
        """Whether it asks for no movement at all."""
        return not (self.vx_mps or self.vy_mps or self.vz_mps or self.yaw_rate_radps)


@dataclass(frozen=True, slots=True)
class Unreadable:
    """A message that cannot be meant as a setpoint, and why."""

    why: str


def read(fields: Mapping[str, Any], system_id: int, now_s: float) -> VelocitySetpoint | Unreadable:
    """What a SET_POSITION_TARGET_LOCAL_NED asks for, or why it cannot be meant.

    Args:
        fields: of the message.
        system_id: of our vehicle.
        now_s: when it came.
    """
    target = fields["target_system"], fields["target_component"]
    if target != (system_id, MavComponent.AUTOPILOT1):
        return Unreadable(f"for {target[0]:.0f}/{target[1]:.0f}")
    if fields["coordinate_frame"] != MavFrame.BODY_NED:
        return Unreadable(f"in frame {fields['coordinate_frame']:.0f}")
    if fields["type_mask"] != VELOCITY_AND_YAW_RATE:
        return Unreadable(f"with type mask {fields['type_mask']:.0f}")
    asked = VelocitySetpoint(now_s, fields["vx"], fields["vy"], fields["vz"], fields["yaw_rate"])
    numbers = (asked.vx_mps, asked.vy_mps, asked.vz_mps, asked.yaw_rate_radps, *(fields[name] for name in UNUSED))
    return asked if all(map(math.isfinite, numbers)) else Unreadable("not finite")


def beyond(asked: VelocitySetpoint, before: VelocitySetpoint | None, limits: Limits, period_s: float) -> str | None:
    """Which limit a setpoint breaks; None when it may pass.

    Args:
        asked: the setpoint.
        before: the one before it from the same sender; None: it comes after a pause, from standing.
        limits: what may be asked for.
        period_s: setpoints do not come faster than this, whatever their spacing on the wire.
    """
    if asked.speed_mps > limits.speed_mps:
        return f"speed {asked.speed_mps:.2f} m/s"
    if abs(asked.vz_mps) > limits.climb_mps:
        return f"climb {abs(asked.vz_mps):.2f} m/s"
    if abs(asked.yaw_rate_radps) > limits.yaw_rate_radps:
        return f"yaw {abs(asked.yaw_rate_radps):.2f} rad/s"
    was = (0.0, 0.0, 0.0) if before is None else (before.vx_mps, before.vy_mps, before.vz_mps)
    since_s = LONGEST_S if before is None else asked.t_s - before.t_s
    most_mps = limits.accel_mps2 * min(max(since_s, period_s), LONGEST_S) + SLACK_MPS
    for old_mps, new_mps in zip(was, (asked.vx_mps, asked.vy_mps, asked.vz_mps), strict=True):
        # What turns round has stopped in between, which is always allowed.
        kept_mps = abs(old_mps) if old_mps * new_mps > 0.0 else 0.0
        if abs(new_mps) - kept_mps > most_mps:
            return f"jumps by {abs(new_mps) - kept_mps:.2f} m/s"
    return None
