"""The search for a good tour: a greedy cover by looks, put in order, and made shorter piece by piece."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled
from companion.model import wrap_rad
from sitl.tour.views import HEADINGS, Views
from sitl.tour.ways import Leg, Ways

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

UNIT_RAD = 2.0 * math.pi / HEADINGS

_ALONG_M = 0.5
"""On a way what is ahead is looked at this often."""

_OUT = 4
"""So many looks are taken out at most in a round."""

_BEST = 24
"""Of so many looks that add most, that is put in which adds most for its time."""

_LOOK_S = 0.5
"""What a look costs besides its way when they are compared, so that one that costs nothing does not win by it."""

_WARM = 0.01
"""A tour longer than the last by this share is gone on from with probability 1/e at first, and hardly at the end."""

_MOVED, _TURNED = 0.15, 0.3
"""Shares of the rounds in which a piece of the tour is turned round, and (the rest up to this) put elsewhere."""


@dataclass(frozen=True, slots=True)
class Pace:
    """How fast is flown and turned."""

    speed_mps: float
    yaw_rate_radps: float

    def takes_s(self, length_m: float, turned_rad: float) -> float:
        """The time for a way and for all turns on it: what turns does not fly."""
        return length_m / self.speed_mps + turned_rad / self.yaw_rate_radps


@dataclass(frozen=True, slots=True)
class Look:
    """Where the tour stops and points.

    Attributes:
        node: the place on the ways.
        place: the place of the views; beside it only at the start of the tour.
        yaw_rad: where it points.
    """

    node: int
    place: int
    yaw_rad: float


class Planner:
    """Searches for the order of looks, from a start, that sees enough in the shortest time.

    What is ahead on the way between two looks, and all that a turn passes, is seen as well.

    Args:
        ways: over the traveling surface.
        nodes: (k,) the places of ``ways`` from which ``views`` looks.
        views: which patches a look sees, from `looks_at`.
        shares: (patches,) of the surface.
        start: the place of ``ways`` where the tour begins, and where the vehicle points there.
        pace: how fast it flies and turns.
        rng: draws what is tried.
    """

    def __init__(
        self,
        ways: Ways,
        nodes: Indices,
        views: Views,
        shares: Array,
        start: tuple[int, float],
        pace: Pace,
        rng: np.random.Generator,
    ) -> None:
        self._ways = ways
        self._nodes = nodes
        self._views = views
        self._shares = shares
        self._pace = pace
        self._rng = rng
        self._near = _nearest(ways.places_m[nodes], ways.places_m)
        self._start = Look(start[0], int(self._near[start[0]]), start[1])
        self._seen_on: dict[tuple[int, int], Indices] = {}
        self._takes_s: dict[tuple[Look, Look], float] = {}

    def search(self, needed: float, rounds: int, tour: list[Look] | None = None) -> list[Look]:
        """The best tour found that sees the share ``needed``, or all that can be seen if that is less.

        Args:
            needed: share of the surface.
            rounds: of taking looks out and putting others in.
            tour: to go on from; else one is made.
        """
        needed = min(needed, float(self._shares[self._views.visible].sum()) - 1e-9)
        if tour is None:
            tour = self._in_order(self._cover(needed))
        now = self._without_idle(self._filled(tour, needed), needed, len(tour))
        now_s = best_s = self.time_s(now)
        best = now
        for k in range(rounds):
            tried = self._without_idle(self._filled(self._thinned(now), needed), needed, _OUT)
            tried_s = self.time_s(tried)
            warm_s = _WARM * best_s * (1.0 - k / rounds)
            if tried_s < now_s or self._rng.random() < math.exp((now_s - tried_s) / warm_s):
                now, now_s = tried, tried_s
            if tried_s < best_s:
                best, best_s = tried, tried_s
        return best

    def time_s(self, tour: list[Look]) -> float:
        """How long a tour takes."""
        return sum(itertools.starmap(self._between_s, itertools.pairwise((self._start, *tour))))

    def length_m(self, tour: list[Look]) -> float:
        """The length of its ways."""
        return sum(leg.length_m for _, _, leg in self.legs(tour))

    def legs(self, tour: list[Look]) -> Iterator[tuple[Look, Look, Leg]]:
        """The looks that follow on each other, from the start, and the way between them."""
        for a, b in itertools.pairwise((self._start, *tour)):
            yield a, b, self._ways.leg(a.node, b.node)

    def _between_s(self, a: Look, b: Look) -> float:
        """From one look to another: the way, and the turns at both ends of it and on it."""
        known_s = self._takes_s.get((a, b))
        if known_s is None:
            leg = self._ways.leg(a.node, b.node)
            yaws_rad = [a.yaw_rad, *leg.headings_rad.tolist(), b.yaw_rad]
            turned_rad = sum(abs(wrap_rad(after - before)) for before, after in itertools.pairwise(yaws_rad))
            known_s = self._takes_s[a, b] = self._pace.takes_s(leg.length_m, turned_rad)
        return known_s

    # What is seen.

    def _share(self, tour: list[Look]) -> float:
        return float(self._shares[self._seen(tour)].sum())

    def _seen(self, tour: list[Look]) -> NDArray[np.bool_]:
        seen = np.zeros(len(self._shares), np.bool_)
        for a, b, leg in self.legs(tour):
            arrives_rad = a.yaw_rad
            if len(leg.headings_rad):
                seen[self._of_turn(a.place, a.yaw_rad, float(leg.headings_rad[0]))] = True
                seen[self._on_way(a, b, leg)] = True
                arrives_rad = float(leg.headings_rad[-1])
            seen[self._of_turn(b.place, arrives_rad, b.yaw_rad)] = True
        return seen

    def _on_way(self, a: Look, b: Look, leg: Leg) -> Indices:
        """The patches that are seen between two places: ahead, and while it turns at corners."""
        key = a.node, b.node
        if key not in self._seen_on:
            found = []
            before_rad = float(leg.headings_rad[0])
            for k, heading_rad in enumerate(leg.headings_rad.tolist()):
                way_m = leg.points_m[k + 1] - leg.points_m[k]
                pieces = max(1, math.ceil(float(np.linalg.norm(way_m)) / _ALONG_M))
                points_m = leg.points_m[k] + way_m * (np.arange(pieces) / pieces)[:, None]
                places = self._near[self._ways.nearest(points_m)]
                found.append(self._of_turn(int(places[0]), before_rad, heading_rad))
                heading = round(heading_rad / UNIT_RAD) % HEADINGS
                found += [self._views.of(place, heading) for place in set(places.tolist())]
                before_rad = heading_rad
            self._seen_on[key] = np.unique(np.concatenate(found))
        return self._seen_on[key]

    def _of_turn(self, place: int, from_rad: float, to_rad: float) -> Indices:
        """The patches that are seen while the vehicle turns on a spot."""
        first = round(from_rad / UNIT_RAD)
        last = round((from_rad + wrap_rad(to_rad - from_rad)) / UNIT_RAD)
        headings = range(min(first, last), max(first, last) + 1)
        return np.concatenate([self._views.of(place, heading % HEADINGS) for heading in headings])

    # The first tour.

    def _cover(self, needed: float) -> list[Look]:
        """Looks that see the share: always the one that adds most."""
        missing = self._shares.copy()
        looks = []
        while 1.0 - missing.sum() < needed:
            look = self._look(int(np.argmax(self._views.shares_of(missing))))
            looks.append(look)
            missing[self._views.of(look.place, round(look.yaw_rad / UNIT_RAD) % HEADINGS)] = 0.0
        return looks

    def _look(self, row: int) -> Look:
        place, heading = divmod(row, HEADINGS)
        return Look(int(self._nodes[place]), place, wrap_rad(heading * UNIT_RAD))

    def _in_order(self, looks: list[Look]) -> list[Look]:
        """Nearest neighbour from the start, then 2-opt over the lengths of the ways; the end is open."""
        nodes = np.array([self._start.node, *(look.node for look in looks)])
        lengths_m = np.stack([self._ways.lengths_m(int(node))[nodes] for node in nodes])
        order = [0]
        left = set(range(1, len(nodes)))
        while left:
            order.append(min(left, key=lambda k: float(lengths_m[order[-1], k])))
            left.remove(order[-1])
        return [looks[k - 1] for k in _two_opt(np.array(order), lengths_m)[1:]]

    # What makes it better.

    def _thinned(self, tour: list[Look]) -> list[Look]:
        """The tour with a piece of it turned round, put elsewhere, or left out."""
        if not tour:
            return tour
        draw, first = self._rng.random(), int(self._rng.integers(len(tour)))
        if draw < _MOVED:
            last = int(self._rng.integers(len(tour)))
            first, last = min(first, last), max(first, last) + 1
            return tour[:first] + tour[first:last][::-1] + tour[last:]
        size = int(self._rng.integers(1, _OUT + 1))
        piece, rest = tour[first : first + size], tour[:first] + tour[first + size :]
        if draw < _TURNED:
            to = int(self._rng.integers(len(rest) + 1))
            return rest[:to] + piece[:: 1 if self._rng.random() < 0.5 else -1] + rest[to:]
        return rest

    def _filled(self, tour: list[Look], needed: float) -> list[Look]:
        """The tour with looks put in, each where it costs least, until it sees the share."""
        tour = list(tour)
        while True:
            seen = self._seen(tour)
            missing = needed - float(self._shares[seen].sum())
            if missing <= 0.0:
                return tour
            gains = self._views.shares_of(np.where(seen, 0.0, self._shares))
            rows = np.flatnonzero(gains)
            if len(rows) > _BEST:
                rows = rows[np.argpartition(gains[rows], -_BEST)[-_BEST:]]
            # What it adds beyond what is missing is worth nothing.
            _, row, at = max(
                (min(float(gains[row]), missing) / (max(added_s, 0.0) + _LOOK_S), row, at)
                for row, added_s, at in self._put_in(rows, tour)
            )
            tour.insert(at, self._look(row))

    def _put_in(self, rows: Indices, tour: list[Look]) -> Iterator[tuple[int, float, int]]:
        """Of each look, by its row of the views, how much time it adds at least, and where in the tour that is."""
        stops = [self._start, *tour]
        nodes = self._nodes[rows // HEADINGS]
        to_m = np.stack([self._ways.lengths_m(stop.node)[nodes] for stop in stops])
        added_m = to_m.copy()
        for k, (a, b) in enumerate(itertools.pairwise(stops)):
            added_m[k] += to_m[k + 1] - self._ways.lengths_m(a.node)[b.node]
        for k, row in enumerate(rows.tolist()):
            look = self._look(row)
            # The turns are looked at only where the way is not much longer anyway.
            near = np.argsort(added_m[:, k])[:3].tolist()
            added_s, at = min((self._added_s(look, at, stops), at) for at in near)
            yield row, added_s, at

    def _added_s(self, look: Look, at: int, stops: list[Look]) -> float:
        added_s = self._between_s(stops[at], look)
        if at + 1 < len(stops):
            added_s += self._between_s(look, stops[at + 1]) - self._between_s(stops[at], stops[at + 1])
        return added_s

    def _without_idle(self, tour: list[Look], needed: float, most: int) -> list[Look]:
        """The tour without looks that are not needed: of the ``most`` that cost most one is left out, and so on."""
        while True:
            stops = [self._start, *tour]
            saved_s = [self._added_s(look, k, stops[: k + 1] + stops[k + 2 :]) for k, look in enumerate(tour)]
            for k in np.argsort(saved_s)[::-1][:most].tolist():
                tried = tour[:k] + tour[k + 1 :]
                if saved_s[k] > 0.0 and self._share(tried) >= needed:
                    tour = tried
                    break
            else:
                return tour


@compiled
def _nearest(points_m: Array, to_m: Array) -> Indices:
    """(n,) which of points (k, 3) is nearest to each of (n, 3)."""
    found = np.empty(len(to_m), np.int64)
    for i in range(len(to_m)):
        least = np.inf
        for k in range(len(points_m)):
            x, y, z = points_m[k, 0] - to_m[i, 0], points_m[k, 1] - to_m[i, 1], points_m[k, 2] - to_m[i, 2]
            off = x * x + y * y + z * z
            if off < least:
                least, found[i] = off, k
    return found


def _two_opt(order: Indices, lengths_m: Array) -> Indices:
    """An order made shorter by turning pieces round while that helps; its first stays first, its end is open."""
    order = order.copy()
    better = True
    while better:
        better = False
        for i in range(1, len(order) - 1):
            for j in range(i + 1, len(order)):
                before = lengths_m[order[i - 1], order[i]]
                after = lengths_m[order[i - 1], order[j]]
                if j + 1 < len(order):
                    before += lengths_m[order[j], order[j + 1]]
                    after += lengths_m[order[i], order[j + 1]]
                if after < before - 1e-9:
                    order[i : j + 1] = order[i : j + 1][::-1].copy()
                    better = True
    return order
