"""The narrow: where the wall on the other side is so near that both cannot be kept at d_s. Pure."""

from __future__ import annotations

import math

import numpy as np

from companion.compiled import compiled
from companion.control.parameters import Parameters
from companion.model import HIT, Scan

WIDER_M = 0.2
"""A place counts as narrow up to so much more than twice d_s: its posts come as near as d_s while the vehicle comes
round one of them, by what it then swings and what they are measured too near. What is wider the boundary law turns
into by itself. With 0.15 two of twelve flights with the presets were not through a drift 2.2 m wide in time, with 0.2
all were."""


def width_m(scan: Scan, gamma: int, parameters: Parameters, lead_m: float = 0.0) -> float | None:
    """Width of the narrow place that R3 is in, or comes to along its wall; None where it is in none.

    From the nearest point of the wall on Γ's side to what on the other side is nearest to that point: across a drift,
    from post to post at a mouth. It is a way only when it is as wide as twice d_c, and open behind for d_s: in a corner
    what is nearest on the other side is the wall ahead, and nothing is open there.

    Args:
        scan: N(t).
        gamma: Γ, -1 when the wall to follow is on the right, 1 when on the left.
        parameters: the law's settings.
        lead_m: seen from a place so far ahead of the vehicle.
    """
    most_m = 2.0 * parameters.margin_m + WIDER_M
    found_m = float(_width(scan, gamma, lead_m, parameters.critical_margin_m, parameters.margin_m, most_m))
    return found_m if math.isfinite(found_m) else None


def sliding_mps(own_mps: float, other_mps: float) -> float:
    """The sliding variable of (7) between two walls, of that of either.

    A wall that is come to too fast, below 0, turns the vehicle away, and between two it flies to where both do as much.
    Where neither does, the one on Γ's side is followed.
    """
    away_mps = min(0.0, own_mps), min(0.0, other_mps)
    return away_mps[0] - away_mps[1] if any(away_mps) else own_mps


@compiled
def _width(scan: Scan, gamma: int, lead_m: float, critical_m: float, margin_m: float, most_m: float) -> float:
    bearings, ranges, state, _ = scan
    own, own_m = -1, np.inf
    x, y = np.empty(bearings.size), np.empty(bearings.size)
    for i in range(bearings.size):
        x[i] = ranges[i] * np.cos(bearings[i]) - lead_m
        y[i] = ranges[i] * np.sin(bearings[i])
        away_m = np.hypot(x[i], y[i])
        if state[i] == HIT and gamma * y[i] >= 0.0 and away_m < own_m:
            own, own_m = i, away_m
    if own < 0 or own_m > most_m:
        return np.inf
    other, across_m = -1, np.inf
    for i in range(bearings.size):
        if state[i] == HIT and gamma * y[i] < 0.0:
            apart_m = np.hypot(x[i] - x[own], y[i] - y[own])
            if apart_m < across_m:
                other, across_m = i, apart_m
    if other < 0 or across_m > most_m or across_m < 2.0 * critical_m:
        return np.inf
    # Through the middle between the two, square to the line that joins them, ahead.
    through_x, through_y = -(y[other] - y[own]) / across_m, (x[other] - x[own]) / across_m
    if through_x < 0.0:
        through_x, through_y = -through_x, -through_y
    for i in range(bearings.size):
        if state[i] == HIT:
            dx, dy = x[i] - (x[own] + x[other]) / 2.0, y[i] - (y[own] + y[other]) / 2.0
            along_m = dx * through_x + dy * through_y
            if 0.0 <= along_m < margin_m and abs(dx * through_y - dy * through_x) < critical_m:
                return np.inf
    return across_m
