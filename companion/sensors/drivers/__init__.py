"""Sensor drivers: what talks to a camera or a rangefinder and puts its readings into the `SensorSink`.

A driver is found by name through the entry-point group `companion.sensors`, so a package of yours adds one:

    [project.entry-points."companion.sensors"]
    my_camera = "my_package.my_camera:create"   # (Settings, DriverContext) -> SensorDriver
"""

from companion.sensors.drivers.driver import GROUP, DriverContext, DriverFactory, SensorDriver, load_drivers

__all__ = ["GROUP", "DriverContext", "DriverFactory", "SensorDriver", "load_drivers"]
