"""Edges in the scan, the tangent targets (10) behind them, and whether the way to them is free."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from companion.compiled import compiled
from companion.control.parameters import Parameters
from companion.model import CLEAR, FRONT_RAD, HIT, UNKNOWN, Scan, wrap_rad

CORRIDOR_SHARE = 0.9
"""Half-width of the corridor in units of d_s: the tangent itself touches the d_s-offset of the walls, so a corridor of
exactly d_s would be closed by every measurement error."""

CORRIDOR_LOOK_RAD = math.radians(30.0)
"""Bearings off the corridor's axis up to which its ground must have been seen: beyond it the corridor's edge is nearer
than two half-widths, where d already watches."""

SAME_WALL_SHARE = 0.35
"""A tangent segment lies along the boundary when every point of it is within this share of d_s of ∂S(d_s)."""

SLANT_STEPS = 2.0
"""A wall at a slant may step by this many times the step before: noise doubles a step easily, hardly trebles it."""


@dataclass(frozen=True, slots=True)
class Edge:
    """A jump of the range between neighbouring bearings, and the intermediate target beside it.

    Attributes:
        near_bearing_rad: bearing of the nearer end, which is the obstacle's edge.
        near_range_m: its distance.
        target_bearing_rad: bearing of T_m, paper eq. (10).
        target_range_m: distance of T_m, paper eq. (10).
        gamma: Γ = sgn(r_i - r_{i+1}): -1 when the edge's wall will be on the right, 1 when on the left.
    """

    near_bearing_rad: float
    near_range_m: float
    target_bearing_rad: float
    target_range_m: float
    gamma: int


def tangent_target(
    bearing_i_rad: float, range_i_m: float, bearing_j_rad: float, range_j_m: float, margin_m: float
) -> tuple[float, float]:
    """Paper eq. (10): bearing and distance of T_m for the edge between bearings i and j = i + 1.

    Bearings are counter-clockwise, so sgn(r_j - r_i)·arctan(d_s/m) moves the target off the near end into the open.
    """
    near_m = min(range_i_m, range_j_m)
    side = math.copysign(1.0, range_j_m - range_i_m)
    bearing = (bearing_i_rad + bearing_j_rad) / 2.0 + math.atan2(side * margin_m, near_m)
    return bearing, math.hypot(margin_m, near_m)


def find_edges(scan: Scan, parameters: Parameters) -> list[Edge]:
    """Edges whose both ends lie within ᾱ of the heading, nearest first.

    The paper prints |r_i - r_{i+1}| < r̄, which would hold for every smooth wall; an edge is a jump, so the sign is
    turned round here. A jump from HIT to CLEAR counts, one to UNKNOWN does not, and both ends must have been looked at
    just now: what is remembered has no sharp edges.

    A wall seen at a slant jumps from one bearing to the next too, the more so the further away and the more noise there
    is. So the jump must exceed by r̄ what the slope on its near side explains, and the second bearing behind it must be
    as far.
    """
    edges = []
    for near, far in _jumps(scan, parameters.edge_bearing_rad, parameters.edge_jump_m):
        i, j = min(near, far), max(near, far)
        r_i, r_j = float(scan.ranges_m[i]), float(scan.ranges_m[j])
        bearing, distance = tangent_target(
            float(scan.bearings_rad[i]), r_i, float(scan.bearings_rad[j]), r_j, parameters.margin_m
        )
        edges.append(
            Edge(
                near_bearing_rad=float(scan.bearings_rad[near]),
                near_range_m=float(scan.ranges_m[near]),
                target_bearing_rad=wrap_rad(bearing),
                target_range_m=distance,
                gamma=1 if r_i > r_j else -1,
            )
        )
    return sorted(edges, key=lambda edge: edge.near_range_m)


@compiled
def _jumps(scan: Scan, within_rad: float, jump_m: float) -> list[tuple[int, int]]:
    bearings, ranges, state, fresh = scan
    found = []
    for i in range(1, bearings.size - 2):
        if abs(bearings[i]) >= within_rad or abs(bearings[i + 1]) >= within_rad:
            continue
        if abs(ranges[i] - ranges[i + 1]) <= jump_m:
            continue
        side = 1 if ranges[i] < ranges[i + 1] else -1
        near = i if side > 0 else i + 1
        far, before, behind = near + side, near - side, near + 2 * side
        if not (fresh[near] and fresh[far] and fresh[before] and fresh[behind]):
            continue
        if state[near] != HIT or state[before] != HIT or state[far] == UNKNOWN or state[behind] == UNKNOWN:
            continue
        slant = SLANT_STEPS * abs(ranges[near] - ranges[before])
        if ranges[far] - ranges[near] > jump_m + slant and ranges[behind] - ranges[near] > jump_m + slant:
            found.append((near, far))
    return found


@compiled
def corridor_is_free(scan: Scan, axis_rad: float, length_m: float, half_width_m: float) -> bool:
    """Whether a straight corridor from the vehicle holds no HIT and nothing UNKNOWN (paper Definition 3.4).

    Args:
        scan: N(t).
        axis_rad: direction of the corridor.
        length_m: its length.
        half_width_m: half of its width.
    """
    bearings, ranges, state, _ = scan
    for i in range(bearings.size):
        off = (bearings[i] - axis_rad + np.pi) % (2.0 * np.pi) - np.pi
        if abs(off) >= np.pi / 2.0:
            continue
        reach = length_m / np.cos(off)
        side = abs(np.sin(off))
        if side * reach > half_width_m:
            reach = half_width_m / side
        if state[i] == HIT:
            if ranges[i] < reach:
                return False
        elif abs(off) <= CORRIDOR_LOOK_RAD and (state[i] == UNKNOWN or ranges[i] < reach):
            return False
    return True


def lies_along_boundary(scan: Scan, edge: Edge, margin_m: float) -> bool:
    """Whether the segment to the edge's target runs along ∂S(d_s), so that following the wall flies it anyway."""
    return _lies_along_boundary(scan, edge.target_bearing_rad, edge.target_range_m, margin_m)


