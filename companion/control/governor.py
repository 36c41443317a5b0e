"""The speed governor: (12) gives a speed, the governor lowers it to what can still be braked and turned.

Steps A2 to A4 of the paper leave v(t) arbitrary, so slowing down keeps Theorem 1.
"""

from __future__ import annotations

import math

import numpy as np

from companion.compiled import compiled
from companion.control.parameters import Parameters
from companion.model import HIT, Scan

ROOM_M = 0.05
"""The vehicle brakes, and makes room, for so much more than d_c: it overshoots by a centimetre or two, and what carries
it, 0.05 m/s in a draught, then holds it outside of d_c."""

ROOM_SHARE = 0.3
"""Of what d_s leaves beyond d_c, at most: between the walls of a narrow place more would be all the room there is."""

TIGHT_SHARE = 0.85
"""Of d_c: so near to rock a vehicle that is in a place without room may still fly out of it, if it comes no nearer."""


def room_m(parameters: Parameters) -> float:
    """How much more than d_c is kept."""
    return min(ROOM_M, ROOM_SHARE * (parameters.margin_m - parameters.critical_margin_m))


def braking_speed_mps(room_m: float, reaction_s: float, brake_mps2: float) -> float:
    """Largest v with reaction·v + v²/(2·brake) <= room; 0 when there is no room."""
    if room_m <= 0.0:
        return 0.0
    delay = reaction_s * brake_mps2
    # Rounding can put the root of next to nothing below the delay.
    return max(0.0, math.sqrt(delay * delay + 2.0 * brake_mps2 * room_m) - delay)


@compiled
def _room(scan: Scan, critical_m: float, keep_m: float, lead_m: float) -> tuple[float, float, float]:
    """The way straight on until something is as near as d_c, and the largest turning radii to the left and right.

    Straight on, a point (x, y) with |y| < d_c is as near as d_c after x - √(d_c² - y²): what is passed beside does not
    stop the vehicle as early as what stands in the way.

    A left turn of radius R about (0, R) keeps ``keep_m`` from a point (x, y) ahead when x² + y² - keep² >=
    2·R·(keep + y); mirrored for a right turn. Here points are shifted back by ``lead_m``, the way flown before a turn
    takes effect.
    """
    bearings, ranges, state, _ = scan
    way = np.inf
    left = np.inf
    right = np.inf
    for i in range(bearings.size):
        if state[i] != HIT or abs(bearings[i]) >= np.pi / 2.0:
            continue
        x = ranges[i] * np.cos(bearings[i])
        y = ranges[i] * np.sin(bearings[i])
        if abs(y) < critical_m:
            way = min(way, x - np.sqrt(critical_m * critical_m - y * y))
        x = max(x - lead_m, 0.0)
        free = max(x * x + y * y - keep_m * keep_m, 0.0)
        if keep_m + y > 0.0:
            left = min(left, free / (2.0 * (keep_m + y)))
        if keep_m - y > 0.0:
            right = min(right, free / (2.0 * (keep_m - y)))
    return way, left, right


@compiled
def _way(scan: Scan, critical_m: float, axis_rad: float) -> float:
    """The way along a bearing until something is as near as d_c."""
    bearings, ranges, state, _ = scan
    way = np.inf
    for i in range(bearings.size):
        if state[i] != HIT:
            continue
        x, y = ranges[i] * np.cos(bearings[i] - axis_rad), ranges[i] * np.sin(bearings[i] - axis_rad)
        if x > 0.0 and abs(y) < critical_m:
            way = min(way, x - np.sqrt(critical_m * critical_m - y * y))
    return way


def governed_speed_mps(
    speed_mps: float,
    scan: Scan,
    nearest_m: float,
    gamma: int | None,
    forward_mps: float,
    parameters: Parameters,
    *,
    towards_rad: float = 0.0,
    escapes: bool = False,
) -> float:
    """The speed of law (12), lowered to what can be braked before d_c and turned away from before d_s.

    The turn away has the radius v/(share·u_M). It bounds the speed only where something ahead is nearer than that, d_s
    and the way of the reaction: along two walls with nothing ahead there is nothing to turn away from.

    Args:
        speed_mps: what (12) gives.
        scan: N(t).
        nearest_m: d, infinite when nothing is near.
        gamma: Γ of the wall that is followed, so that the turn away is known; None when either turn will do.
        forward_mps: the speed flown now.
        parameters: the law's settings.
        towards_rad: bearing to which it turns meanwhile. What lies along it is braked for as well: the vehicle may
            point past a wall, and turn into it faster than it can stand.
        escapes: it leaves a place without room, where something may be a little nearer than d_c already.
    """
    governor = parameters.governor
    # Already nearer than that, the vehicle must still be able to leave: it only may not come nearer.
    keep_m = min(parameters.margin_m - governor.side_margin_m, nearest_m)
    lead_m = max(forward_mps, 0.0) * governor.reaction_s
    critical_m = parameters.critical_margin_m + room_m(parameters)
    if escapes:
        critical_m = max(TIGHT_SHARE * parameters.critical_margin_m, min(critical_m, nearest_m))
    way_m, left_m, right_m = _room(scan, critical_m, keep_m, lead_m)
    radius_m = max(left_m, right_m) if gamma is None else (left_m if gamma < 0 else right_m)
    turning_radps = governor.turn_share * parameters.max_yaw_rate_radps
    # As long as what lies ahead leaves room for the turn at any speed, the walls beside need not hold one.
    turning_mps = max(radius_m, way_m + critical_m - lead_m - keep_m) * turning_radps
    turns_into_m = way_m if towards_rad == 0.0 else min(way_m, float(_way(scan, critical_m, towards_rad)))
    braking_mps = braking_speed_mps(turns_into_m, governor.reaction_s, governor.brake_mps2)
    creep_mps = governor.least_speed_mps if way_m > max(keep_m - critical_m, 0.0) else 0.0
    return min(speed_mps, max(creep_mps, min(turning_mps, braking_mps)))
