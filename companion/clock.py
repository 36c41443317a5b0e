"""Time, handed in: the clock of this computer, and where the clock of another one stands against it.

Everything in the application is stamped in seconds of `time.monotonic` of the computer that it runs on. What other
clocks say (the autopilot's time since boot, a camera's time) is moved over by a `ClockAlignment`.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections import deque
from typing import Protocol

ROUND_TRIPS = 24
"""How many round trips are remembered."""
TRUSTED = 5
"""How many of them, the quickest, are believed."""
ROUND_TRIP_WINDOW_S = 60.0
"""Older ones are forgotten: two crystals drift apart by up to 50 ppm, 3 ms in this time."""
BUCKET_S, BUCKETS = 1.0, 10
"""One-way delays are kept as the least of each second, for ten seconds."""
JUMP_S = 0.1
"""A round trip that contradicts what is known by more than this shows that the other clock was set anew."""
ONE_WAY_JUMP_S = 0.5
"""The same for stamps that come unasked. They have no bound of their own, so several in a row must agree."""
JUMP_COUNT = 3
DISAGREEMENT_S = 1.0
"""Beyond this the round trips are about another clock than the stamps, and the stamps' own delay is used."""
LARGEST_S = 1e12
"""30,000 years: what is further away, or not finite, is no time."""


class Clock(Protocol):
    """Where time comes from, and who waits for it; tests hand in one on which no real time passes."""

    def now_s(self) -> float:
        """Seconds since some fixed moment; never goes back."""
        ...

    async def sleep(self, time_s: float) -> None:
        """Return when ``time_s`` has passed on this clock; others run meanwhile, also when it is 0 or less."""
        ...


class MonotonicClock:
    """The clock of this computer that no one can set."""

    def now_s(self) -> float:
        """Seconds of `time.monotonic`."""
        return time.monotonic()

    async def sleep(self, time_s: float) -> None:
        """Real time passes."""
        await asyncio.sleep(time_s)


class _RoundTrips:
    """Questions and answers: the offset lies within half a round trip of the middle."""

    def __init__(self) -> None:
        self._trips: deque[tuple[float, float, float]] = deque(maxlen=ROUND_TRIPS)  # received, offset, round trip
        self.offset_s: float | None = None
        self.residual_s: float | None = None

    def add(self, sent_s: float, remote_s: float, received_s: float) -> None:
        round_trip_s = received_s - sent_s
        offset_s = 0.5 * (sent_s + received_s) - remote_s
        if self.offset_s is not None and self.residual_s is not None:
            contradiction_s = abs(offset_s - self.offset_s) - 0.5 * round_trip_s - self.residual_s
            if contradiction_s > JUMP_S:
                self._trips.clear()
        self._trips.append((received_s, offset_s, round_trip_s))
        while self._trips[0][0] < received_s - ROUND_TRIP_WINDOW_S:
            self._trips.popleft()
        best = sorted(self._trips, key=lambda trip: trip[2])[:TRUSTED]
        offsets = sorted(trip[1] for trip in best)
        self.offset_s = offsets[len(offsets) // 2]
        self.residual_s = 0.5 * best[0][2] + (offsets[-1] - offsets[0])


class _OneWay:
    """Stamps that come unasked: the message with the least delay is nearest to the truth, and never before it."""

    def __init__(self) -> None:
        self._least: deque[tuple[float, float]] = deque(maxlen=BUCKETS)  # start of the bucket, least delay in it
        self._last_remote_s = -math.inf
        self._contradictions = 0
        self.offset_s: float | None = None
        self.residual_s: float | None = None

    def add(self, remote_s: float, received_s: float) -> bool:
        """True when the other clock has been set anew and the alignment begins again."""
        delay_s = received_s - remote_s
        went_back = remote_s < self._last_remote_s - ONE_WAY_JUMP_S
        leapt = self.offset_s is not None and delay_s < self.offset_s - ONE_WAY_JUMP_S
        jumped = False
        if went_back or leapt:
            # One stray stamp, replayed or corrupt, must not throw away what is known.
            self._contradictions += 1
            if self._contradictions < JUMP_COUNT:
                return False
            self._least.clear()
            self._last_remote_s = -math.inf
            jumped = True
        self._contradictions = 0
        self._last_remote_s = max(self._last_remote_s, remote_s)
        if not self._least or received_s - self._least[-1][0] >= BUCKET_S:
            self._least.append((received_s, delay_s))
        else:
            self._least[-1] = (self._least[-1][0], min(self._least[-1][1], delay_s))
        while self._least[0][0] < received_s - BUCKET_S * BUCKETS:
            self._least.popleft()
        delays = [delay for _, delay in self._least]
        self.offset_s = min(delays)
        # Of one second alone nobody can say how far its least delay may be from the least.
        self.residual_s = max(delays) - self.offset_s if len(delays) > 1 else None
        return jumped


class ClockAlignment:
    """Where the clock of another computer stands: local = remote + `offset_s`.

    Round trips (`add`) are believed before stamps that come unasked (`add_one_way`), unless the two disagree by more
    than `DISAGREEMENT_S`: then the answers are about another clock. Numbers that are no time, and answers that came
    before their question, are counted in `refused` and ignored. Memory is bounded.
    """

    def __init__(self) -> None:
        self._round_trips = _RoundTrips()
        self._one_way = _OneWay()
        self.refused = 0
        self.restarts = 0

    def add(self, sent_s: float, remote_s: float, received_s: float) -> None:
        """One round trip: asked at ``sent_s``, answered at ``remote_s`` of the other clock, heard at ``received_s``."""
        if not all(abs(time_s) <= LARGEST_S for time_s in (sent_s, remote_s, received_s)) or received_s < sent_s:
            self.refused += 1
            return
        self._round_trips.add(sent_s, remote_s, received_s)

    def add_one_way(self, remote_s: float, received_s: float) -> None:
        """A stamp ``remote_s`` of the other clock that was heard at ``received_s``."""
        if not (abs(remote_s) <= LARGEST_S and abs(received_s) <= LARGEST_S):
            self.refused += 1
            return
        if self._one_way.add(remote_s, received_s):
            self._round_trips = _RoundTrips()
            self.restarts += 1

    def _believed(self) -> _RoundTrips | _OneWay:
        asked, heard = self._round_trips, self._one_way
        if asked.offset_s is None:
            return heard
        if heard.offset_s is not None and abs(asked.offset_s - heard.offset_s) > DISAGREEMENT_S:
            return heard
        return asked

    @property
    def offset_s(self) -> float | None:
        """What to add to a stamp of the other clock, in s; None until something has been heard."""
        return self._believed().offset_s

    @property
    def residual_s(self) -> float | None:
        """Bound of the error of `offset_s`, in s: half the quickest round trip plus the spread of those believed.

        Without round trips it is the spread of the least delays of several seconds, None in the first; a delay that
        never changes cannot be seen.
        """
        return self._believed().residual_s

    def to_local_s(self, remote_s: float) -> float | None:
        """A stamp of the other clock in seconds of this computer; None until aligned or when it is not finite."""
        offset_s = self.offset_s
        if offset_s is None or not math.isfinite(remote_s):
            return None
        return remote_s + offset_s
