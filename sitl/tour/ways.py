"""Ways between places of the traveling surface: the shortest over its grid, pulled taut."""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled
from sitl.scene.visibility import MAX_SLOPE, MOST_STEP_M, SAME_LEVEL_M

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_STEPS = ((1, 0), (0, 1), (1, 1), (1, -1), (2, 1), (1, 2), (2, -1), (1, -2))
"""To half of the 16 neighbours: with eight, a way is up to 8 % too long, with these 3 %, before it is pulled taut."""

_BORDER = 2
"""Empty cells all round, as far as a step goes."""

_PATIENCE = 12
"""How many nodes further on a straight is still sought after one that is not free."""


@dataclass(frozen=True, slots=True, eq=False)
class Leg:
    """A way between two places.

    Attributes:
        points_m: (n, 3) its corners, both ends included.
        length_m: of it, up and down included.
        headings_rad: (n - 1,) along each of its straights; empty where both ends are one place.
    """

    points_m: Array
    length_m: float
    headings_rad: Array


class Ways:
    """The shortest ways over a traveling surface.

    A taut way keeps the surface's margin, but for the part of a cell by which it passes beside the grid's points.

    Args:
        places_m: (k, 3) the points of the surface, on a square grid through the first.
        step_m: side of the grid.
    """

    def __init__(self, places_m: Array, step_m: float) -> None:
        self.places_m = places_m
        self._step_m = step_m
        cells = np.round((places_m[:, :2] - places_m[0, :2]) / step_m).astype(np.int64)
        self.cells: Indices = cells - cells.min(axis=0)
        self._at = _levels(self.cells, places_m[:, 2])
        self._graph = self._edges()
        self._from: dict[int, tuple[Array, Indices]] = {}
        self._legs: dict[tuple[int, int], Leg] = {}

    def lengths_m(self, place: int) -> Array:
        """(k,) length of the way from a place to all others, over the grid; infinite where there is none."""
        return self._tree(place)[0]

    def leg(self, a: int, b: int) -> Leg:
        """The way from one place to another.

        Raises:
            ValueError: there is none.
        """
        if (a, b) in self._legs:
            return self._legs[a, b]
        if not np.isfinite(self.lengths_m(a)[b]):
            raise ValueError(f"no way leads from place {a} to place {b}")
        before = self._tree(a)[1]
        path = [b]
        while path[-1] != a:
            path.append(int(before[path[-1]]))
        nodes = np.array(path[::-1], np.int64)
        corners = _taut(nodes, self.cells, self.places_m[:, 2], self._at, self._step_m, _PATIENCE)
        points_m = self.places_m[nodes[corners]]
        steps = np.diff(points_m, axis=0)
        leg = Leg(points_m, float(np.linalg.norm(steps, axis=1).sum()), np.arctan2(steps[:, 1], steps[:, 0]))
        self._legs[a, b] = leg
        self._legs[b, a] = Leg(
            points_m[::-1], leg.length_m, (leg.headings_rad[::-1] + 2.0 * np.pi) % (2.0 * np.pi) - np.pi
        )
        return leg

    def nearest(self, points_m: Array) -> Indices:
        """(n,) the place at, or nearest beside, each of points (n, 3) that lie on ways."""
        cells = np.round((points_m[:, :2] - self.places_m[0, :2]) / self._step_m).astype(np.int64) + self.cells[0]
        return _at_cells(cells, points_m[:, 2], self._at, self.places_m[:, 2])

    def _tree(self, place: int) -> tuple[Array, Indices]:
        if place not in self._from:
            self._from[place] = _dijkstra(place, *self._graph)
        return self._from[place]

    def _edges(self) -> tuple[Indices, Indices, Array]:
        """Where each place's neighbours begin, which they are, and how far away."""
        heights_m = self.places_m[:, 2]
        here, there, lengths_m = [], [], []
        for dx, dy in _STEPS:
            flat_m = self._step_m * math.hypot(dx, dy)
            for level in range(self._at.shape[2]):
                other = self._at[self.cells[:, 0] + _BORDER + dx, self.cells[:, 1] + _BORDER + dy, level]
                rise_m = np.where(other >= 0, heights_m[other] - heights_m, np.inf)
                # Neighbours of the surface may lie on both sides of a step.
                most_m = MOST_STEP_M if dx == 0 or dy == 0 else MAX_SLOPE * flat_m
                joined = np.flatnonzero(np.abs(rise_m) <= most_m)
                joined = joined[_are_straight(joined, other[joined], self.cells, heights_m, self._at)]
                here += [joined, other[joined]]
                there += [other[joined], joined]
                lengths_m += [np.hypot(flat_m, rise_m[joined])] * 2
        order = np.argsort(np.concatenate(here), kind="stable")
        counts = np.bincount(np.concatenate(here), minlength=len(self.places_m))
        begins = np.concatenate([[0], np.cumsum(counts)])
        return begins, np.concatenate(there)[order], np.concatenate(lengths_m)[order]


