"""Where on the globe the simulated world lies, so that a true position can leave as latitude and longitude.

World x is east, y is north and z is up of the fixed point below. A reader turns the truth messages into world metres
with `to_world`: HIL_STATE_QUATERNION has lat and lon in 1e-7 degrees and alt in mm, SIM_STATE has lat_int and lon_int
in 1e-7 degrees and alt in m. One unit of latitude is 11.1 mm, which is how fine the truth gets; between two messages
the velocities of the message (cm/s, or m/s) interpolate. A real simulator knows no such point: there the first message
is the start.
"""

from __future__ import annotations

import math

ORIGIN_LAT_DEG = 47.397742
ORIGIN_LON_DEG = 8.545594
ORIGIN_ALT_M = 489.4
"""Above sea level, where world z is 0."""

EARTH_RADIUS_M = 6_371_000.0
"""As in PX4's map projection. ArduPilot counts with 6 378 137 m, which makes a thousandth of difference."""

_M_PER_E7 = math.radians(1e-7) * EARTH_RADIUS_M

GlobalPosition = tuple[int, int, int]
"""Latitude and longitude in 1e-7 degrees, altitude above sea level in mm."""

ORIGIN: GlobalPosition = (round(ORIGIN_LAT_DEG * 1e7), round(ORIGIN_LON_DEG * 1e7), round(ORIGIN_ALT_M * 1e3))


def to_global(x_m: float, y_m: float, z_m: float, origin: GlobalPosition = ORIGIN) -> GlobalPosition:
    """The global position of a point that is x east, y north and z above ``origin``, on a flat earth."""
    lat_e7, lon_e7, alt_mm = origin
    return (
        lat_e7 + round(y_m / _M_PER_E7),
        lon_e7 + round(x_m / (_M_PER_E7 * _narrowing(origin))),
        alt_mm + round(z_m * 1e3),
    )


def to_world(lat_e7: int, lon_e7: int, alt_mm: float, origin: GlobalPosition = ORIGIN) -> tuple[float, float, float]:
    """x, y, z in m, the inverse of `to_global` up to its rounding."""
    return (
        (lon_e7 - origin[1]) * _M_PER_E7 * _narrowing(origin),
        (lat_e7 - origin[0]) * _M_PER_E7,
        (alt_mm - origin[2]) / 1e3,
    )


def _narrowing(origin: GlobalPosition) -> float:
    """How much shorter a degree of longitude is than one of latitude."""
    return math.cos(math.radians(origin[0] * 1e-7))


def zero_from(origin: GlobalPosition) -> tuple[float, float]:
    """Where latitude 0, longitude 0 lies, in m east and north of ``origin``, as an azimuthal projection has it."""
    lat_rad, lon_rad = math.radians(origin[0] * 1e-7), math.radians(origin[1] * 1e-7)
    east, north = math.sin(-lon_rad), -math.sin(lat_rad) * math.cos(lon_rad)
    distance_m = EARTH_RADIUS_M * math.acos(max(-1.0, min(1.0, math.cos(lat_rad) * math.cos(lon_rad))))
    share = distance_m / max(math.hypot(east, north), 1e-12)
    return share * east, share * north
