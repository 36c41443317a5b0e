"""Past what stands in a straight: by a point from which the way on is free. Pure.

A way over known ground goes from cell to cell, half a metre wide. Through a gap that is hardly wider than the corridor
which the scan has to confirm, hardly one of its straights leads; the one that does is found in the scan.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled
from companion.model import HIT, Scan

ASIDE_M, ASIDE_STEP_M = 1.5, 0.05
"""Points are looked for so far beside the straight: a drift is hardly ever wider."""

FIRST_M, LAST_M, AHEAD_STEP_M = 0.5, 4.0, 0.25
"""And so far ahead, as far as depth is precise."""

ON_M = 4.0
"""So far on towards the target it leads: past what stands in the way, and there the way is planned anew."""

Polar = tuple[float, float]
"""Bearing and range."""


def dogleg(scan: Scan, towards_rad: float, to_go_m: float, half_width_m: float) -> tuple[Polar, Polar] | None:
    """A point, and one on the way from there to a target: of those on whose way nothing stands the shortest.

    That its legs are seen to be free is asked when they are flown, as of every straight over known ground: what lies
    aside is out of the picture now.

    Args:
        scan: N(t).
        towards_rad: bearing of the target.
        to_go_m: how far it is.
        half_width_m: half the width of both legs.
    """
    if to_go_m <= FIRST_M:
        return None
    hit = scan.state == HIT
    off_rad = scan.bearings_rad[hit] - towards_rad
    at_m = np.stack([scan.ranges_m[hit] * np.cos(off_rad), scan.ranges_m[hit] * np.sin(off_rad)], axis=1)
    legs_m = _legs(at_m, to_go_m, half_width_m)
    if not math.isfinite(legs_m[0][0]):
        return None
    first, last = ((towards_rad + math.atan2(y, x), math.hypot(x, y)) for x, y in legs_m)
    return first, last


@compiled
def _end(ahead: float, left: float, to_go_m: float) -> tuple[float, float]:
    """Where the second leg ends."""
    on = max(np.hypot(to_go_m - ahead, left), 1e-6)
    share = min(1.0, ON_M / on)
    return ahead + share * (to_go_m - ahead), left - share * left


@compiled
def _legs(
    at_m: NDArray[np.float64], to_go_m: float, half_width_m: float
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Where the two legs end, ahead and to the left; infinitely far ahead where there are none."""
    best, found = np.inf, ((np.inf, 0.0), (np.inf, 0.0))
    steps, sides = int((min(LAST_M, to_go_m) - FIRST_M) / AHEAD_STEP_M) + 1, int(ASIDE_M / ASIDE_STEP_M)
    for k in range(steps):
        ahead = FIRST_M + k * AHEAD_STEP_M
        for side in range(-sides, sides + 1):
            left = side * ASIDE_STEP_M
            length = np.hypot(ahead, left) + np.hypot(to_go_m - ahead, left)
            if length >= best:
                continue
            point, end = (ahead, left), _end(ahead, left, to_go_m)
            if (
                _has_room(at_m, point, half_width_m)
                and _has_room(at_m, end, half_width_m)
                and _is_free(at_m, (0.0, 0.0), point, half_width_m)
                and _is_free(at_m, point, end, half_width_m)
            ):
                best, found = length, (point, end)
    return found


@compiled
def _has_room(at_m: NDArray[np.float64], point: tuple[float, float], radius_m: float) -> bool:
    """Whether nothing stands about a point."""
    least = np.inf
    for i in range(at_m.shape[0]):
        least = min(least, np.hypot(at_m[i, 0] - point[0], at_m[i, 1] - point[1]))
    return least >= radius_m


@compiled
def _is_free(
    at_m: NDArray[np.float64], start: tuple[float, float], end: tuple[float, float], half_width_m: float
) -> bool:
    """Whether nothing stands in a corridor from one point to another."""
    length = np.hypot(end[0] - start[0], end[1] - start[1])
    if length == 0.0:
        return True
    cos, sin = (end[0] - start[0]) / length, (end[1] - start[1]) / length
    for i in range(at_m.shape[0]):
        x, y = at_m[i, 0] - start[0], at_m[i, 1] - start[1]
        if 0.0 < x * cos + y * sin < length and abs(y * cos - x * sin) < half_width_m:
            return False
    return True
