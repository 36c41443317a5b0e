"""Several vehicles in one mine: who is near, and which height layer is whose (paper eq. (11))."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Report:
    """A vehicle's newest position, in the frame that the vehicles share."""

    t_s: float
    x_m: float
    y_m: float
    z_m: float


class Fleet:
    """What one vehicle knows of the others.

    A vehicle that has fallen silent is not gone: it stays in the group in which it was last heard, at its last
    position, and so keeps its layer.

    Args:
        own_id: this vehicle's number.
        group_range_m: d_r, vehicles nearer than this share a group.
        tunnel_height_m: d_M, the least distance from ground to roof.
        stale_after_s: the age from which on a report is stale.
    """

    def __init__(self, own_id: int, *, group_range_m: float, tunnel_height_m: float, stale_after_s: float) -> None:
        self._own_id = own_id
        self._group_range_m = group_range_m
        self._tunnel_height_m = tunnel_height_m
        self._stale_after_s = stale_after_s
        self._reports: dict[int, Report] = {}
        self._group: frozenset[int] = frozenset({own_id})

    def on_report(self, vehicle_id: int, report: Report) -> None:
        """Keep a report; one that is older than what is known, or not finite, is ignored."""
        known = self._reports.get(vehicle_id)
        finite = all(map(math.isfinite, (report.t_s, report.x_m, report.y_m, report.z_m)))
        if finite and (known is None or report.t_s >= known.t_s):
            self._reports[vehicle_id] = report

    def group(self, t_s: float) -> frozenset[int]:
        """The vehicles connected with this one by chains of distances below d_r, silent members included."""
        near = connected(self._reports, self._own_id, self._group_range_m)
        silent = {
            vehicle_id
            for vehicle_id in self._group
            if vehicle_id in self._reports and t_s - self._reports[vehicle_id].t_s > self._stale_after_s
        }
        self._group = near | silent
        return self._group

    def height_m(self, t_s: float, alone_m: float) -> float:
        """H(t) of this vehicle: ``alone_m`` while no other is in its group, else its layer of (11)."""
        group = self.group(t_s)
        if len(group) == 1:
            return alone_m
        return layer_height_m(self._own_id, group, self._tunnel_height_m)


def connected(reports: Mapping[int, Report], start_id: int, range_m: float) -> frozenset[int]:
    """The component of ``start_id`` in the graph of vehicles nearer to each other than ``range_m``."""
    found = {start_id}
    border = [start_id]
    while border:
        here = reports.get(border.pop())
        if here is None:
            continue
        for vehicle_id, there in reports.items():
            apart_m = math.dist((here.x_m, here.y_m, here.z_m), (there.x_m, there.y_m, there.z_m))
            if vehicle_id not in found and apart_m < range_m:
                found.add(vehicle_id)
                border.append(vehicle_id)
    return frozenset(found)


def layer_height_m(own_id: int, group: frozenset[int], tunnel_height_m: float) -> float:
    """H = m·d_M/(n + 1), paper eq. (11), where m counts the vehicles whose number is not smaller than the own one.

    The paper counts only the larger ones, which would send the largest to the ground; m must count the vehicle itself.
    """
    m = sum(1 for vehicle_id in group if vehicle_id >= own_id)
    return m * tunnel_height_m / (len(group) + 1)