@compiled
def _dijkstra(start: int, begins: Indices, others: Indices, lengths_m: Array) -> tuple[Array, Indices]:
    """(k,) length of the shortest way to each place, infinite where there is none, and the place before it."""
    least_m = np.full(len(begins) - 1, np.inf)
    before = np.full(len(begins) - 1, -1, np.int64)
    least_m[start] = 0.0
    queue = [(0.0, start)]
    while len(queue) > 0:
        so_far_m, here = heapq.heappop(queue)
        if so_far_m > least_m[here]:
            continue
        for k in range(begins[here], begins[here + 1]):
            length_m = so_far_m + lengths_m[k]
            if length_m < least_m[others[k]]:
                least_m[others[k]] = length_m
                before[others[k]] = here
                heapq.heappush(queue, (length_m, others[k]))
    return least_m, before


def _levels(cells: Indices, heights_m: Array) -> Indices:
    """(nx + 4, ny + 4, levels) the places over each cell, -1 where there are none; two empty cells all round."""
    order = np.lexsort((heights_m, cells[:, 1], cells[:, 0]))
    same = np.all(cells[order[1:]] == cells[order[:-1]], axis=1)
    level = np.zeros(len(cells), np.int64)
    for k, again in enumerate(same, start=1):
        level[order[k]] = level[order[k - 1]] + 1 if again else 0
    at = np.full((*(cells.max(axis=0) + 1 + 2 * _BORDER), int(level.max()) + 1), -1, np.int64)
    at[cells[:, 0] + _BORDER, cells[:, 1] + _BORDER, level] = np.arange(len(cells))
    return at


@compiled
def _place_at(x: int, y: int, z_m: float, at: Indices, heights_m: Array) -> int:
    """The place over a cell that is as high as that, -1 where there is none."""
    if not (0 <= x + _BORDER < at.shape[0] and 0 <= y + _BORDER < at.shape[1]):
        return -1
    for level in range(at.shape[2]):
        place = at[x + _BORDER, y + _BORDER, level]
        if place >= 0 and abs(heights_m[place] - z_m) <= SAME_LEVEL_M:
            return int(place)
    return -1


@compiled
def _at_cells(cells: Indices, z_m: Array, at: Indices, heights_m: Array) -> Indices:
    found = np.full(len(cells), -1, np.int64)
    for i in range(len(cells)):
        for reach in range(3):
            for dx in range(-reach, reach + 1):
                for dy in range(-reach, reach + 1):
                    if found[i] < 0:
                        found[i] = _place_at(cells[i, 0] + dx, cells[i, 1] + dy, z_m[i], at, heights_m)
    return found


@compiled
def _is_straight(a: int, b: int, cells: Indices, heights_m: Array, at: Indices) -> bool:
    """Whether every cell on the line between two places belongs to the surface."""
    dx, dy = cells[b, 0] - cells[a, 0], cells[b, 1] - cells[a, 1]
    pieces = max(1, 2 * max(abs(dx), abs(dy)))
    for k in range(1, pieces):
        share = k / pieces
        x = int(np.floor(cells[a, 0] + dx * share + 0.5))
        y = int(np.floor(cells[a, 1] + dy * share + 0.5))
        z_m = heights_m[a] + (heights_m[b] - heights_m[a]) * share
        if _place_at(x, y, z_m, at, heights_m) < 0:
            return False
    return True


@compiled
def _are_straight(a: Indices, b: Indices, cells: Indices, heights_m: Array, at: Indices) -> NDArray[np.bool_]:
    """(n,) the same for many."""
    straight = np.empty(len(a), np.bool_)
    for k in range(len(a)):
        straight[k] = _is_straight(a[k], b[k], cells, heights_m, at)
    return straight


@compiled
def _taut(nodes: Indices, cells: Indices, heights_m: Array, at: Indices, step_m: float, patience: int) -> Indices:
    """Which nodes of a path remain as corners when it is pulled taut: twice, from either end, the shorter one."""
    best_m = np.inf
    best = np.zeros(1, np.int64)
    for turned in range(2):
        path = nodes if turned == 0 else nodes[::-1]
        kept = [0]
        while kept[-1] < len(path) - 1:
            here, far, ahead = kept[-1], kept[-1] + 1, kept[-1] + 2
            while ahead < len(path) and ahead - far <= patience:
                if _is_straight(path[here], path[ahead], cells, heights_m, at):
                    far = ahead
                ahead += 1
            kept.append(far)
        length_m = 0.0
        for k in range(len(kept) - 1):
            a, b = path[kept[k]], path[kept[k + 1]]
            length_m += step_m * np.hypot(cells[b, 0] - cells[a, 0], cells[b, 1] - cells[a, 1])
        if length_m < best_m:
            best_m = length_m
            corners = np.array(kept, np.int64)
            best = corners if turned == 0 else (len(path) - 1 - corners)[::-1]
    return best
