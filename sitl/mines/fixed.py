"""The three worlds of the paper's Section 5, as well as its figures and words give them."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from sitl.mines.model import World
from sitl.mines.plan import Array, Drift, Height, extruded, grid_lines, inside_m, middle_m, round_drift, square_drift

_STEP_M = 0.5
_RAMP = float(np.tan(np.deg2rad(15.0)))


def complex_world() -> World:
    """Branches and cyclic routes on flat ground (paper Fig. 7): 4 m wide, 3 m high, some 210 m of drifts."""
    straight = [
        (0, 0, 48, 0),
        (12, 0, 12, 24),
        (12, 24, 36, 24),
        (36, 0, 36, 24),
        (12, 12, 36, 12),
        (48, 0, 48, 14),
        # dead ends
        (24, 24, 24, 33),
        (0, 0, 0, 14),
        (24, 0, 24, -9),
        (4, 24, 12, 24),
    ]
    drifts = [square_drift(*ends, width_m=4.0) for ends in straight]
    drifts.append(round_drift(48, 14, 36, 24, width_m=4.0))
    return _straight_world("complex", drifts, _flat, 3.0, "a flat mine of branches and three loops, after Fig. 7")


def slope_world() -> World:
    """A main drift with a branch, parts of both at 15 degrees (paper Fig. 8): 4 m wide, 3 m high."""
    drifts = [square_drift(2, 0, 60, 0, width_m=4.0), square_drift(34, 0, 34, 28, width_m=4.0)]
    x_bends_m, y_bends_m = (10.0, 24.0, 42.0, 52.0), (8.0, 20.0)

    def ground_m(x_m: Array, y_m: Array) -> Array:
        along_main = np.clip(x_m, 10.0, 24.0) - 10.0 - (np.clip(x_m, 42.0, 52.0) - 42.0)
        along_branch = -(np.clip(y_m, 8.0, 20.0) - 8.0)
        return np.asarray(_RAMP * (along_main + along_branch))

    text = "a main drift and a branch, up and down at 15 degrees, after Fig. 8"
    return _straight_world("slope", drifts, ground_m, 3.0, text, x_bends_m, y_bends_m)


def room_world() -> World:
    """The closed L of boards of the paper's flight: legs of 10 m and 7 m, 3.6 m wide, 2.7 m high."""
    drifts = [square_drift(1.8, 1.8, 8.2, 1.8, width_m=3.6), square_drift(8.2, 1.8, 8.2, 5.2, width_m=3.6)]
    return _straight_world("room", drifts, _flat, 2.7, "a closed L-shaped tunnel segment, after Section 5")


def _flat(x_m: Array, _y_m: Array) -> Array:
    return np.zeros_like(x_m)


def _straight_world(
    name: str,
    drifts: Sequence[Drift],
    ground_m: Height,
    roof_m: float,
    description: str,
    x_bends_m: Sequence[float] = (),
    y_bends_m: Sequence[float] = (),
) -> World:
    """A world of straight walls; the floor may bend where grid lines are asked for."""
    x_walls, y_walls = [], []
    for drift in drifts:
        for (x, y), half in itertools.product((drift.a_m, drift.b_m), (-drift.half_width_a_m, drift.half_width_a_m)):
            x_walls.append(x + half)
            y_walls.append(y + half)
    shell = extruded(
        grid_lines(x_walls, x_bends_m, _STEP_M),
        grid_lines(y_walls, y_bends_m, _STEP_M),
        lambda x, y: inside_m(drifts, x, y),
        ground_m,
        lambda x, _y: np.full_like(x, roof_m),
    )
    middle = middle_m(drifts)
    start_area = np.column_stack([middle, ground_m(*middle.T)])
    return World(name, shell.vertices_m, shell.triangles, None, start_area, description)
