"""Points on the surface of a world, one for each voxel that the surface passes through."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled
from companion.errors import InputError
from sitl.mines.model import World

Array = NDArray[np.float64]
Points = NDArray[np.float32]

_DENSITY = 8.0
"""How many points are tried for each voxel's worth of surface."""

MOST_TRIED = 2_000_000_000
"""Of more points the truth would take longer than half a minute. No mine has so much surface within sight, but
triangles of square kilometres do."""


class Surroundings(NamedTuple):
    """The part of the plan from which something may be seen, in cells of a metre."""

    west_m: float
    south_m: float
    near: NDArray[np.bool_]
    """(nx, ny) whether a cell may hold a point within the range."""

    @classmethod
    def of(cls, surface_points: Array, range_m: float) -> Surroundings:
        """Where points of the surface may be that are seen from S, and some more."""
        margin = int(np.ceil(range_m)) + 2
        low = np.floor(surface_points[:, :2].min(axis=0)).astype(np.int64) - margin
        cells = np.floor(surface_points[:, :2]).astype(np.int64) - low
        near = np.zeros(cells.max(axis=0) + margin + 1, np.bool_)
        near[cells[:, 0], cells[:, 1]] = True
        # A square about each cell: one pass for each axis.
        for axis in (0, 1):
            grown = near.copy()
            for step in range(1, margin):
                shifted = np.moveaxis(near, axis, 0)
                target = np.moveaxis(grown, axis, 0)
                target[step:] |= shifted[:-step]
                target[:-step] |= shifted[step:]
            near = grown
        return cls(float(low[0]), float(low[1]), near)

    def meet(self, corners: Array) -> NDArray[np.bool_]:
        """Whether the rectangle around each triangle (m, 3, 3), seen from above, has part of them in it: (m,)."""
        sums = np.zeros((self.near.shape[0] + 1, self.near.shape[1] + 1), np.int32)
        np.cumsum(np.cumsum(self.near, axis=0, dtype=np.int32), axis=1, out=sums[1:, 1:])
        corner_m = np.array([self.west_m, self.south_m])
        low = np.floor(corners[:, :, :2].min(axis=1) - corner_m)
        high = np.floor(corners[:, :, :2].max(axis=1) - corner_m) + 1.0
        (x0, y0), (x1, y1) = (np.clip(edge, 0, self.near.shape).astype(np.int64).T for edge in (low, high))
        return np.asarray(sums[x1, y1] - sums[x0, y1] - sums[x1, y0] + sums[x0, y0] > 0)

    @classmethod
    def everywhere(cls, world: World) -> Surroundings:
        """The whole world."""
        low, high = np.floor(world.vertices_m[:, :2].min(axis=0)), np.floor(world.vertices_m[:, :2].max(axis=0))
        return cls(float(low[0]), float(low[1]), np.ones((high - low).astype(np.int64) + 1, np.bool_))


def triangle_areas(world: World) -> Array:
    """(n,) area of each triangle, in m²."""
    corners = world.vertices_m[world.triangles].astype(np.float64)
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.asarray(np.linalg.norm(cross, axis=1) / 2.0, np.float64)


