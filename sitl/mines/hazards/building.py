"""How the mines of single hazards are built: a rough drift with a branch, and bodies that stand or hang in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sitl.mines.conditions import NONE, Conditions
from sitl.mines.model import World
from sitl.mines.plan import CORNER_M, Array, Drift, Height, Shell, extruded, inside_m, round_drift
from sitl.mines.random_mine import Roughness

WIDTH_M = 4.2
HEIGHT_M = 3.0
MAIN_M = 26.0
BRANCH_X_M = 20.0
"""The drift begins at x = 0; what is looked at lies between x = 8 and 14 m, before everything else."""

START_M = (0.0, 4.0)
"""Between these along the drift a flight begins."""

_STEP_M = 0.35
_ROUGHNESS_M = 0.12
_DRAWN_BY = 11


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """A closed mesh that faces outward: vertices (n, 3) float32, triangles (m, 3) int32."""

    vertices_m: NDArray[np.float32]
    triangles: NDArray[np.int32]


def main_and_branch(width_m: float = WIDTH_M) -> list[Drift]:
    """A drift along x with a branch to the north behind what is looked at: 38 m of drifts."""
    return [
        round_drift(0.0, 0.0, MAIN_M, 0.0, width_m=width_m),
        round_drift(BRANCH_X_M, 0.0, BRANCH_X_M, 12.0, width_m=width_m),
    ]


def flat(x_m: Array, _y_m: Array) -> Array:
    """A level floor."""
    return np.zeros_like(x_m)


def level(height_m: float) -> Height:
    """The same height everywhere."""
    return lambda x_m, _y_m: np.full_like(x_m, height_m)


def rough(
    drifts: Sequence[Drift],
    ground_m: Height = flat,
    height_m: Height | None = None,
    x_edges_m: Sequence[float] = (),
    y_edges_m: Sequence[float] = (),
    roughness_m: float = _ROUGHNESS_M,
) -> Shell:
    """A rough shell around drifts; floor and roof may break off sharply at edges along x and y.

    Args:
        drifts: the plan.
        ground_m: height of the floor.
        height_m: of the roof above it; `HEIGHT_M` everywhere where none is given.
        x_edges_m: where a height jumps from one x to the next.
        y_edges_m: where one jumps along y.
        roughness_m: how far walls and roof are moved at most; 0 leaves them smooth.
    """
    ends = np.array([end for drift in drifts for end in (drift.a_m, drift.b_m)])
    widest_m = max(max(drift.half_width_a_m, drift.half_width_b_m) for drift in drifts)
    low, high = ends.min(axis=0) - widest_m - 1.0, ends.max(axis=0) + widest_m + 1.0
    return extruded(
        _lines(low[0], high[0], x_edges_m),
        _lines(low[1], high[1], y_edges_m),
        lambda x, y: inside_m(drifts, x, y),
        ground_m,
        level(HEIGHT_M) if height_m is None else height_m,
        wall_strips=8,
        displaced=Roughness(np.random.default_rng(_DRAWN_BY), roughness_m) if roughness_m > 0.0 else None,
        least_m=CORNER_M,
    )


def _lines(low_m: float, high_m: float, edges_m: Sequence[float]) -> Array:
    pairs = np.array([edge + side for edge in edges_m for side in (-CORNER_M, CORNER_M)])
    even = np.arange(low_m, high_m, _STEP_M)
    apart = np.abs(even[:, None] - np.asarray(edges_m)[None]).min(axis=1, initial=np.inf) > 3.0 * CORNER_M
    return np.sort(np.concatenate([even[apart], pairs]))


def box(low_m: Sequence[float], high_m: Sequence[float]) -> Body:
    """A box from its lowest corner (x, y, z) to its highest."""
    (x0, y0, z0), (x1, y1, z1) = low_m, high_m
    return beam((x0, (y0 + y1) / 2, (z0 + z1) / 2), (x1, (y0 + y1) / 2, (z0 + z1) / 2), y1 - y0, z1 - z0)


def beam(a_m: Sequence[float], b_m: Sequence[float], thick_m: float, high_m: float | None = None) -> Body:
    """A straight bar of rectangular section from one end (x, y, z) to the other: props, cables, wires."""
    a, b = np.asarray(a_m, np.float64), np.asarray(b_m, np.float64)
    along = (b - a) / np.linalg.norm(b - a)
    aside = np.cross((0.0, 0.0, 1.0) if abs(along[2]) < 0.9 else (1.0, 0.0, 0.0), along)
    aside /= np.linalg.norm(aside)
    above = np.cross(along, aside)
    aside, above = aside * thick_m / 2, above * (thick_m if high_m is None else high_m) / 2
    ring = [-aside - above, aside - above, aside + above, -aside + above]
    vertices = np.array([end + corner for end in (a, b) for corner in ring])
    quads = [[0, 3, 2, 1], [4, 5, 6, 7], *([k, (k + 1) % 4, 4 + (k + 1) % 4, 4 + k] for k in range(4))]
    triangles = [[quad[0], quad[k], quad[k + 1]] for quad in quads for k in (1, 2)]
    return Body(vertices.astype(np.float32), np.array(triangles, np.int32))


def together(shell: Shell | Body, bodies: Sequence[Body]) -> Body:
    """All of it as one mesh; the shell's triangles come first."""
    vertices, triangles, count = [shell.vertices_m], [shell.triangles], len(shell.vertices_m)
    for body in bodies:
        vertices.append(body.vertices_m)
        triangles.append((body.triangles + count).astype(np.int32))
        count += len(body.vertices_m)
    return Body(np.concatenate(vertices), np.concatenate(triangles))


def mine(
    name: str, description: str, surface: Shell | Body, conditions: Conditions = NONE, start_floor_m: float = 0.0
) -> World:
    """The world of one hazard; flights begin at its western end."""
    x = np.linspace(*START_M, 9)
    start_area = np.column_stack([x, np.zeros(len(x)), np.full(len(x), start_floor_m)])
    return World(
        f"hazard:{name}",
        surface.vertices_m,
        surface.triangles,
        None,
        start_area,
        description,
        conditions=conditions,
    )
