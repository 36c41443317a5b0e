"""Everything that can be late or wrong, and how far the answer to it goes."""

from __future__ import annotations

import enum


class Stage(enum.IntEnum):
    """What the gate does, from the mildest to the last; a later one never gives way to an earlier one by itself."""

    PASS = 0
    """The application's setpoints pass."""
    BRAKE = 1
    """The gate streams zero velocity in their place."""
    HOLD = 2
    """The autopilot is told to stop and stay by itself."""
    LAND = 3
    """The autopilot is told to land where it is."""


class Fault(enum.StrEnum):
    """What the gate watches for. The words are the configuration's keys, and what the pilot reads."""

    SETPOINT_LATE = "setpoint_late"
    """The application explores, and no setpoint has come for too long."""
    SETPOINT_BAD = "setpoint_bad"
    """A setpoint broke a limit and was replaced by a stop."""
    BEAT_LATE = "beat_late"
    """The application's tick has not completed for too long."""
    DEPTH_STALE = "depth_stale"
    RANGES_STALE = "ranges_stale"
    POSE_STALE = "pose_stale"
    """The autopilot's position does not come, is not finite, or its stamps stand still."""
    POSE_JUMP = "pose_jump"
    """The position went where no velocity leads."""
    POSE_FROZEN = "pose_frozen"
    """Positions come that repeat each other to the last bit: no estimator in the air does that."""
    ESTIMATOR = "estimator"
    """The autopilot's estimator says that it does not know its velocity or position."""
    AIDING_LOST = "aiding_lost"
    """The estimator says that all is well, but its figures of merit stand still: nothing tells it where it is."""
    GPS_LOST = "gps_lost"
    """The autopilot flies by GPS, and its position fix is gone."""
    ODOMETRY_SILENT = "odometry_silent"
    """The odometry that passes through the gate has stopped, says the same again and again, or has leapt."""
    NOT_OBEYED = "not_obeyed"
    """Setpoints go out, and the vehicle does something else: asked to stand it moves, asked to move it stands."""
    HEARTBEAT_LOST = "heartbeat_lost"
    """No heartbeat of the autopilot."""
    LINK_LOST = "link_lost"
    """Nothing at all from the autopilot."""
    DISTANCE = "distance"
    """Nearer than the hard limit when it has stopped, and still closing."""
    FENCE = "fence"
    BATTERY = "battery"
    GROUND_STOP = "ground_stop"
    """A person at a ground station ordered a stop."""
    APPLICATION = "application"
    """The application's process died."""
    MAP = "map"
    """The process of the map does not answer."""
    FLOOD = "flood"
    """The application sends more than it can mean."""


class Clear(enum.StrEnum):
    """Whether a fault can go away by itself."""

    BY_ITSELF = "by itself"
    NEVER = "never in this flight"


CLEARS: dict[Fault, Clear] = dict.fromkeys(Fault, Clear.BY_ITSELF) | {
    Fault.GROUND_STOP: Clear.NEVER,
    Fault.APPLICATION: Clear.NEVER,
}
"""A stop that a person ordered, and a process that died, are not over because nothing more is heard of them."""
