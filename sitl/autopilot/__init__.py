"""A flight controller made of software: PX4 and ArduCopter as they behave on the wire, without either of them."""

from sitl.autopilot.airframe import Surroundings
from sitl.autopilot.ardupilot import ARDUPILOT
from sitl.autopilot.core import Autopilot
from sitl.autopilot.personality import Personality
from sitl.autopilot.px4 import PX4

PERSONALITIES: dict[str, Personality] = {"px4": PX4, "ardupilot": ARDUPILOT}
"""By the name that the command line takes."""

__all__ = ["ARDUPILOT", "PERSONALITIES", "PX4", "Autopilot", "Personality", "Surroundings"]
