"""Which messages may go down to the autopilot. What is on no list does not pass. Pure tables."""

from __future__ import annotations

import math
from collections.abc import Mapping

from companion.mavlink.firmware import AutopilotKind
from companion.mavlink.ids import MavCmd

SETPOINT = "SET_POSITION_TARGET_LOCAL_NED"

ALWAYS = frozenset(
    {
        "HEARTBEAT",
        "TIMESYNC",
        "PARAM_REQUEST_READ",
        "PARAM_REQUEST_LIST",
        "MISSION_REQUEST_LIST",
        "MISSION_REQUEST_INT",
        "REQUEST_EVENT",
        "SET_GPS_GLOBAL_ORIGIN",
        "COMMAND_ACK",
        "STATUSTEXT",
        "NAMED_VALUE_FLOAT",
        "AUTOPILOT_VERSION",
    }
)
"""Of the application: what moves nothing."""

FILES = "FILE_TRANSFER_PROTOCOL"
OPCODE_AT = 6
"""Where its payload names the operation: behind network, system and component, sequence number and session."""
READS_FILES = frozenset({1, 2, 3, 4, 5, 14, 15})
"""Operations on the autopilot's files that change none: to end, to list, to open for reading, to read, to check. The
texts of PX4's events are in one."""

ASKING = frozenset(
    {
        MavCmd.GET_MESSAGE_INTERVAL,
        MavCmd.SET_MESSAGE_INTERVAL,
        MavCmd.REQUEST_MESSAGE,
        MavCmd.REQUEST_PROTOCOL_VERSION,
        MavCmd.REQUEST_AUTOPILOT_CAPABILITIES,
        MavCmd.RUN_PREARM_CHECKS,
    }
)
"""Commands that ask, for messages or for what is in the way of arming, and move nothing."""

MOVING = frozenset({MavCmd.DO_SET_MODE, MavCmd.COMPONENT_ARM_DISARM, MavCmd.NAV_TAKEOFF, MavCmd.NAV_LAND})
"""Commands of the application that move the vehicle."""

SETPOINTS = frozenset({SETPOINT, "SET_POSITION_TARGET_GLOBAL_INT", "SET_ATTITUDE_TARGET"})
"""No ground station needs them: who wants to steer by hand takes the vehicle first."""

ODOMETRY = frozenset(
    {"HEARTBEAT", "TIMESYNC", "ODOMETRY", "VISION_POSITION_ESTIMATE", "VISION_SPEED_ESTIMATE", "SET_GPS_GLOBAL_ORIGIN"}
)
"""Of a program that only tells the autopilot where it is."""
PLACES = frozenset({"ODOMETRY", "VISION_POSITION_ESTIMATE"})
"""Those of them that say where."""
TRACKED = PLACES | {"VISION_SPEED_ESTIMATE"}
"""Those of them that a tracker has measured."""


def mode_asked_for(kind: AutopilotKind, fields: Mapping[str, float]) -> int | None:
    """The ``custom_mode`` that a DO_SET_MODE asks for; None when it is no number of one."""
    main, sub = fields["param2"], fields["param3"]
    if not (math.isfinite(main) and math.isfinite(sub) and 0.0 <= main < 256.0 and 0.0 <= sub < 256.0):
        return None
    return int(main) << 16 | int(sub) << 24 if kind is AutopilotKind.PX4 else int(main)


def only_reads(payload: bytes) -> bool:
    """Whether a FILE_TRANSFER_PROTOCOL changes no file; zeros at its end are left out of it, and mean nothing."""
    return len(payload) > OPCODE_AT and payload[OPCODE_AT] in READS_FILES


def is_forced(fields: Mapping[str, float]) -> bool:
    """Whether an ARM_DISARM skips the autopilot's own checks, or would stop the motors in the air."""
    return fields["param2"] != 0.0
