"""Mines that nobody drew: networks of crooked, rough drifts, one for every seed."""

from __future__ import annotations

import numpy as np

from sitl.mines.extrude import Array, extruded
from sitl.mines.model import World
from sitl.mines.network import drawn_network
from sitl.mines.plan import inside_m, middle_m

_WAVES = 24
_WAVELENGTH_M = (1.0, 3.0)
_FLOOR_SHARE = 0.4
_FLOOR_RISE = 0.25

_STEP_M = 0.35
_ROUGHNESS_M, _LEAST_M = 0.18, 0.02
"""Taken from both sides of a drift 3.2 m wide, the two leave 2.8 m clear."""
_HEIGHT_M = (2.8, 3.6)
_MAX_SLOPE = float(np.tan(np.deg2rad(8.0)))


class Roughness:
    """A sum of plane waves of 1 to 3 m, each pushing in its own direction.

    The floor is moved less than walls and roof, as in a mine where people walk and trucks drive.

    Args:
        rng: draws the waves.
        limit_m: no point is moved further than this; walls are moved by three quarters of it on average.
    """

    def __init__(self, rng: np.random.Generator, limit_m: float) -> None:
        wavelengths_m = np.geomspace(*_WAVELENGTH_M, _WAVES)
        self._waves = _unit(rng.normal(size=(_WAVES, 3))) * (2.0 * np.pi / wavelengths_m)[:, None]
        self._phases = rng.uniform(0.0, 2.0 * np.pi, _WAVES)
        # Long waves are high and short ones low, so that the slope they give the rock is the same.
        heights = wavelengths_m / np.sqrt(np.sum(wavelengths_m**2) / 2.0)
        self._pushes_m = _unit(rng.normal(size=(_WAVES, 3))) * (heights * limit_m)[:, None]
        self._limit_m = limit_m

    def __call__(self, points_m: Array, rise: Array) -> Array:
        """The points (n, 3) moved; ``rise`` (n,) goes from 0 on the floor to 1 on the roof."""
        pushed = np.sin(points_m @ self._waves.T + self._phases) @ self._pushes_m
        length = np.linalg.norm(pushed, axis=1) / self._limit_m
        bounded = pushed * (np.tanh(length) / np.maximum(length, 1e-9))[:, None]
        share = _FLOOR_SHARE + (1.0 - _FLOOR_SHARE) * np.minimum(rise / _FLOOR_RISE, 1.0)
        return np.asarray(points_m + bounded * share[:, None])


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


class _Swell:
    """A smooth field over the plan between -1 and 1, whose slope is bounded: waves of 18 to 40 m."""

    def __init__(self, rng: np.random.Generator) -> None:
        wavelengths_m = rng.uniform(18.0, 40.0, 4)
        bearings = rng.uniform(0.0, 2.0 * np.pi, 4)
        self._waves = np.stack([np.cos(bearings), np.sin(bearings)]) * (2.0 * np.pi / wavelengths_m)
        self._phases = rng.uniform(0.0, 2.0 * np.pi, 4)
        self.steepest_per_m = float(np.mean(2.0 * np.pi / wavelengths_m))

    def __call__(self, x_m: Array, y_m: Array) -> Array:
        return np.asarray(np.sin(np.stack([x_m, y_m], axis=-1) @ self._waves + self._phases).mean(axis=-1))


def random_world(seed: int) -> World:
    """The mine that ``seed`` draws: 120 to 220 m of drifts with loops and dead ends, rough, gently up and down.

    Drifts are 3.2 to 5 m wide before the walls are roughened, 2.8 to 3.6 m high, and have at least 3 m of rock between
    them where they do not meet. The same seed gives the same mine.
    """
    rng = np.random.default_rng(seed)
    network = drawn_network(rng)
    ground, roof, roughness = _Swell(rng), _Swell(rng), Roughness(rng, _ROUGHNESS_M)
    relief_m = _MAX_SLOPE / ground.steepest_per_m

    def ground_m(x_m: Array, y_m: Array) -> Array:
        return relief_m * ground(x_m, y_m)

    def height_m(x_m: Array, y_m: Array) -> Array:
        low, high = _HEIGHT_M
        return low + (high - low) * (roof(x_m, y_m) + 1.0) / 2.0

    drifts = network.drifts
    middle = middle_m(drifts)
    (x0, y0), (x1, y1) = middle.min(axis=0) - 4.0, middle.max(axis=0) + 4.0
    shell = extruded(
        *(np.arange(x0, x1, _STEP_M), np.arange(y0, y1, _STEP_M)),
        lambda x, y: inside_m(drifts, x, y),
        *(ground_m, height_m),
        wall_strips=8,
        displaced=roughness,
        least_m=_LEAST_M,
    )
    floor = np.column_stack([middle, ground_m(*middle.T)])
    # The rock moves sideways too, so the floor under a point is not exactly where that point itself was moved to.
    floor[:, 2] = roughness(floor, np.zeros(len(floor)))[:, 2]
    text = f"a rough mine of {network.length_m:.0f} m of drifts with {network.loops} loops, drawn by {seed}"
    return World(f"random:{seed}", shell.vertices_m, shell.triangles, None, floor, text)
