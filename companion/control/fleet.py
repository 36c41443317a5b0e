"""Several vehicles in one mine: who is near, and which height layer is whose (paper eq. (11))."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

PARTS = 1.25
"""Who is in a group leaves it this many times d_r away: whoever flies beside another at d_r keeps one layer."""

MOST_VEHICLES = 32
"""Of so many others reports are kept; a fleet of the paper has three."""


@dataclass(frozen=True, slots=True)
class Report:
    """A vehicle's newest position, in the frame that the vehicles share.

    Attributes:
        t_s: when it was there, by the clock of whoever reads it.
        x_m: position; so are the next two.
        y_m: see ``x_m``.
        z_m: see ``x_m``.
        height_m: above the ground there; None where it is not known.
        flies: whether it needs room in the air; one that has landed, or has not taken off, has no layer.
    """

    t_s: float
    x_m: float
    y_m: float
    z_m: float
    height_m: float | None = None
    flies: bool = True

    @property
    def is_finite(self) -> bool:
        """Whether every number of it is one."""
        numbers = (self.t_s, self.x_m, self.y_m, self.z_m, 0.0 if self.height_m is None else self.height_m)
        return all(map(math.isfinite, numbers))

    def apart_m(self, other: Report) -> float:
        """How far two vehicles are from each other."""
        return math.dist((self.x_m, self.y_m, self.z_m), (other.x_m, other.y_m, other.z_m))

    def beside_m(self, other: Report) -> float:
        """How far they are from each other in the plane."""
        return math.hypot(self.x_m - other.x_m, self.y_m - other.y_m)


class Fleet:
    """What one vehicle knows of the others.

    A vehicle that has fallen silent is not gone: it stays in the group in which it was last heard, at its last
    position, and so keeps its layer. A vehicle that hears nobody any more keeps its own.

    Args:
        own_id: this vehicle's number.
        group_range_m: d_r, vehicles nearer than this share a group.
        tunnel_height_m: d_M, the least distance from ground to roof.
        stale_after_s: the age from which on a report is stale.
    """

    def __init__(self, own_id: int, *, group_range_m: float, tunnel_height_m: float, stale_after_s: float) -> None:
        self.own_id = own_id
        """This vehicle's number."""
        self._group_range_m = group_range_m
        self._tunnel_height_m = tunnel_height_m
        self._stale_after_s = stale_after_s
        self._reports: dict[int, Report] = {}
        self._near: frozenset[tuple[int, int]] = frozenset()
        self._group: frozenset[int] = frozenset({own_id})

    def on_report(self, vehicle_id: int, report: Report) -> None:
        """Keep a report; one that is older than what is known, or not finite, or of one too many, is ignored."""
        known = self._reports.get(vehicle_id)
        if known is None and len(self._reports) >= MOST_VEHICLES and vehicle_id != self.own_id:
            return
        if report.is_finite and (known is None or report.t_s >= known.t_s):
            self._reports[vehicle_id] = report

    def others(self) -> dict[int, Report]:
        """The newest report of every other vehicle, however old."""
        return {vehicle_id: report for vehicle_id, report in self._reports.items() if vehicle_id != self.own_id}

    def own(self) -> Report | None:
        """The newest of this vehicle."""
        return self._reports.get(self.own_id)

    def group(self, t_s: float) -> frozenset[int]:
        """The vehicles connected with this one by chains of distances below d_r, silent members included."""
        flying = {vehicle_id: report for vehicle_id, report in self._reports.items() if report.flies}
        self._near = near_pairs(flying, self._group_range_m, self._near)
        silent = {
            vehicle_id
            for vehicle_id in self._group
            if vehicle_id in flying and t_s - flying[vehicle_id].t_s > self._stale_after_s
        }
        self._group = connected(self._near, self.own_id) | silent
        return self._group

    def height_m(self, t_s: float, alone_m: float) -> float:
        """H(t) of this vehicle: ``alone_m`` while no other is in its group, else its layer of (11)."""
        group = self.group(t_s)
        if len(group) == 1:
            return alone_m
        return layer_height_m(self.own_id, group, self._tunnel_height_m)


def near_pairs(
    reports: Mapping[int, Report], range_m: float, before: frozenset[tuple[int, int]] = frozenset()
) -> frozenset[tuple[int, int]]:
    """The pairs of vehicles, smaller number first, that are nearer to each other than ``range_m``.

    Args:
        reports: where they are.
        range_m: d_r.
        before: the pairs of a moment ago, which part only `PARTS` times as far away.
    """
    return frozenset(
        (one, other)
        for one, other in combinations(sorted(reports), 2)
        if reports[one].apart_m(reports[other]) < range_m * (PARTS if (one, other) in before else 1.0)
    )


def connected(pairs: frozenset[tuple[int, int]], start_id: int) -> frozenset[int]:
    """The component of ``start_id`` in the graph of vehicles whose edges are these pairs."""
    found: frozenset[int] = frozenset()
    grown = frozenset({start_id})
    while grown != found:
        found = grown
        grown = found.union(*(pair for pair in pairs if pair[0] in found or pair[1] in found))
    return found


def layer_height_m(own_id: int, group: frozenset[int], tunnel_height_m: float) -> float:
    """H = m·d_M/(n + 1), paper eq. (11), where m counts the vehicles whose number is not smaller than the own one.

    The paper counts only the larger ones, which would send the largest to the ground; m must count the vehicle itself.
    """
    m = sum(1 for vehicle_id in group if vehicle_id >= own_id)
    return m * tunnel_height_m / (len(group) + 1)
