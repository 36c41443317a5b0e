"""Devices to frames: drivers, the sink that takes their readings, and how fresh, fast and alive each stream is.

The names below are the face for authors of drivers, as `docs/drivers.md` shows them in use. They are stable: within a
major release none is removed and no signature or field of theirs changes in a way that breaks a driver. What is in the
modules beneath may change at any time.
"""

from companion.clock import Clock, MonotonicClock
from companion.config.load import load_settings
from companion.config.settings import Settings
from companion.errors import InputError
from companion.model import Beam, Camera, RangeReading
from companion.sensors.drivers.driver import DriverContext, DriverFactory, SensorDriver
from companion.sensors.drivers.stream_server import StreamServer
from companion.sensors.sink import DEPTH, PLANAR, RawDepth, RawPlanar, SensorSink

__all__ = [
    "DEPTH",
    "PLANAR",
    "Beam",
    "Camera",
    "Clock",
    "DriverContext",
    "DriverFactory",
    "InputError",
    "MonotonicClock",
    "RangeReading",
    "RawDepth",
    "RawPlanar",
    "SensorDriver",
    "SensorSink",
    "Settings",
    "StreamServer",
    "load_settings",
]
