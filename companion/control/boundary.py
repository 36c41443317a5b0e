"""Which of the walls in view is the boundary that is followed, and how near it is. Pure."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled
from companion.control.parameters import Parameters
from companion.model import HIT, FloatArray, Scan

NEAR_SHARE, FAR_SHARE = 1.5, 3.0
"""In units of d_s: a wall so near is followed, one so far is another one."""

NOISE_M, SPREAD_RAD = 0.05, math.radians(35.0)
"""Points this much further than the nearest, and no further round than this, are taken for as near as it."""


def nearest(scan: Scan, counts: NDArray[np.bool_]) -> tuple[float, float] | None:
    """Range and bearing of the nearest HIT of those that count, (n,) bool; None when there is none."""
    return _found(scan.bearings_rad, scan.ranges_m, (scan.state == HIT) & counts)


def followed(scan: Scan, gamma: int, half_width_m: float, lead_m: float = 0.0) -> tuple[float, float] | None:
    """Distance d and bearing α* of the boundary that R3 follows: what is on Γ's side, and what lies ahead.

    The nearest wall of all is another one wherever two walls are near: at the mouth of a niche the post on the other
    side, and a law that takes it for its own turns back in.

    Args:
        scan: N(t).
        gamma: Γ, -1 when the wall to follow is on the right, 1 when on the left.
        half_width_m: what lies ahead within this of the heading line is in the way, on whichever side it is.
        lead_m: seen from a place so far ahead of the vehicle.

    Returns:
        As `nearest`.
    """
    x_m = scan.ranges_m * np.cos(scan.bearings_rad) - lead_m
    y_m = scan.ranges_m * np.sin(scan.bearings_rad)
    counts = (scan.state == HIT) & ((gamma * y_m >= 0.0) | ((x_m > 0.0) & (np.abs(y_m) < half_width_m)))
    return _found(np.arctan2(y_m, x_m), np.hypot(x_m, y_m), counts)


def is_on_the_other_side(scan: Scan, gamma: int, parameters: Parameters) -> bool:
    """Whether the only wall that is near is not on Γ's side.

    Where a tangent was none, its Γ leads away from the wall that is really there, and through the margin of the next.
    """
    own, other = (followed(scan, side, parameters.critical_margin_m) for side in (gamma, -gamma))
    margin_m = parameters.margin_m
    return other is not None and other[0] <= NEAR_SHARE * margin_m and (own is None or own[0] > FAR_SHARE * margin_m)


def _found(bearings_rad: FloatArray, ranges_m: FloatArray, counts: NDArray[np.bool_]) -> tuple[float, float] | None:
    range_m, bearing_rad = _nearest(bearings_rad, ranges_m, counts)
    return (float(range_m), float(bearing_rad)) if np.isfinite(range_m) else None


@compiled
def _nearest(bearings: FloatArray, ranges: FloatArray, counts: NDArray[np.bool_]) -> tuple[float, float]:
    """The least range, and the middle of the bearings about it that are as near but for noise.

    Along a flat wall the range hardly changes about its foot: 2 cm of noise move the nearest single bearing by 11°, and
    with it the sign of ḋ.
    """
    nearest = -1
    for i in range(bearings.size):
        # Of two that are as near the one further ahead, so that a mirrored scan has the mirrored answer.
        if counts[i] and (
            nearest < 0
            or ranges[i] < ranges[nearest]
            or (ranges[i] == ranges[nearest] and abs(bearings[i]) < abs(bearings[nearest]))
        ):
            nearest = i
    if nearest < 0:
        return np.inf, 0.0
    total, count = 0.0, 0
    for i in range(bearings.size):
        off = (bearings[i] - bearings[nearest] + np.pi) % (2.0 * np.pi) - np.pi
        if counts[i] and abs(off) < SPREAD_RAD and ranges[i] <= ranges[nearest] + NOISE_M:
            total += off
            count += 1
    middle = bearings[nearest] + total / count
    return ranges[nearest], (middle + np.pi) % (2.0 * np.pi) - np.pi
