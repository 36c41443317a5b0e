"""One draw for one tangent: a tangent seen in twenty successive samples is one tangent."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(slots=True)
class _Decided:
    x_m: float
    y_m: float
    gamma: int
    seen_s: float


class TangentLedger:
    """Remembers the tangents that have been decided, for as long as they stay in view.

    Args:
        same_within_m: two edges nearer to each other than this, with the same Γ, are one.
        forget_after_s: a tangent not seen for this long may be drawn for again, as the paper wants it when the vehicle
            comes round a second time.
    """

    def __init__(self, same_within_m: float, forget_after_s: float) -> None:
        self._same_within_m = same_within_m
        self._forget_after_s = forget_after_s
        self._decided: list[_Decided] = []

    def seen_before(self, x_m: float, y_m: float, gamma: int, t_s: float) -> bool:
        """Whether this edge (world position) was decided and has stayed in view since; keeps it in view if so."""
        self._decided = [known for known in self._decided if t_s - known.seen_s <= self._forget_after_s]
        for known in self._decided:
            if known.gamma == gamma and math.hypot(known.x_m - x_m, known.y_m - y_m) <= self._same_within_m:
                known.x_m, known.y_m, known.seen_s = x_m, y_m, t_s
                return True
        return False

    def decide(self, x_m: float, y_m: float, gamma: int, t_s: float) -> None:
        """Note that a draw was taken for this edge."""
        self._decided.append(_Decided(x_m, y_m, gamma, t_s))
