"""The MAVLink 2 messages, in the one place that imports them: the dialect brings no types of its own."""

from __future__ import annotations

import math
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega

from companion.frames import NedPose, pose_from_ned
from companion.model import Pose

dialect: Any = ardupilotmega
"""The messages, commands and enumerations of ArduPilot, which hold the common ones of PX4."""

Message = Any
"""A message of ``dialect``: fields are attributes, ``get_type()`` is its name."""

MESSAGE_NAMES: dict[int, str] = {number: kind.msgname for number, kind in dialect.mavlink_map.items()}
"""Names by number."""


def finite(*values: float) -> bool:
    """Whether all of them are numbers."""
    return all(math.isfinite(value) for value in values)


def ned_velocity(north_mps: float, east_mps: float, down_mps: float, yaw_rate_radps: float) -> Pose:
    """A velocity in MAVLink's frame as a `Pose` in ours, of which only the velocities mean something."""
    return pose_from_ned(NedPose(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, north_mps, east_mps, down_mps, yaw_rate_radps))
