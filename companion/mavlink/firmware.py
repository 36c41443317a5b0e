"""Which autopilots we fly, and how they brake."""

from __future__ import annotations

import enum

from companion.mavlink.ids import MavAutopilot


class AutopilotKind(enum.StrEnum):
    """The firmware of the flight controller."""

    PX4 = "px4"
    ARDUPILOT = "ardupilot"


KINDS: dict[int, AutopilotKind] = {
    MavAutopilot.PX4: AutopilotKind.PX4,
    MavAutopilot.ARDUPILOTMEGA: AutopilotKind.ARDUPILOT,
}
"""MAV_AUTOPILOT of the heartbeat."""

ARDUCOPTER_BRAKE_MPS2 = 0.43
"""How ArduCopter stops. 0.5 s of silence at 0.5 m/s: 0.54 m until it stood, 0.25 m of it in the silence, so
0.5²/(2·0.29). Pre-flight refuses settings that count on more."""