def surface_samples(world: World, voxel_m: float, surroundings: Surroundings | None = None) -> tuple[Points, Points]:
    """One point of the surface for each voxel that the surface passes through.

    A mine of half a kilometre of which the vehicle can reach a tenth has a hundred times more surface than it can see:
    only what lies in the surroundings is kept.

    The surface is covered evenly with points (a low-discrepancy sequence, so the same world gives the same points), and
    of those in one voxel the one nearest to their mean is kept.

    Returns:
        (n, 3) float32 points in m, and (n,) float32 how much surface in m² each stands for.

    Raises:
        InputError: so much surface that `MOST_TRIED` points do not cover it.
    """
    corners = world.vertices_m[world.triangles].astype(np.float64)
    reached = np.floor(np.cumsum(triangle_areas(world)) * (_DENSITY / voxel_m**2)).astype(np.int64)
    part = Surroundings.everywhere(world) if surroundings is None else surroundings
    within = part.meet(corners)
    tried = np.diff(reached, prepend=0)[within]
    if tried.sum() > MOST_TRIED:
        area_m2 = voxel_m**2 / _DENSITY
        raise InputError(
            f"world {world.name}: {tried.sum() * area_m2:.0f} m² of surface around the floor that can be reached, the "
            f"largest triangle {tried.max() * area_m2:.0f} m²: cut large triangles into smaller ones or the mesh into "
            f"parts, make mapping.voxel_m = {voxel_m:g} m larger, or, if the unit is not the metre, give --scale"
        )
    none = np.empty((0, 3), dtype=np.float32)
    found = _covering(corners, within, reached, voxel_m, part, none, np.empty((0, 3), dtype=np.int64))
    points, cells = np.empty((found, 3), dtype=np.float32), np.empty((found, 3), dtype=np.int64)
    _covering(corners, within, reached, voxel_m, part, points, cells)
    order, starts = grouped(cells)
    counts = np.diff(starts, append=len(order))
    return points[_central(points, order, starts, counts)], (counts * (voxel_m**2 / _DENSITY)).astype(np.float32)


@compiled
def _covering(
    corners: Array,
    within: NDArray[np.bool_],
    reached: NDArray[np.int64],
    voxel_m: float,
    part: Surroundings,
    points: Points,
    cells: NDArray[np.int64],
) -> int:
    """Points spread evenly over triangles (m, 3, 3), and their voxels; triangles 0 to t get ``reached[t]`` of them.

    Triangles that are not ``within`` have none in ``part`` and are passed over. Those in ``part`` are written into
    ``points`` and ``cells`` as far as there is room; returns how many there are.
    """
    # Voxels that no wall at a round coordinate lies on the border of: rounding would put it half into either.
    shift = (0.3719, 0.4217, 0.2911)
    width, height = part.near.shape
    k = found = 0
    place = np.empty(3)
    for t in range(len(reached)):
        if not within[t]:
            k = reached[t]
        while k < reached[t]:
            u, v = k * 0.7548776662466927 % 1.0, k * 0.5698402909980532 % 1.0  # the R2 sequence
            if u + v > 1.0:
                u, v = 1.0 - u, 1.0 - v
            for axis in range(3):
                a = corners[t, 0, axis]
                place[axis] = a + u * (corners[t, 1, axis] - a) + v * (corners[t, 2, axis] - a)
            k += 1
            i, j = int(np.floor(place[0] - part.west_m)), int(np.floor(place[1] - part.south_m))
            if not (0 <= i < width and 0 <= j < height and part.near[i, j]):
                continue
            if found < len(points):
                for axis in range(3):
                    points[found, axis] = place[axis]
                    cells[found, axis] = int(np.floor(place[axis] / voxel_m + shift[axis]))
            found += 1
    return found


@compiled
def _central(
    points: Points, order: NDArray[np.int64], starts: NDArray[np.int64], counts: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Of each group of points the index of the one nearest to the group's mean."""
    central = np.empty(len(starts), dtype=np.int64)
    for group in range(len(starts)):
        members = order[starts[group] : starts[group] + counts[group]]
        x = y = z = 0.0
        for k in members:
            x += points[k, 0] / len(members)
            y += points[k, 1] / len(members)
            z += points[k, 2] / len(members)
        least = np.inf
        for k in members:
            off = (points[k, 0] - x) ** 2 + (points[k, 1] - y) ** 2 + (points[k, 2] - z) ** 2
            if off < least:
                least, central[group] = off, k
    return central


def grouped(cells: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """An order (n,) that brings equal cells (n, 3) together, and where each group starts in it."""
    sizes = np.ptp(cells, axis=0) + 1
    low = cells - cells.min(axis=0)
    keys = (low[:, 0] * sizes[1] + low[:, 1]) * sizes[2] + low[:, 2]
    order = np.argsort(keys, kind="stable")
    return order, np.flatnonzero(np.diff(keys[order], prepend=-1))
