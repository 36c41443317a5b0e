"""Setpoints to MAVLink and telemetry back, through MAVSDK; where PX4 and ArduPilot differ.

Only what is needed to speak of a link is exported here. The one over MAVSDK is in `companion.autopilot.link`: importing
it loads a native library.
"""

from companion.autopilot.interface import Handler, Link, LinkError, Message, Stream
from companion.mavlink.firmware import AutopilotKind

__all__ = ["AutopilotKind", "Handler", "Link", "LinkError", "Message", "Stream"]
