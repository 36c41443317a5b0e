"""Sensor drivers: what talks to a camera or a rangefinder and puts its readings into the `SensorSink`.

`docs/drivers.md` says how a package of yours adds one; what it imports comes from `companion.sensors`.
"""
