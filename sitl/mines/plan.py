"""The plan of a mine, drifts as shapes in the plane, and the closed triangle mesh that is raised over it.

Floor, roof and walls share their vertices, so nothing can crack.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

CORNER_M = 0.01
"""How far the grid lines beside a straight wall lie from it: so much do sharp corners lose."""

Height = Callable[[Array, Array], Array]
"""A continuous field over the plan: (x_m, y_m) -> m."""

Displacement = Callable[[Array, Array], Array]
"""Moves vertices: (points_m (n, 3), rise (n,) from 0 on the floor to 1 on the roof) -> moved points (n, 3)."""


@dataclass(frozen=True, slots=True)
class Drift:
    """One straight piece of drift, from ``a_m`` to ``b_m`` along its middle.

    Its ends reach half a width beyond ``a_m`` and ``b_m``, square or round, so that pieces which share an end join
    without a notch. A square drift is as wide everywhere as at ``a_m``.
    """

    a_m: tuple[float, float]
    b_m: tuple[float, float]
    half_width_a_m: float
    half_width_b_m: float
    square: bool

    @property
    def length_m(self) -> float:
        """Length from end to end along the middle."""
        return float(np.hypot(self.b_m[0] - self.a_m[0], self.b_m[1] - self.a_m[1]))

    def inside_m(self, x_m: Array, y_m: Array) -> Array:
        """How far inside this drift points are: positive inside, negative outside, zero on the wall."""
        dx, dy = x_m - self.a_m[0], y_m - self.a_m[1]
        ux, uy = (self.b_m[0] - self.a_m[0]) / self.length_m, (self.b_m[1] - self.a_m[1]) / self.length_m
        along, across = dx * ux + dy * uy, dy * ux - dx * uy
        if self.square:
            half = self.half_width_a_m
            return np.minimum(half - np.abs(across), self.length_m / 2 + half - np.abs(along - self.length_m / 2))
        nearest = np.clip(along, 0.0, self.length_m)
        half_there = self.half_width_a_m + (self.half_width_b_m - self.half_width_a_m) * nearest / self.length_m
        return np.asarray(half_there - np.hypot(along - nearest, across))

    def middle_m(self, step_m: float) -> Array:
        """(n, 2) points along the middle, about ``step_m`` apart, both ends among them."""
        share = np.linspace(0.0, 1.0, max(2, round(self.length_m / step_m) + 1))[:, None]
        return np.asarray(self.a_m) * (1.0 - share) + np.asarray(self.b_m) * share


def square_drift(ax_m: float, ay_m: float, bx_m: float, by_m: float, width_m: float) -> Drift:
    """A drift of constant width with square ends."""
    return Drift((ax_m, ay_m), (bx_m, by_m), width_m / 2, width_m / 2, square=True)


def round_drift(ax_m: float, ay_m: float, bx_m: float, by_m: float, width_m: float) -> Drift:
    """A drift of constant width with round ends, which can meet others at any angle."""
    return Drift((ax_m, ay_m), (bx_m, by_m), width_m / 2, width_m / 2, square=False)


def inside_m(drifts: Sequence[Drift], x_m: Array, y_m: Array) -> Array:
    """How far inside the union of the drifts points are: positive inside, zero on the wall."""
    inside = np.full(np.broadcast(x_m, y_m).shape, -np.inf)
    for drift in drifts:
        np.maximum(inside, drift.inside_m(x_m, y_m), out=inside)
    return inside


def middle_m(drifts: Sequence[Drift], step_m: float = 0.5) -> Array:
    """(n, 2) distinct points along the middle of all drifts: everywhere half a width from the nearest wall."""
    return np.unique(np.concatenate([drift.middle_m(step_m) for drift in drifts]).round(6), axis=0)


def grid_lines(walls_m: Sequence[float], bends_m: Sequence[float], step_m: float) -> Array:
    """Ascending coordinates of grid lines: a close pair around each wall, one at each bend, evenly spaced between.

    A wall that runs along the grid lies between two lines `CORNER_M` to either side of it, so its corners are sharp
    however wide the other cells are. The lines begin and end one step outside the outermost walls.
    """
    walls = sorted({round(wall, 6) for wall in walls_m})
    pairs = [wall + side for wall in walls for side in (-CORNER_M, CORNER_M)]
    stops = sorted([walls[0] - step_m, *pairs, *bends_m, walls[-1] + step_m])
    gaps = [np.linspace(a, b, int(np.ceil((b - a) / step_m)), endpoint=False) for a, b in itertools.pairwise(stops)]
    return np.append(np.concatenate(gaps), stops[-1])


@dataclass(frozen=True, slots=True, eq=False)
class Shell:
    """A closed mesh whose triangles face the free space inside: vertices (n, 3) in m, triangles (m, 3)."""

    vertices_m: NDArray[np.float32]
    triangles: NDArray[np.int32]


def extruded(
    x_lines_m: Array,
    y_lines_m: Array,
    inside_m: Height,
    ground_m: Height,
    height_m: Height,
    wall_strips: int = 1,
    displaced: Displacement | None = None,
    least_m: float = 1e-3,
) -> Shell:
    """The closed surface around the free space over a plan.

    Args:
        x_lines_m: (nx,) ascending grid lines; the free space ends before the first and the last.
        y_lines_m: (ny,) the same along y.
        inside_m: the plan: positive where free, and linear across a straight wall if that wall is to be straight.
        ground_m: height of the floor.
        height_m: height of the roof above the floor.
        wall_strips: how many pairs of triangles a wall is high.
        displaced: moves every vertex at the end; being one continuous field, it keeps the surface closed.
        least_m: a wall nearer than this to a grid point is moved this far away from it: no triangle may be a point.
    """
    x, y = np.meshgrid(x_lines_m, y_lines_m, indexing="ij")
    inside = inside_m(x, y)
    inside = np.where(np.abs(inside) < least_m, np.copysign(least_m, inside), inside)
    if (inside[[0, -1]] > 0.0).any() or (inside[:, [0, -1]] > 0.0).any():
        raise ValueError("the free space reaches the border of the grid")

    plan, ids = _plan_vertices(x_lines_m, y_lines_m, inside)
    floor, walls = _polygons(inside > 0.0, ids)

    n = len(plan)  # vertex k of the plan is vertex k + level * n of the mesh, as far as it is used there
    triangles = [floor, floor[:, ::-1] + wall_strips * n]
    a, b = walls.T
    for low in range(0, wall_strips * n, n):
        high = low + n
        triangles += [np.stack([b + low, a + low, a + high], axis=1), np.stack([b + low, a + high, b + high], axis=1)]
    used, renumbered = np.unique(np.concatenate(triangles), return_inverse=True)

    rise = used // n / wall_strips
    px, py = plan[used % n].T
    points = np.stack([px, py, ground_m(px, py) + rise * height_m(px, py)], axis=1)
    if displaced is not None:
        points = displaced(points, rise)
    return Shell(points.astype(np.float32), renumbered.astype(np.int32))


def _plan_vertices(x_lines: Array, y_lines: Array, inside: Array) -> tuple[Array, NDArray[np.int64]]:
    """Vertices of the plan, and for each cell the indices of its eight possible ones.

    Returns:
        (n, 2) points, and (nx - 1, ny - 1, 8): corners counter-clockwise from the lower left, then the wall on the
        edges below, right, above and left. -1 where there is none.
    """
    free = inside > 0.0
    ix, iy = np.nonzero(free)
    corner = np.full(free.shape, -1)
    corner[ix, iy] = np.arange(len(ix))
    points = [np.stack([x_lines[ix], y_lines[iy]], axis=1)]
    count = len(ix)

    crossing = []
    for axis, (near, far) in enumerate(((inside[:-1], inside[1:]), (inside[:, :-1], inside[:, 1:]))):
        ix, iy = np.nonzero((near > 0.0) != (far > 0.0))
        share = near[ix, iy] / (near[ix, iy] - far[ix, iy])
        where = np.stack([x_lines[ix], y_lines[iy]], axis=1)
        lines, index = ((x_lines, ix), (y_lines, iy))[axis]
        where[:, axis] += share * (lines[index + 1] - lines[index])
        edge = np.full(near.shape, -1)
        edge[ix, iy] = count + np.arange(len(ix))
        count += len(ix)
        points.append(where)
        crossing.append(edge)
    along_x, along_y = crossing
    ids = np.stack(
        [
            *(corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]),
            *(along_x[:, :-1], along_y[1:], along_x[:, 1:], along_y[:-1]),
        ],
        axis=2,
    )
    return np.concatenate(points), ids


def _polygon(case: int) -> list[int]:
    """The free part of a cell as a counter-clockwise polygon, for one of the 16 cases of marching squares.

    Bit k of ``case`` says that corner k is free. In the two ambiguous cases the free corners are joined.
    """
    polygon = []
    for k in range(4):
        here, following = case >> k & 1, case >> (k + 1) % 4 & 1
        polygon += [k] * here + [4 + k] * (here != following)
    return polygon


def _polygons(free: NDArray[np.bool_], ids: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Marching squares: floor triangles (m, 3), and wall segments (w, 2) with the free space to their left."""
    cases = free[:-1, :-1] + 2 * free[1:, :-1] + 4 * free[1:, 1:] + 8 * free[:-1, 1:]
    triangles, walls = [], []
    for case in range(1, 16):
        cells = ids[cases == case]
        polygon = _polygon(case)
        triangles += [cells[:, [polygon[0], polygon[k], polygon[k + 1]]] for k in range(1, len(polygon) - 1)]
        sides = zip(polygon, polygon[1:] + polygon[:1], strict=True)
        walls += [cells[:, [a, b]] for a, b in sides if a >= 4 and b >= 4]
    return np.concatenate(triangles), np.concatenate(walls)
