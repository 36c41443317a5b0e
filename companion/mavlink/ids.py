"""Numbers of MAVLink's common message set, by the names of its definitions, as far as they are used here."""

from __future__ import annotations

import enum


class MavComponent(enum.IntEnum):
    """MAV_COMPONENT: who speaks within a system."""

    ALL = 0
    AUTOPILOT1 = 1
    ONBOARD_COMPUTER = 191
    """The application."""
    ONBOARD_COMPUTER2 = 192
    """The safety gate."""


class MavType(enum.IntEnum):
    """MAV_TYPE of a heartbeat."""

    ONBOARD_CONTROLLER = 18


class MavAutopilot(enum.IntEnum):
    """MAV_AUTOPILOT of a heartbeat."""

    ARDUPILOTMEGA = 3
    INVALID = 8
    """Says a component that is none."""
    PX4 = 12


class MavState(enum.IntEnum):
    """MAV_STATE of a heartbeat."""

    UNINIT = 0
    """Says nothing of its state."""
    STANDBY = 3
    """On the ground, or in somebody else's hands."""
    ACTIVE = 4
    """Flying as it should."""
    CRITICAL = 5
    """Flying, but something is missing."""
    EMERGENCY = 6
    """The flight is being ended because of a failure."""


class MavChargeState(enum.IntEnum):
    """MAV_BATTERY_CHARGE_STATE of a BATTERY_STATUS; its text is for people."""

    UNDEFINED = 0
    OK = 1
    LOW = 2
    CRITICAL = 3
    EMERGENCY = 4
    FAILED = 5
    UNHEALTHY = 6
    CHARGING = 7

    @property
    def is_low(self) -> bool:
        """Whether a vehicle has to land with it: low, or worse."""
        return MavChargeState.LOW <= self <= MavChargeState.UNHEALTHY


class MavSysStatusSensor(enum.IntFlag):
    """MAV_SYS_STATUS_SENSOR, in the fields ``onboard_control_sensors_...`` of a SYS_STATUS."""

    RC_RECEIVER = 0x10000
    PREARM_CHECK = 0x10000000


class MavModeFlag(enum.IntFlag):
    """MAV_MODE_FLAG, in ``base_mode`` of a heartbeat."""

    CUSTOM_MODE_ENABLED = 1
    SAFETY_ARMED = 128


class MavSeverity(enum.IntEnum):
    """MAV_SEVERITY of a STATUSTEXT."""

    CRITICAL = 2
    ERROR = 3
    WARNING = 4
    NOTICE = 5
    INFO = 6


class MavFrame(enum.IntEnum):
    """MAV_FRAME."""

    BODY_NED = 8
    """Of our setpoints: forward, right, down, turned by the heading alone."""
    BODY_FRD = 12
    """Of OBSTACLE_DISTANCE: bearings counted from the heading, not from north."""


class MavCmd(enum.IntEnum):
    """MAV_CMD."""

    NAV_RETURN_TO_LAUNCH = 20
    NAV_LAND = 21
    NAV_TAKEOFF = 22
    NAV_GUIDED_ENABLE = 92
    """An item of a mission: whoever steers from outside has the vehicle from here on."""
    DO_SET_MODE = 176
    DO_PAUSE_CONTINUE = 193
    """With parameter 1 = 0 to the application a pause, to anybody else of the vehicle a stop; 1 continues."""
    MISSION_START = 300
    """Sent to the application: start the flight."""
    COMPONENT_ARM_DISARM = 400
    RUN_PREARM_CHECKS = 401
    """ArduPilot looks anew whether it could be armed, and says what is in the way; nothing moves."""
    GET_MESSAGE_INTERVAL = 510
    SET_MESSAGE_INTERVAL = 511
    REQUEST_MESSAGE = 512
    REQUEST_PROTOCOL_VERSION = 519
    REQUEST_AUTOPILOT_CAPABILITIES = 520


class MavResult(enum.IntEnum):
    """MAV_RESULT: the answer to a command."""

    ACCEPTED = 0
    TEMPORARILY_REJECTED = 1
    DENIED = 2
    UNSUPPORTED = 3
    FAILED = 4
    IN_PROGRESS = 5
    """Heard; the final answer follows."""
    CANCELLED = 6


VELOCITY_AND_YAW_RATE = 0x5C7
"""POSITION_TARGET_TYPEMASK of our setpoints: position, acceleration and yaw do not count."""
MAVLINK_VERSION = 3
"""Of a heartbeat."""
