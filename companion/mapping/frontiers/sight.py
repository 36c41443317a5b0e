"""Whether one point can be seen from another: along the straight line between them, voxel by voxel, and exactly.

The ends are rounded to 1/1024 of a voxel; from there on it is decided in whole numbers, so that no rounding lets a line
slip between two voxels and the line back meets the same voxels. A voxel is met when the line touches its closed box:
whoever passes through an edge or a corner touches all that meet there, whoever flies along a wall touches it.

As in Amanatides and Woo, "A Fast Voxel Traversal Algorithm for Ray Tracing" (1987), the line is followed layer by
layer, here across the axis along which it is longest: first through bricks of 4 x 4 x 4 voxels, and through the voxels
of those bricks only that are not wholly free.

A query for programs that plan in a map (docs/map.md, "Asking the map"): no part of the companion asks it yet.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled, inner
from companion.mapping.frontiers.state_grid import Grid, StateGrid, brick_words, has, row_of
from companion.mapping.voxels.chunks import Integer, place_of
from companion.model import FloatArray

UNIT = 1024
"""Parts of a voxel to which the ends of a line are rounded."""

MOST_VOXELS = 2**14
"""A longer line is refused: the products of three lengths would not fit into 64 bits, and nobody sees so far."""


class Verdict(IntEnum):
    """What is known of the line between two points."""

    CLEAR = 0
    """Free from end to end."""

    UNKNOWN = 1
    """No obstacle is known on it, but not all of it was seen."""

    BLOCKED = 2
    """An obstacle is on it, whatever else is unknown."""


@dataclass(frozen=True, slots=True)
class Sight:
    """What is known of the line from one point to another.

    Attributes:
        verdict: the same in both directions.
        where_m: (x, y, z) on the line where the first obstacle begins if it is blocked, or else the first that is
            unknown; None when it is clear.
    """

    verdict: Verdict
    where_m: tuple[float, float, float] | None


def sight(known: StateGrid, a_m: tuple[float, float, float], b_m: tuple[float, float, float]) -> Sight:
    """What is known of the line from ``a_m`` to ``b_m``.

    Raises:
        ValueError: a coordinate is not finite, or the line is longer than `MOST_VOXELS`.
    """
    verdicts, where_m = sights(known, np.array([a_m]), np.array([b_m]))
    verdict = Verdict(int(verdicts[0]))
    x_m, y_m, z_m = where_m[0].tolist()
    return Sight(verdict, None if verdict == Verdict.CLEAR else (x_m, y_m, z_m))


def sights(
    known: StateGrid, from_m: NDArray[np.floating], to_m: NDArray[np.floating]
) -> tuple[NDArray[np.uint8], FloatArray]:
    """What is known of many lines.

    Args:
        known: the map.
        from_m: (n, 3) where they begin.
        to_m: (n, 3) where they end.

    Returns:
        (n,) uint8 `Verdict` of each, and (n, 3) the place on it to which that belongs, in m, as in `Sight`: the end of
        the line when it is clear.

    Raises:
        ValueError: a coordinate is not finite, the numbers of ends differ, or a line is longer than `MOST_VOXELS`.
    """
    begins, ends = known.voxels_of(from_m), known.voxels_of(to_m)
    if len(begins) != len(ends):
        raise ValueError(f"{len(begins)} lines begin and {len(ends)} end")
    longest = float(np.max(np.abs(ends - begins), initial=0.0))
    if longest > MOST_VOXELS:
        limit_m = MOST_VOXELS * known.voxel_m
        raise ValueError(f"a line is {longest * known.voxel_m:.0f} m long along one axis, more than {limit_m:.0f} m")
    verdicts, shares = _followed(
        known.grid, np.rint(begins * UNIT).astype(np.int64), np.rint(ends * UNIT).astype(np.int64)
    )
    return verdicts, (begins + shares[:, np.newaxis] * (ends - begins)) * known.voxel_m


@compiled
def _followed(grid: Grid, begins: NDArray[np.int64], ends: NDArray[np.int64]) -> tuple[NDArray[np.uint8], FloatArray]:
    verdicts = np.empty(begins.shape[0], np.uint8)
    shares = np.empty(begins.shape[0])
    nearest = np.empty(2)
    for n in range(begins.shape[0]):
        _follow(grid, begins[n], ends[n], nearest)
        if nearest[0] <= 1.0:
            verdicts[n], shares[n] = 2, nearest[0]
        elif nearest[1] <= 1.0:
            verdicts[n], shares[n] = 1, nearest[1]
        else:
            verdicts[n], shares[n] = 0, 1.0
    return verdicts, shares


@inner
def _stretch(a: int, d: int, a_long: int, d_long: int, first: int, last: int, edge: int) -> tuple[int, int]:
    """The first and last cell of a length ``edge`` that a line touches between two places along its longest axis.

    Args:
        a: where the line begins, along the axis of the cells.
        d: how far it goes along it.
        a_long: where it begins along the longest axis.
        d_long: how far it goes there; not 0.
        first: the place on the longest axis where the stretch begins.
        last: where it ends.
        edge: of a cell.
    """
    # Everything times |d_long|, so that it stays whole.
    size, sign = abs(d_long), 1 if d_long > 0 else -1
    one = a * size + (first - a_long) * d * sign
    two = a * size + (last - a_long) * d * sign
    wide = edge * size
    return -(-min(one, two) // wide) - 1, max(one, two) // wide


@inner
def _crosses(
    begin: NDArray[np.int64], way: NDArray[np.int64], v: int, w: int, cell_v: int, cell_w: int, edge: int
) -> bool:
    """Whether the line, seen along its longest axis, touches a square: it does not pass beside one of the corners."""
    from_v, from_w = (2 * cell_v + 1) * edge - 2 * begin[v], (2 * cell_w + 1) * edge - 2 * begin[w]
    return bool(abs(from_v * way[w] - from_w * way[v]) <= edge * (abs(way[v]) + abs(way[w])))


@inner
def _entered(
    begin: NDArray[np.int64], way: NDArray[np.int64], u: int, v: int, w: int, cell: NDArray[np.int64], edge: int
) -> float:
    """The share of the line that lies before a box that it touches."""
    share = 0.0
    for axis in (u, v, w):
        if way[axis] != 0:
            face = cell[axis] * edge if way[axis] > 0 else (cell[axis] + 1) * edge
            share = max(share, (face - begin[axis]) / way[axis])
    return min(share, 1.0)


@inner
def _follow(grid: Grid, begin: NDArray[np.int64], end: NDArray[np.int64], nearest: FloatArray) -> None:
    """Fill in ``nearest`` (2,): the share of the line before the first obstacle, and before the first unknown voxel.

    2 stands for none. What is unknown behind the first obstacle is not looked for.
    """
    nearest[0] = nearest[1] = 2.0
    way = end - begin
    u = 0
    for axis in (1, 2):
        if abs(way[axis]) > abs(way[u]):
            u = axis
    v, w = (u + 1) % 3, (u + 2) % 3
    long = way[u] if way[u] != 0 else 1
    low, high = min(begin[u], end[u]), max(begin[u], end[u])
    edge = 4 * UNIT
    first, last = -(-low // edge) - 1, high // edge
    cell = np.empty(3, np.int64)
    key_i, key_j, key_k, row = 0, 0, 0, -2
    for layer in range(last - first + 1):
        cell[u] = first + layer if way[u] > 0 else last - layer
        # A layer may hold a nearer one still, the layers behind it may not.
        decided = nearest[1] <= 1.0
        from_u, to_u = max(low, cell[u] * edge), min(high, (cell[u] + 1) * edge)
        v0, v1 = _stretch(begin[v], way[v], begin[u], long, from_u, to_u, edge)
        w0, w1 = _stretch(begin[w], way[w], begin[u], long, from_u, to_u, edge)
        for cell_v in range(v0, v1 + 1):
            for cell_w in range(w0, w1 + 1):
                if v0 < v1 and w0 < w1 and not _crosses(begin, way, v, w, cell_v, cell_w, edge):
                    continue
                cell[v], cell[w] = cell_v, cell_w
                i, j, k = cell[0] >> 2, cell[1] >> 2, cell[2] >> 2
                if row == -2 or i != key_i or j != key_j or k != key_k:
                    key_i, key_j, key_k = i, j, k
                    row = row_of(grid, i, j, k)
                if row < 0:
                    nearest[1] = min(nearest[1], _entered(begin, way, u, v, w, cell, edge))
                    continue
                brick = place_of(cell[0] & 3, cell[1] & 3, cell[2] & 3)
                occupied, unknown = has(grid.occupied[row], brick), has(grid.unknown[row], brick)
                if not occupied and (not unknown or decided):
                    continue
                if has(grid.free[row], brick) or (occupied and unknown):
                    _through_brick(grid, row, brick, cell, begin, end, way, u, nearest)
                else:
                    kind = 0 if occupied else 1
                    nearest[kind] = min(nearest[kind], _entered(begin, way, u, v, w, cell, edge))
        if nearest[0] <= 1.0:
            return


@inner
def _through_brick(
    grid: Grid,
    row: int,
    brick: Integer,
    at: NDArray[np.int64],
    begin: NDArray[np.int64],
    end: NDArray[np.int64],
    way: NDArray[np.int64],
    u: int,
    nearest: FloatArray,
) -> None:
    """Look at the voxels of one brick that the line touches, all of them: those of other bricks may come before."""
    occupied, free = brick_words(grid, row, brick)
    v, w = (u + 1) % 3, (u + 2) % 3
    long = way[u] if way[u] != 0 else 1
    low, high = min(begin[u], end[u]), max(begin[u], end[u])
    cell = np.empty(3, np.int64)
    for layer in range(4):
        cell[u] = 4 * at[u] + layer
        from_u, to_u = max(low, cell[u] * UNIT), min(high, (cell[u] + 1) * UNIT)
        if from_u > to_u:
            continue
        v0, v1 = _stretch(begin[v], way[v], begin[u], long, from_u, to_u, UNIT)
        w0, w1 = _stretch(begin[w], way[w], begin[u], long, from_u, to_u, UNIT)
        for cell_v in range(max(v0, 4 * at[v]), min(v1, 4 * at[v] + 3) + 1):
            for cell_w in range(max(w0, 4 * at[w]), min(w1, 4 * at[w] + 3) + 1):
                if v0 < v1 and w0 < w1 and not _crosses(begin, way, v, w, cell_v, cell_w, UNIT):
                    continue
                cell[v], cell[w] = cell_v, cell_w
                bit = place_of(cell[0] & 3, cell[1] & 3, cell[2] & 3)
                if not has(free, bit):
                    kind = 0 if has(occupied, bit) else 1
                    nearest[kind] = min(nearest[kind], _entered(begin, way, u, v, w, cell, UNIT))
