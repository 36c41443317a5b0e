"""Where another clock stands, by stamps that come unasked: the least delay is nearest to the truth."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from itertools import combinations
from statistics import median
from typing import NamedTuple

from companion.clock.rates import CRYSTAL_WANDER, GRAIN_S, MOST_RATE, SIMULATION_WANDER

BUCKET_S, BUCKETS = 1.0, 10
"""The least delay of each second is kept, for ten seconds."""
RATE_BUCKETS = 4
"""Of fewer nobody can tell a rate."""
CLEAR = 8.0
"""How often the drift has to exceed what departs from it: a queue that fills grows too, but not so evenly."""
JUMP_S = 0.5
"""Stamps off by more than this contradict what is known. They have no bound of their own, so several must agree."""
JUMP_COUNT = 3


class _Heard(NamedTuple):
    remote_s: float
    received_s: float

    def begin_s(self, rate: float) -> float:
        """Where a line of this rate through it begins."""
        return self.received_s - rate * self.remote_s


class OneWay:
    """The line below all arrivals, local = begin + rate · remote: what arrived soonest is nearest to the truth.

    The rate is 1 unless the least delays of several seconds lie on a line that clearly rises or falls: that is a clock
    which runs 3 % slow, say, and no jump.
    """

    def __init__(self) -> None:
        self._least: deque[_Heard] = deque(maxlen=BUCKETS)  # of each second that is over
        self._bucket: _Heard | None = None  # the least of the second that runs
        self._bucket_began_s = -math.inf
        self._contradictions = 0
        self._furthest_s, self._heard_s = -math.inf, -math.inf
        self._begin_s = 0.0
        self._spread_s: float | None = None
        self.rate = 1.0

    @property
    def known(self) -> bool:
        """Whether anything was heard."""
        return self._bucket is not None

    def add(self, remote_s: float, received_s: float) -> bool:
        """Take a stamp. False, and it is not taken, when the other clock has been set anew: begin again with another.

        One stray stamp, replayed or corrupt, must not throw away what is known: it is ignored.
        """
        heard = _Heard(remote_s, received_s)
        if self._contradicts(heard):
            self._contradictions += 1
            return self._contradictions < JUMP_COUNT
        self._contradictions = 0
        self._furthest_s, self._heard_s = max(self._furthest_s, remote_s), received_s
        if self._bucket is None or received_s - self._bucket_began_s >= BUCKET_S:
            self._close_bucket(received_s)
            self._bucket = heard
        elif heard.begin_s(self.rate) < self._bucket.begin_s(self.rate):
            self._bucket = heard
        self._begin_s = min(self._begin_s, heard.begin_s(self.rate))
        return True

    def to_local_s(self, remote_s: float) -> float:
        """A stamp of the other clock on ours; something was heard."""
        return self._begin_s + self.rate * remote_s

    def residual_s(self, now_s: float) -> float | None:
        """How far the least delays of several seconds lie apart, and what the rate may have changed since the last."""
        if self._spread_s is None:
            return None
        wander = CRYSTAL_WANDER if self.rate == 1.0 else SIMULATION_WANDER
        return self._spread_s + wander * max(now_s - self._heard_s, 0.0)

    def _contradicts(self, heard: _Heard) -> bool:
        if self._bucket is None:
            return False
        silent_s = max(heard.received_s - self._heard_s, 0.0)
        went_back = heard.remote_s < self._furthest_s - JUMP_S
        leapt = heard.received_s < self.to_local_s(heard.remote_s) - JUMP_S - MOST_RATE * silent_s
        return went_back or leapt

    def _close_bucket(self, now_s: float) -> None:
        """Once a second: the line through what the last seconds tell."""
        if self._bucket is not None:
            self._least.append(self._bucket)
        self._bucket_began_s = now_s
        while self._least and self._least[0].received_s < now_s - BUCKET_S * (BUCKETS + 1):
            self._least.popleft()
        self.rate = _clear_rate(self._least)
        begins_s = [heard.begin_s(self.rate) for heard in self._least]
        self._begin_s = min(begins_s, default=math.inf)
        # Of one second alone nobody can say how far its least delay may be from the least.
        self._spread_s = max(begins_s) - self._begin_s if len(begins_s) > 1 else None


def _clear_rate(least: Sequence[_Heard]) -> float:
    """The rate of the line on which the least delays lie; 1 where they do not clearly lie on another."""
    rates = [
        (later.received_s - earlier.received_s) / (later.remote_s - earlier.remote_s)
        for earlier, later in combinations(least, 2)
        if later.remote_s > earlier.remote_s
    ]
    if len(least) < RATE_BUCKETS or not rates:
        return 1.0
    rate = median(rates)
    begins_s = [heard.begin_s(rate) for heard in least]
    drift_s = abs(rate - 1.0) * (least[-1].remote_s - least[0].remote_s)
    clear = drift_s > CLEAR * (max(begins_s) - min(begins_s)) and drift_s > GRAIN_S
    return rate if clear and abs(rate - 1.0) <= MOST_RATE else 1.0
