"""How far it is to the nearest obstacle: through chunks and bricks to voxels, near ones first.

A query for programs that plan in a map (docs/map.md, "Asking the map"): no part of the companion asks it yet.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled, inner
from companion.mapping.frontiers.state_grid import Grid, StateGrid, brick_words, has, row_of
from companion.mapping.voxels.chunks import EDGE, OFFSETS, place_of
from companion.model import FloatArray

MOST_VOXELS = 512
"""No question may reach further than this: its cost grows with the third power where nothing is known."""

_PLACES = OFFSETS[:64].astype(np.int64)
"""(64, 3) where a brick is in its chunk, in bricks, and a voxel in its brick."""


def nearest_obstacle_m(known: StateGrid, points: NDArray[np.floating], most_m: float) -> FloatArray:
    """(n,) distance from each of ``points`` (n, 3), in m, to the nearest occupied voxel, at most ``most_m``.

    The distance is to the voxel's box and not to its centre: what was measured lies somewhere in it, so nothing is
    nearer than this. It is 0 inside of an occupied voxel. ``most_m`` comes back where nothing is nearer: nobody looked
    further.

    Raises:
        ValueError: a point is not finite, or ``most_m`` is negative, not finite or more than `MOST_VOXELS` voxels.
    """
    return _distances_m(known, points, most_m, False)


def nearest_not_free_m(known: StateGrid, points: NDArray[np.floating], most_m: float) -> FloatArray:
    """The same as `nearest_obstacle_m`, where an unknown voxel counts as an obstacle: unknown is not free."""
    return _distances_m(known, points, most_m, True)


def _distances_m(known: StateGrid, points: NDArray[np.floating], most_m: float, unknown_too: bool) -> FloatArray:
    limit_m = MOST_VOXELS * known.voxel_m
    if not 0.0 <= most_m <= limit_m:
        raise ValueError(f"most_m is {most_m}, it has to be from 0 to {limit_m}, which are {MOST_VOXELS} voxels")
    places = known.voxels_of(points)
    distances = np.asarray(_distances(known.grid, places, most_m / known.voxel_m, unknown_too))
    return np.minimum(distances * known.voxel_m, most_m)


@compiled
def _distances(grid: Grid, places: FloatArray, most: float, unknown_too: bool) -> FloatArray:
    distances = np.empty(places.shape[0])
    for n in range(places.shape[0]):
        distances[n] = math.sqrt(_squared(grid, places[n, 0], places[n, 1], places[n, 2], most, unknown_too))
    return distances


@inner
def _gap(at: float, low: float, edge: float) -> float:
    """How far ``at`` is from the stretch of a length ``edge`` that begins at ``low``."""
    return max(low - at, at - low - edge, 0.0)


@inner
def _squared(grid: Grid, x: float, y: float, z: float, most: float, unknown_too: bool) -> float:
    """Squared distance in voxels, at most ``most`` squared: chunks in shells around the one that holds the point."""
    best = most * most
    i, j, k = math.floor(x / EDGE), math.floor(y / EDGE), math.floor(z / EDGE)
    inner = min(
        min(x - EDGE * i, EDGE * (i + 1) - x),
        min(y - EDGE * j, EDGE * (j + 1) - y),
        min(z - EDGE * k, EDGE * (k + 1) - z),
    )
    shell = 0
    while shell == 0 or ((shell - 1) * EDGE + inner) ** 2 < best:
        for a in range(i - shell, i + shell + 1):
            gap_x = _gap(x, EDGE * a, EDGE) ** 2
            if gap_x >= best and shell > 0:
                continue
            for b in range(j - shell, j + shell + 1):
                gap_xy = gap_x + _gap(y, EDGE * b, EDGE) ** 2
                if gap_xy >= best and shell > 0:
                    continue
                # Only the surface of the shell: what is inside of it was looked at before.
                on_side = abs(a - i) == shell or abs(b - j) == shell
                step = 1 if on_side else 2 * shell
                for c in range(k - shell, k + shell + 1, max(step, 1)):
                    gap = gap_xy + _gap(z, EDGE * c, EDGE) ** 2
                    if gap >= best:
                        continue
                    row = row_of(grid, a, b, c)
                    if row < 0:
                        if unknown_too:
                            best = gap
                    else:
                        best = _in_chunk(grid, row, x - EDGE * a, y - EDGE * b, z - EDGE * c, best, unknown_too)
        shell += 1
    return best


@inner
def _in_chunk(grid: Grid, row: int, x: float, y: float, z: float, best: float, unknown_too: bool) -> float:
    """The squared distance to a voxel of one chunk when that is less than ``best``; the point is counted from it."""
    chosen, others = grid.occupied[row], grid.free[row]
    if unknown_too:
        chosen |= grid.unknown[row]
    else:
        others |= grid.unknown[row]
    if chosen == np.uint64(0):
        return best
    # Numbers that differ little from the nearest brick's in the high bits are near it: roughly near ones first.
    nearest = place_of(
        min(max(math.floor(x / 4.0), 0), 3), min(max(math.floor(y / 4.0), 0), 3), min(max(math.floor(z / 4.0), 0), 3)
    )
    for n in range(64):
        brick = nearest ^ n
        if not has(chosen, brick):
            continue
        low_x, low_y, low_z = 4.0 * _PLACES[brick, 0], 4.0 * _PLACES[brick, 1], 4.0 * _PLACES[brick, 2]
        gap = _gap(x, low_x, 4.0) ** 2 + _gap(y, low_y, 4.0) ** 2 + _gap(z, low_z, 4.0) ** 2
        if gap >= best:
            continue
        if not has(others, brick):
            best = gap
            continue
        occupied, free = brick_words(grid, row, brick)
        voxels = ~free if unknown_too else occupied
        for bit in range(64):
            if has(voxels, bit):
                gap = (
                    _gap(x, low_x + _PLACES[bit, 0], 1.0) ** 2
                    + _gap(y, low_y + _PLACES[bit, 1], 1.0) ** 2
                    + _gap(z, low_z + _PLACES[bit, 2], 1.0) ** 2
                )
                best = min(best, gap)
    return best
