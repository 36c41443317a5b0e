"""Whether an autopilot's estimator says that it knows attitude, velocity and position. Pure."""

from __future__ import annotations

from companion.mavlink.firmware import AutopilotKind

ESTIMATOR = {AutopilotKind.PX4: "ESTIMATOR_STATUS", AutopilotKind.ARDUPILOT: "EKF_STATUS_REPORT"}
"""In which message each firmware says how its estimator is."""

# Bits of ESTIMATOR_STATUS.flags (PX4) and EKF_STATUS_REPORT.flags (ArduPilot): the first eight have the same names.
_POSITION_RELATIVE, _POSITION_ABSOLUTE = 8, 16
_NEEDED = (
    (1, "attitude"),
    (2, "horizontal velocity"),
    (4, "vertical velocity"),
    (_POSITION_RELATIVE | _POSITION_ABSOLUTE, "position"),
)
"""One of the bits each, and what it says is known."""

_CONSTANT_POSITION = 128
"""ArduPilot flies by no position with it. PX4 sets it whenever the vehicle is at rest: 1023 on the ground with GPS, 511
with odometry, 831 and 383 in the air; without aiding it says 229."""
_UNINITIALIZED = 1024  # ArduPilot; on PX4 this bit is a GPS glitch
_ACCELEROMETER_ERROR = 2048  # PX4
_FORBIDDEN = {
    AutopilotKind.PX4: ((_ACCELEROMETER_ERROR, "acceleration"),),
    AutopilotKind.ARDUPILOT: ((_CONSTANT_POSITION, "position"), (_UNINITIALIZED, "attitude")),
}
"""Bits with which something is not known, whatever the others say."""


def not_known(kind: AutopilotKind, flags: int) -> tuple[str, ...]:
    """What the estimator does not know of all that a flight needs, in words; nothing when all is known.

    A relative position is enough: GPS is not needed.

    Args:
        kind: of the firmware.
        flags: of the message in which its firmware says it.
    """
    lacking = [name for bits, name in _NEEDED if not flags & bits]
    lacking += [name for bit, name in _FORBIDDEN[kind] if flags & bit]
    return tuple(dict.fromkeys(lacking))


def estimator_valid(kind: AutopilotKind, flags: int) -> bool:
    """Whether it knows attitude, velocity and a position, by the flags of the message in which its firmware says so."""
    return not not_known(kind, flags)
