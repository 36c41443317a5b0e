"""The geofence: a box, a radius and a height band in the autopilot's local frame. Pure."""

from __future__ import annotations

import math

from companion.gate.plan import Geofence


def excess_m(fence: Geofence, north_m: float, east_m: float, down_m: float) -> float:
    """How far a place is outside, in m; negative or zero inside, minus infinity where nothing is fenced."""
    beyond = [-math.inf]
    for bounds, value_m in ((fence.north_m, north_m), (fence.east_m, east_m), (fence.down_m, down_m)):
        if bounds is not None:
            beyond += [bounds[0] - value_m, value_m - bounds[1]]
    if fence.radius_m is not None:
        beyond.append(math.hypot(north_m, east_m) - fence.radius_m)
    return max(beyond)
