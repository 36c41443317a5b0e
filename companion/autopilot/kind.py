"""Which autopilots we fly."""

from __future__ import annotations

import enum


class AutopilotKind(enum.StrEnum):
    """The firmware of the flight controller."""

    PX4 = "px4"
    ARDUPILOT = "ardupilot"


KINDS = {12: AutopilotKind.PX4, 3: AutopilotKind.ARDUPILOT}
"""MAV_AUTOPILOT of the heartbeat."""
