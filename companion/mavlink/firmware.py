"""Which autopilots we fly, and how they brake."""

from __future__ import annotations

import enum


class AutopilotKind(enum.StrEnum):
    """The firmware of the flight controller."""

    PX4 = "px4"
    ARDUPILOT = "ardupilot"


KINDS = {12: AutopilotKind.PX4, 3: AutopilotKind.ARDUPILOT}
"""MAV_AUTOPILOT of the heartbeat."""

ARDUCOPTER_BRAKE_MPS2 = 0.43
"""How ArduCopter stops. 0.5 s of silence at 0.5 m/s: 0.54 m until it stood, 0.25 m of it in the silence, so
0.5²/(2·0.29). Pre-flight refuses settings that count on more."""
