"""Where the clock of another computer stands, from whatever tells it best."""

from __future__ import annotations

import math

from companion.clock.one_way import OneWay
from companion.clock.round_trips import RoundTrip, RoundTrips

DISAGREEMENT_S = 1.0
"""Beyond this the round trips are about another clock than the stamps, and the stamps' own delay is used."""
STALE_S = 0.1
"""When the bound has grown by this since the last answer, the stamps' own delay is nearer to the truth."""
LARGEST_S = 1e12
"""30,000 years: what is further away, or not finite, is no time."""


class ClockAlignment:
    """Moves stamps of another computer's clock, which may run faster or slower than ours, to ours.

    Round trips (`add`) are believed before stamps that come unasked (`add_one_way`), unless the two disagree by more
    than `DISAGREEMENT_S`, which shows that the answers are about another clock, or answers have not come for so long
    that the drift since then is not known. Numbers that are no time, and answers that came before their question, are
    counted in `refused` and ignored. Memory is bounded.
    """

    def __init__(self) -> None:
        self._round_trips = RoundTrips()
        self._one_way = OneWay()
        self._last_stamp_s = 0.0
        self._believed: RoundTrips | OneWay = self._one_way
        self.refused = 0
        self.restarts = 0

    def add(self, sent_s: float, remote_s: float, received_s: float) -> None:
        """One round trip: asked at ``sent_s``, answered at ``remote_s`` of the other clock, heard at ``received_s``."""
        if not all(abs(time_s) <= LARGEST_S for time_s in (sent_s, remote_s, received_s)) or received_s < sent_s:
            self.refused += 1
            return
        self._round_trips.add(RoundTrip(sent_s, remote_s, received_s))
        self._choose(received_s)

    def add_one_way(self, remote_s: float, received_s: float) -> None:
        """A stamp ``remote_s`` of the other clock that was heard at ``received_s``."""
        if not (abs(remote_s) <= LARGEST_S and abs(received_s) <= LARGEST_S):
            self.refused += 1
            return
        if not self._one_way.add(remote_s, received_s):
            self._round_trips, self._one_way = RoundTrips(), OneWay()
            self._one_way.add(remote_s, received_s)
            self.restarts += 1
        self._last_stamp_s = remote_s
        self._choose(received_s)

    def _choose(self, now_s: float) -> None:
        asked, heard = self._round_trips, self._one_way
        self._believed = asked
        if not asked.known:
            self._believed = heard
        elif heard.known:
            apart_s = abs(asked.to_local_s(self._last_stamp_s) - heard.to_local_s(self._last_stamp_s))
            spread_s = heard.residual_s(now_s)
            if apart_s > DISAGREEMENT_S or (spread_s is not None and asked.grown_s(now_s) > spread_s + STALE_S):
                self._believed = heard

    @property
    def rate(self) -> float | None:
        """Seconds of the other clock in one of ours: 0.98 runs 2 % slow; None until something has been heard."""
        return 1.0 / self._believed.rate if self._believed.known else None

    @property
    def round_trip_s(self) -> float | None:
        """The quickest of the round trips that are believed; None when there are none, or about another clock."""
        believed = self._believed
        return believed.quickest_s if isinstance(believed, RoundTrips) else None

    def residual_s(self, now_s: float) -> float | None:
        """Bound of the error of what the other clock stamps ``now_s``, in s: it grows until the next round trip.

        Without round trips it is the spread of the least delays of several seconds, None in the first; a delay that
        never changes cannot be seen.
        """
        return self._believed.residual_s(now_s) if self._believed.known else None

    def to_local_s(self, remote_s: float) -> float | None:
        """A stamp of the other clock in seconds of this computer; None until aligned or when it is not finite."""
        if not self._believed.known or not math.isfinite(remote_s):
            return None
        return self._believed.to_local_s(remote_s)
