"""Bounds of stops: which delay and deceleration no measured stop was longer than. Pure."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

SLACK_M = 1e-9
"""Of rounding: the stops that a bound rests on are on it."""

Way = tuple[float, float]
"""Speed at the order in m/s, and how far it went in m, with all that it crept."""


@dataclass(frozen=True, slots=True)
class Bound:
    """v·delay + v²/(2·brake) + creep: what the stopping budget counts."""

    delay_s: float
    brake_mps2: float
    creep_m: float

    def way_m(self, speed_mps: float) -> float:
        """From this speed."""
        return speed_mps * self.delay_s + speed_mps**2 / (2.0 * self.brake_mps2) + self.creep_m

    def left_m(self, ways: Sequence[Way]) -> float:
        """What the longest stop leaves of it; negative where it does not hold."""
        return min(self.way_m(speed_mps) - way_m for speed_mps, way_m in ways)


def least_brake_mps2(ways: Sequence[Way], delay_s: float, creep_m: float) -> float | None:
    """The deceleration that all stops had at least, with this delay and creep.

    Returns:
        In m/s²; infinite when delay and creep cover them all; None when no speed would: something crept further.
    """
    needs = [(way_m - creep_m - speed_mps * delay_s, speed_mps) for speed_mps, way_m in ways]
    if any(need_m > 0.0 and speed_mps <= 0.0 for need_m, speed_mps in needs):
        return None
    return min((speed**2 / (2.0 * need_m) if need_m > 0.0 else math.inf for need_m, speed in needs), default=math.inf)


def tightest(ways: Sequence[Way], creep_m: float) -> Bound:
    """Of all bounds with this creep the one that is exceeded by no stop and leaves the least in sum.

    It is linear in the delay and in k = 1/(2·brake), so it is in a corner: where two stops are on the bound, or one and
    either number is 0. Then the delay is 0, or the deceleration infinite: a stop that takes the same time from any
    speed.

    Args:
        ways: with a speed above 0.
        creep_m: counted besides.

    Returns:
        The bound; one of delay 0 and infinite deceleration when the creep covers all.
    """
    needs = [(speed_mps, way_m - creep_m) for speed_mps, way_m in ways]
    corners = [(0.0, 0.0)]
    corners += [(need_m / speed, 0.0) for speed, need_m in needs]
    corners += [(0.0, need_m / speed**2) for speed, need_m in needs]
    for (speed, need_m), (other, other_m) in itertools.combinations(needs, 2):
        if speed != other:
            k = (need_m / speed - other_m / other) / (speed - other)
            corners.append((need_m / speed - k * speed, k))
    bounding = [
        (delay_s, k)
        for delay_s, k in corners
        if delay_s >= 0.0
        and k >= 0.0
        and all(speed * delay_s + speed**2 * k >= need_m - SLACK_M for speed, need_m in needs)
    ]
    delay_s, k = min(bounding, key=lambda one: math.fsum(speed * one[0] + speed**2 * one[1] for speed, _ in needs))
    return Bound(delay_s, 1.0 / (2.0 * k) if k > 0.0 else math.inf, creep_m)
