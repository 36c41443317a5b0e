"""Which autopilots we fly."""

from __future__ import annotations

import enum


class AutopilotKind(enum.StrEnum):
    """The firmware of the flight controller."""

    PX4 = "px4"
    ARDUPILOT = "ardupilot"
