"""Whether an autopilot's estimator says that it knows attitude, velocity and position. Pure."""

from __future__ import annotations

from companion.mavlink.firmware import AutopilotKind

ESTIMATOR = {AutopilotKind.PX4: "ESTIMATOR_STATUS", AutopilotKind.ARDUPILOT: "EKF_STATUS_REPORT"}
"""In which message each firmware says how its estimator is."""

# Bits of ESTIMATOR_STATUS.flags (PX4) and EKF_STATUS_REPORT.flags (ArduPilot): the first eight are the same.
_ATTITUDE, _VELOCITY_HORIZONTAL, _VELOCITY_VERTICAL = 1, 2, 4
_POSITION_RELATIVE, _POSITION_ABSOLUTE = 8, 16
_CONSTANT_POSITION = 128
_UNINITIALIZED = 1024  # ArduPilot; on PX4 this bit is a GPS glitch
_ACCELEROMETER_ERROR = 2048  # PX4


def estimator_valid(kind: AutopilotKind, flags: int) -> bool:
    """Whether it knows attitude, velocity and a position, by the flags of the message in which its firmware says so.

    A relative position is enough: GPS is not needed.
    """
    needed = _ATTITUDE | _VELOCITY_HORIZONTAL | _VELOCITY_VERTICAL
    forbidden = _CONSTANT_POSITION | (_ACCELEROMETER_ERROR if kind is AutopilotKind.PX4 else _UNINITIALIZED)
    has_position = bool(flags & (_POSITION_RELATIVE | _POSITION_ABSOLUTE))
    return flags & needed == needed and has_position and not flags & forbidden