@compiled
def _lies_along_boundary(scan: Scan, bearing_rad: float, length_m: float, margin_m: float) -> bool:
    bearings, ranges, state, _ = scan
    steps = max(2, int(length_m / (0.5 * margin_m)))
    for k in range(1, steps + 1):
        x = length_m * k / steps * np.cos(bearing_rad)
        y = length_m * k / steps * np.sin(bearing_rad)
        least = np.inf
        for i in range(bearings.size):
            if state[i] == HIT:
                dx = ranges[i] * np.cos(bearings[i]) - x
                dy = ranges[i] * np.sin(bearings[i]) - y
                least = min(least, dx * dx + dy * dy)
        if abs(np.sqrt(least) - margin_m) > SAME_WALL_SHARE * margin_m:
            return False
    return True


@compiled
def open_direction(scan: Scan, half_width_m: float) -> tuple[float, float]:
    """Bearing and length of the longest free corridor of that half-width; length 0 when there is none."""
    bearings, ranges, state, _ = scan
    best_bearing, best_length = 0.0, 0.0
    for b in range(0, bearings.size, 3):
        if state[b] == UNKNOWN:
            continue
        length = ranges[b]
        for i in range(bearings.size):
            if state[i] == CLEAR:
                continue
            off = (bearings[i] - bearings[b] + np.pi) % (2.0 * np.pi) - np.pi
            if abs(off) >= np.pi / 2.0:
                continue
            if state[i] == UNKNOWN:
                if abs(off) <= CORRIDOR_LOOK_RAD:
                    length = min(length, half_width_m / max(abs(np.sin(off)), 1e-6))
                continue
            if ranges[i] * abs(np.sin(off)) < half_width_m:
                length = min(length, ranges[i] * np.cos(off))
        if length > best_length:
            best_bearing, best_length = bearings[b], length
    return best_bearing, best_length


def has_way_on(scan: Scan, critical_margin_m: float) -> bool:
    """Whether (12) lets the vehicle fly in any heading at all: one with d_f >= d_c.

    d_f looks at 270°, so everything nearer than d_c must fit into the 90° behind. Even before a single flat wall it
    does not when d < d_c/√2, and in a corner it hardly ever does.
    """
    near_rad = np.sort(scan.bearings_rad[(scan.state == HIT) & (scan.ranges_m < critical_margin_m)])
    if near_rad.size == 0:
        return True
    gaps_rad = np.diff(near_rad, append=near_rad[0] + 2.0 * np.pi)
    return bool(gaps_rad.max() > 2.0 * FRONT_RAD)
