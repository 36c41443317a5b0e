"""Whether a position can have come from the one before by flying, in any frame. Pure."""

from __future__ import annotations

import math

LONGEST_GAP_S = 1.0
"""Over a longer gap nobody can say where a velocity should have led."""

Motion = tuple[float, float, float, float, float, float]
"""Position in m and velocity in m/s, each along three axes."""


def position_jump_m(before: Motion, after: Motion, dt_s: float) -> float:
    """Distance from x₀ + (v₀ + v₁)/2·dt, where the velocities lead, to the position x₁ that was reported, in m.

    Args:
        before: the earlier position and velocity.
        after: the later ones.
        dt_s: time between them; 0 is returned when it is not above 0 or too long to say.
    """
    if not 0.0 < dt_s < LONGEST_GAP_S:
        return 0.0
    return math.hypot(*(after[i] - before[i] - 0.5 * (before[i + 3] + after[i + 3]) * dt_s for i in range(3)))
