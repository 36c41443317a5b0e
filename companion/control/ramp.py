"""How fast a commanded velocity may grow: the safety gate takes a jump for a mistake, and refuses it.

Slowing down is never limited. To turn is not either: the yaw rate of the paper's law jumps by design.
"""

from __future__ import annotations

import math

from companion.model import Setpoint

LONGEST_GAP_S = 0.5
"""After a pause longer than this nobody knows that the vehicle still follows the last setpoint: it begins at rest."""


class Ramp:
    """Lets each velocity grow away from zero no faster than an acceleration, one setpoint after the other.

    Args:
        max_accel_mps2: largest growth of each.
        period_s: the sampling period: as much may have passed before the first setpoint, or the first after a pause.
    """

    def __init__(self, max_accel_mps2: float, period_s: float) -> None:
        self._max_accel_mps2 = max_accel_mps2
        self._period_s = period_s
        self._last: Setpoint | None = None

    def limit(self, wanted: Setpoint) -> Setpoint:
        """The setpoint that may be sent: never further from zero than ``wanted``, and 0 where that is no number."""
        last = self._last
        gap_s = self._period_s if last is None else wanted.t_s - last.t_s
        if last is None or not gap_s <= LONGEST_GAP_S:
            gap_s, speed_mps, climb_mps, lateral_mps = self._period_s, 0.0, 0.0, 0.0
        else:
            speed_mps, climb_mps, lateral_mps = last.speed_mps, last.climb_mps, last.lateral_mps
        most_mps = self._max_accel_mps2 * max(gap_s, 0.0)
        self._last = Setpoint(
            t_s=wanted.t_s,
            speed_mps=_grown(wanted.speed_mps, speed_mps, most_mps),
            climb_mps=_grown(wanted.climb_mps, climb_mps, most_mps),
            lateral_mps=_grown(wanted.lateral_mps, lateral_mps, most_mps),
            yaw_rate_radps=wanted.yaw_rate_radps if math.isfinite(wanted.yaw_rate_radps) else 0.0,
        )
        return self._last


def _grown(wanted: float, last: float, most: float) -> float:
    """``wanted``, but no further from zero than ``most`` beyond ``last``; the way through zero begins at zero."""
    if not math.isfinite(wanted):
        return 0.0
    before = abs(last) if math.copysign(1.0, wanted) == math.copysign(1.0, last) else 0.0
    return math.copysign(min(abs(wanted), before + most), wanted)
