"""Statistics of a stream of readings: its rate, its age, and what was refused of it and why."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Mapping
from dataclasses import dataclass

RATE_WINDOW_S = 2.0
"""Rates are counted over this time."""

OTHER = "other"

_MOST_REASONS = 16
_MOST_ARRIVALS = 512


@dataclass(frozen=True, slots=True)
class StreamStatistics:
    """Rate, age and refusals of one stream.

    Attributes:
        rate_hz: accepted readings a second, over the last 2 s; up to 256.
        age_s: time since the newest accepted reading was measured; infinite when there never was one.
        count: readings accepted since the start.
        dropped: readings refused since the start.
        reasons: how many were refused why; they add up to ``dropped``.
    """

    rate_hz: float
    age_s: float
    count: int
    dropped: int
    reasons: Mapping[str, int]


class Stream:
    """Counts and arrivals of one stream; guarded by the lock of its sink."""

    def __init__(self) -> None:
        self.newest_s = -math.inf
        self.count = 0
        self.reasons: Counter[str] = Counter()
        self._first_s = math.inf
        self._arrivals_s: deque[float] = deque(maxlen=_MOST_ARRIVALS)

    def accept(self, t_s: float, now_s: float) -> None:
        """Count a reading measured at ``t_s``, which came at ``now_s``."""
        self.newest_s = t_s
        self.count += 1
        self._first_s = min(self._first_s, now_s)
        self._arrivals_s.append(now_s)

    def refuse(self, reason: str) -> None:
        """Count a refusal under its reason, or under `OTHER` when there are too many of them."""
        known = reason in self.reasons or len(self.reasons) < _MOST_REASONS
        self.reasons[reason if known else OTHER] += 1

    def statistics(self, now_s: float) -> StreamStatistics:
        """Its rate, age and refusals at ``now_s``."""
        begin_s = max(self._first_s, now_s - RATE_WINDOW_S)
        # Strictly later than the beginning: n + 1 arrivals from the first on are n periods.
        arrived = sum(begin_s < arrival_s <= now_s for arrival_s in self._arrivals_s)
        return StreamStatistics(
            rate_hz=arrived / (now_s - begin_s) if arrived else 0.0,
            age_s=now_s - self.newest_s,
            count=self.count,
            dropped=self.reasons.total(),
            reasons=dict(self.reasons),
        )
