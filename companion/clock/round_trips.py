"""Where another clock stands, by questions and answers: a line through the spans in which each answer was given."""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

from companion.clock.rates import CRYSTAL_RATE, CRYSTAL_WANDER, GRAIN_S, MOST_RATE, SIMULATION_WANDER

ROUND_TRIPS = 24
"""How many round trips are remembered: 5 s of them while a simulation is asked, half a minute otherwise."""
WINDOW_S = 60.0
"""Older ones are forgotten."""
SIMULATION_MEMORY_S = 60.0
"""A clock that ran too far from ours for a crystal is taken for a simulation's for this long."""


class RoundTrip(NamedTuple):
    """A question, what the other clock showed when it was answered, and when the answer was heard."""

    sent_s: float
    remote_s: float
    received_s: float


class RoundTrips:
    """The line local = at + rate · (remote - newest), and the bound of its error.

    Whatever the delays, an answer was given between question and hearing: each round trip is a span of our time, and
    the line passes all of them (each `GRAIN_S` longer at both ends). No delay can pull it out of a span, so a slow
    answer does no harm, and what leaves and what returns quickest bound the offset. Which rates are possible follows
    from each pair of spans; 1 is taken when it is one of them, since clocks of real hardware do not drift by what can
    be seen in seconds. Where no one line passes all spans the rate has changed: the oldest are forgotten.

    The bound holds for every rate that is possible, changing by as much as such a clock's does (`rates`).

    An answer that even a clock 5 % off could not have given is doubted: it widens the bound until the next one, which
    agrees either with it (the clock was set anew) or with what was known before.
    """

    def __init__(self) -> None:
        self._trips: deque[RoundTrip] = deque(maxlen=ROUND_TRIPS)
        self._doubted: RoundTrip | None = None
        self._newest_s = 0.0  # of the other clock; all spans and the line are told at this moment
        self._at_s = 0.0
        self.rate = 1.0
        self._least_s, self._most_s = 0.0, 0.0
        self._slowest, self._fastest = 1.0, 1.0
        self._simulation_until_s = -math.inf

    @property
    def known(self) -> bool:
        """Whether there was an answer."""
        return bool(self._trips)

    @property
    def quickest_s(self) -> float:
        """Of the round trips that the line is made of, the shortest; there is one."""
        return min(trip.received_s - trip.sent_s for trip in self._trips)

    def add(self, trip: RoundTrip) -> None:
        """One round trip, whose numbers are times and in order."""
        if self._trips:
            if self._contradicts(trip):
                if self._doubted is None or not _agree(self._doubted, trip):
                    self._doubted = trip
                    return
                self._trips = deque([self._doubted], ROUND_TRIPS)
            elif trip.remote_s <= self._newest_s:
                return  # answers that overtook each other: this one tells nothing new
        self._doubted = None
        self._trips.append(trip)
        while self._trips[0].received_s < trip.received_s - WINDOW_S:
            self._trips.popleft()
        self._fit(trip)

    def to_local_s(self, remote_s: float) -> float:
        """A stamp of the other clock on ours; there was an answer."""
        return self._at_s + self.rate * (remote_s - self._newest_s)

    def residual_s(self, now_s: float) -> float:
        """Bound of the error of what is stamped ``now_s``: it grows with the time since the newest answer."""
        passed_s = max(now_s - self._least_s, 0.0) / self._slowest
        line_s = self._at_s + self.rate * passed_s
        error_s = max(
            self._most_s + self._fastest * passed_s - line_s,
            line_s - self._least_s - self._slowest * passed_s,
        )
        if self._doubted is None:
            return error_s
        there_s, doubted = self.to_local_s(self._doubted.remote_s), self._doubted
        away_s = max(doubted.received_s - there_s, there_s - doubted.sent_s) + GRAIN_S
        return max(error_s, away_s + MOST_RATE * max(now_s - doubted.sent_s, 0.0))

    def grown_s(self, now_s: float) -> float:
        """How much of the bound is due to the time since the newest answer."""
        return (self._fastest - self._slowest) * max(now_s - self._at_s, 0.0)

    def _contradicts(self, trip: RoundTrip) -> bool:
        later_s = trip.remote_s - self._newest_s
        return _apart(self._least_s, self._most_s, later_s, trip)

    def _fit(self, newest: RoundTrip) -> None:
        slowest, fastest = self._possible_rates()
        if slowest > 1.0 + CRYSTAL_RATE or fastest < 1.0 - CRYSTAL_RATE:
            self._simulation_until_s = newest.received_s + SIMULATION_MEMORY_S
            self.rate = 0.5 * (slowest + fastest)
        else:
            usual = self.rate if newest.received_s < self._simulation_until_s else 1.0
            self.rate = min(max(usual, slowest), fastest)
        wander = SIMULATION_WANDER if newest.received_s < self._simulation_until_s else CRYSTAL_WANDER
        self._slowest = max(slowest - wander, 1.0 - MOST_RATE)
        self._fastest = min(fastest + wander, 1.0 + MOST_RATE)
        self._newest_s = newest.remote_s
        ages = [(trip, newest.remote_s - trip.remote_s) for trip in self._trips]
        self._least_s = max(trip.sent_s + self._slowest * age_s for trip, age_s in ages) - GRAIN_S
        self._most_s = min(trip.received_s + self._fastest * age_s for trip, age_s in ages) + GRAIN_S
        after_s = max(trip.sent_s + self.rate * age_s for trip, age_s in ages)
        before_s = min(trip.received_s + self.rate * age_s for trip, age_s in ages)
        self._at_s = min(max(0.5 * (after_s + before_s), self._least_s), self._most_s)

    def _possible_rates(self) -> tuple[float, float]:
        """The least and the most rate of a line through the newest spans; those before them are forgotten."""
        trips = list(self._trips)
        slowest, fastest = 1.0 - MOST_RATE, 1.0 + MOST_RATE
        for first in range(len(trips) - 2, -1, -1):
            earlier, low, high = trips[first], slowest, fastest
            for later in trips[first + 1 :]:
                passed_s = later.remote_s - earlier.remote_s
                low = max(low, (later.sent_s - earlier.received_s - 2.0 * GRAIN_S) / passed_s)
                high = min(high, (later.received_s - earlier.sent_s + 2.0 * GRAIN_S) / passed_s)
            if low > high:
                self._trips = deque(trips[first + 1 :], ROUND_TRIPS)
                break
            slowest, fastest = low, high
        return slowest, fastest


def _agree(first: RoundTrip, second: RoundTrip) -> bool:
    """Whether both can be of one clock."""
    later_s = second.remote_s - first.remote_s
    return later_s > 0.0 and not _apart(first.sent_s - GRAIN_S, first.received_s + GRAIN_S, later_s, second)


def _apart(least_s: float, most_s: float, later_s: float, trip: RoundTrip) -> bool:
    """Whether ``trip`` is out of reach for a clock that was within the span ``later_s`` of its own seconds before."""
    wander_s = MOST_RATE * abs(later_s)
    after_s, before_s = least_s + later_s - wander_s, most_s + later_s + wander_s
    return trip.received_s + GRAIN_S < after_s or trip.sent_s - GRAIN_S > before_s
