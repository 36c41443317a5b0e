"""What is near the body on its four sides, and how to make room. Pure, without numpy: gate and law share it.

An autopilot's velocity may be wrong, by 0.2 m/s with an odometry that drifts and by 0.7 m/s with a bad GPS; what the
sensors see come nearer comes nearer. So both, law and gate, also count with what is seen to close in, and move away
from what is too near, to the side and backward too.
"""

from __future__ import annotations

import math
from typing import NamedTuple

AWAY_PER_S = 2.0
"""How fast to move away, for each metre that is missing."""


class Side(NamedTuple):
    """One side of the body, as its sensors see it now, and have seen it a moment ago.

    Attributes:
        distance_m: from the middle of the body to what is nearest there; infinite: nothing near is seen, which may also
            be because nothing looks there.
        closing_mps: how fast that comes nearer: by the vehicle's own velocity, and by as much more as the distances
            say.
    """

    distance_m: float
    closing_mps: float


NOTHING_NEAR = Side(math.inf, 0.0)


class Sides(NamedTuple):
    """All four, counter-clockwise."""

    front: Side = NOTHING_NEAR
    left: Side = NOTHING_NEAR
    back: Side = NOTHING_NEAR
    right: Side = NOTHING_NEAR


NOTHING_AROUND = Sides()


def away_mps(sides: Sides, keep_m: float, most_mps: float) -> tuple[float, float]:
    """Forward and left: what makes room; zero where there is enough.

    From each side by 2/s · (keep - distance) + closing speed: it ends at ``keep_m``, begins before it against what
    comes nearer, and holds out against a drift that the autopilot knows nothing of. Between two walls it leads to the
    middle.

    Args:
        sides: as seen now.
        keep_m: the distance to keep, from the middle of the body.
        most_mps: never faster than this.
    """
    front, left, back, right = (
        max(0.0, AWAY_PER_S * (keep_m - side.distance_m) + side.closing_mps) if math.isfinite(side.distance_m) else 0.0
        for side in sides
    )
    forward_mps, left_mps = back - front, right - left
    speed_mps = math.hypot(forward_mps, left_mps)
    if not speed_mps > 0.0 or not math.isfinite(speed_mps):
        return 0.0, 0.0
    share = min(1.0, most_mps / speed_mps)
    return share * forward_mps, share * left_mps
