"""What a filled plan says: where the vehicle can get to, what it sees from there, and what belongs together."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from companion.mapping.lookup import FREE, OCCUPIED
from companion.mapping.plan import SIDES, Plan, node_at

_BEARINGS = 64
"""Directions in which a frontier looks for a place from which it can be seen."""

_JOIN_CELLS = 2
"""Frontier cells this far apart still belong together: noise interrupts a line."""


@njit(cache=True, nogil=True)
def near_obstacles(plan: Plan, size: int, radius_cells: float, same_level_m: float) -> NDArray[np.bool_]:
    """(size,) whether an occupied node is nearer than ``radius_cells``."""
    near = np.zeros(size, np.bool_)
    rim = math.ceil(radius_cells)
    for n in range(size):
        if plan.kinds[n] != OCCUPIED:
            continue
        for a in range(-rim, rim + 1):
            for b in range(-rim, rim + 1):
                if a * a + b * b < radius_cells * radius_cells:
                    i, j = plan.cells[n, 0] + a, plan.cells[n, 1] + b
                    other = node_at(plan, i, j, plan.heights_m[n], same_level_m)
                    if other >= 0:
                        near[other] = True
    return near


@njit(cache=True, nogil=True)
def reached(plan: Plan, size: int, flown: int, blocked: NDArray[np.bool_], same_level_m: float) -> NDArray[np.bool_]:
    """(size,) which free nodes the vehicle can get to from where it was, without entering ``blocked`` ones."""
    found = np.zeros(size, np.bool_)
    waiting = np.empty(size, np.int64)
    waiting[:flown] = np.arange(flown)
    found[:flown] = True
    count = flown
    while count > 0:
        count -= 1
        n = waiting[count]
        for side in range(4):
            i, j = plan.cells[n, 0] + SIDES[side, 0], plan.cells[n, 1] + SIDES[side, 1]
            other = node_at(plan, i, j, plan.heights_m[n], same_level_m)
            if other >= 0 and not found[other] and plan.kinds[other] == FREE and not blocked[other]:
                found[other] = True
                waiting[count] = other
                count += 1
    return found


@njit(cache=True, nogil=True)
def seen_from(
    plan: Plan,
    size: int,
    wanted: NDArray[np.bool_],
    places: NDArray[np.bool_],
    look_cells: int,
    same_level_m: float,
) -> NDArray[np.bool_]:
    """(size,) which ``wanted`` nodes can be seen through free ones from ``places`` at most ``look_cells`` away."""
    seen = np.zeros(size, np.bool_)
    for n in range(size):
        bearing = 0
        while wanted[n] and not seen[n] and bearing < _BEARINGS:
            angle_rad = 2.0 * math.pi * bearing / _BEARINGS
            dx, dy = math.cos(angle_rad), math.sin(angle_rad)
            z_m = plan.heights_m[n]
            for step in range(1, look_cells + 1):
                i, j = round(plan.cells[n, 0] + step * dx), round(plan.cells[n, 1] + step * dy)
                other = node_at(plan, i, j, z_m, same_level_m)
                if other < 0 or plan.kinds[other] != FREE:
                    break
                z_m = plan.heights_m[other]
                if places[other]:
                    seen[n] = True
                    break
            bearing += 1
    return seen


@njit(cache=True, nogil=True)
def clusters(plan: Plan, size: int, chosen: NDArray[np.bool_], same_level_m: float) -> NDArray[np.int64]:
    """(size,) number of the group of neighbours to which each chosen node belongs, from 1; 0 for the others."""
    groups = np.zeros(size, np.int64)
    waiting = np.empty(size, np.int64)
    last = 0
    for n in range(size):
        if not chosen[n] or groups[n] > 0:
            continue
        last += 1
        groups[n] = last
        waiting[0] = n
        count = 1
        while count > 0:
            count -= 1
            m = waiting[count]
            for a in range(-_JOIN_CELLS, _JOIN_CELLS + 1):
                for b in range(-_JOIN_CELLS, _JOIN_CELLS + 1):
                    i, j = plan.cells[m, 0] + a, plan.cells[m, 1] + b
                    other = node_at(plan, i, j, plan.heights_m[m], same_level_m)
                    if other >= 0 and chosen[other] and groups[other] == 0:
                        groups[other] = last
                        waiting[count] = other
                        count += 1
    return groups
