"""R3 by the smooth law: (7) for the wall that is followed, from here and from a little ahead. Pure."""

from __future__ import annotations

import math

from companion.control import boundary, laws, narrow
from companion.control.governor import room_m
from companion.control.parameters import Parameters
from companion.model import Measurement, Pose, Scan

LEAD_S, LEAD_SHARE = 1.0, 0.4
"""The smooth law also looks at the wall from where the vehicle will be in so long, at most this share of d_s ahead. It
turns away from what it comes to before that is the nearest, on an arc; it never turns towards a wall before it is
there. More would take the far wall of a narrow crossing for one that it comes to."""


def yaw_rate_radps(gamma: int, measurement: Measurement, scan: Scan, pose: Pose, parameters: Parameters) -> float:
    """(7) in R3 by the wall that is followed; 0 where there is nothing to follow.

    As it is from here or from where the vehicle will be, whichever turns further away. In the narrow the middle is
    kept instead of d_s, and what lies ahead on the other side is the other side of the way on. But where a wall is
    as near as d_c already, it is turned away from: told to keep to the middle the vehicle stood at a post of the
    mouth, too near to it to fly, and was carried 0.19 m further in.
    """
    lead_m = max(0.0, min(LEAD_S * pose.towards_mps(0.0), LEAD_SHARE * parameters.margin_m))
    has_room = measurement.d_m is None or measurement.d_m >= parameters.critical_margin_m + room_m(parameters)
    slidings_mps = []
    for ahead_m in (0.0, lead_m):
        width_m = narrow.width_m(scan, gamma, parameters, ahead_m) if has_room else None
        if width_m is None:
            wall = boundary.followed(scan, gamma, parameters.critical_margin_m, ahead_m)
            slidings_mps.append(_sliding_mps(wall, pose, parameters.margin_m, parameters))
        else:
            keep_m = min(parameters.margin_m, width_m / 2.0)
            own_mps, other_mps = (
                _sliding_mps(boundary.followed(scan, side, 0.0, ahead_m), pose, keep_m, parameters)
                for side in (gamma, -gamma)
            )
            slidings_mps.append(narrow.sliding_mps(own_mps, other_mps))
    sliding_mps = min(slidings_mps)
    return 0.0 if math.isinf(sliding_mps) else laws.following_yaw_rate_radps(gamma, sliding_mps, parameters)


def _sliding_mps(wall: tuple[float, float] | None, pose: Pose, keep_m: float, parameters: Parameters) -> float:
    """Of a wall (distance, bearing), at the smaller of the rate flown and the one asked for; infinite of none."""
    if wall is None:
        return math.inf
    d_m, bearing_rad = wall
    d_dot_mps = min(-pose.towards_mps(bearing_rad), laws.cruising_rate_mps(bearing_rad, parameters))
    return laws.sliding_mps(d_m, d_dot_mps, parameters, keep_m)
