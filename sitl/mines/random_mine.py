"""Mines that nobody drew, one for every seed: crooked, rough drifts.

Their network is a spanning tree of a shaken grid of junctions, a few loops, a few dead ends.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sitl.mines.model import World
from sitl.mines.plan import Array, Drift, extruded, inside_m, middle_m

_SPACING_M = 15.5
_SHAKE_M = 1.8
_BOW_M = 0.8
"""With these three, drifts of 5 m that do not meet have 15.5 - 2 * 1.8 - 2 * 0.8 - 5 = 5.3 m of rock between them."""

_WIDTH_M = (3.2, 5.0)
_DEAD_END_GAP_M = 7.6
"""A dead end stops this far before the junction ahead: 3 m of rock, 2.5 and 1.6 m half widths, 0.4 m of roughness."""

_TREE_EDGES = 9
"""Whatever ten of the 4 x 3 junctions such a tree joins, at least one more edge between them closes a loop."""

_LOOPS = (1, 3)
_DEAD_ENDS = (1, 2)
_PIECES = 8

Edge = tuple[int, int]

_WAVES = 24
_WAVELENGTH_M = (1.0, 3.0)
_FLOOR_SHARE = 0.4
_FLOOR_RISE = 0.25
_STEP_M = 0.35

_ROUGHNESS_M, _LEAST_M = 0.18, 0.02
"""Taken from both sides of a drift 3.2 m wide, the two leave 2.8 m clear."""

_HEIGHT_M = (2.8, 3.6)
_MAX_SLOPE = float(np.tan(np.deg2rad(8.0)))


@dataclass(frozen=True, slots=True)
class Network:
    """Drifts that hang together: short straight pieces with round ends, and the number of independent loops."""

    drifts: tuple[Drift, ...]
    loops: int

    @property
    def length_m(self) -> float:
        """Length of all drifts along their middle."""
        return sum(drift.length_m for drift in self.drifts)


def drawn_network(rng: np.random.Generator) -> Network:
    """A network of 120 to 220 m with at least one loop and one dead end."""
    columns, rows = ((3, 3), (4, 3), (3, 4))[rng.integers(3)]
    cells = np.mgrid[:columns, :rows].reshape(2, -1).T
    nodes = cells * _SPACING_M + rng.uniform(-_SHAKE_M, _SHAKE_M, cells.shape)
    widths = rng.uniform(*_WIDTH_M, len(nodes))
    pairs = itertools.combinations(range(len(nodes)), 2)
    possible = [(a, b) for a, b in pairs if np.abs(cells[a] - cells[b]).sum() == 1]
    possible = [possible[k] for k in rng.permutation(len(possible))]

    tree = _tree(possible, min(_TREE_EDGES, len(nodes) - 1))
    reached = {node for edge in tree for node in edge}
    others = [edge for edge in possible if edge not in tree]
    closing = [edge for edge in others if reached.issuperset(edge)]
    closing = closing[: rng.integers(*_LOOPS, endpoint=True)]
    ending = [edge for edge in others if edge not in closing and not reached.isdisjoint(edge)]
    ending = ending[: rng.integers(*_DEAD_ENDS, endpoint=True)]

    drifts = []
    for a, b in tree + closing:
        drifts += _crooked(nodes[a], nodes[b], widths[a], widths[b], rng.uniform(-_BOW_M, _BOW_M))
    for a, b in ending:
        near, far = (a, b) if a in reached else (b, a)
        apart_m = np.linalg.norm(nodes[far] - nodes[near])
        tip = nodes[near] + (nodes[far] - nodes[near]) * (1.0 - _DEAD_END_GAP_M / apart_m)
        drifts += _crooked(nodes[near], tip, widths[near], _WIDTH_M[0], 0.0)
    return Network(tuple(drifts), len(closing))


def _tree(possible: Sequence[Edge], edges: int) -> list[Edge]:
    """A tree of that many edges, grown from the first of them by the first that fits."""
    tree = [possible[0]]
    reached = set(possible[0])
    while len(tree) < edges:
        edge = next(edge for edge in possible if len(reached.intersection(edge)) == 1)
        tree.append(edge)
        reached.update(edge)
    return tree


def _crooked(a_m: Array, b_m: Array, width_a_m: float, width_b_m: float, bow_m: float) -> list[Drift]:
    """A drift that leaves the straight line by ``bow_m`` in its middle (a quadratic Bézier curve), in short pieces."""
    ahead = (b_m - a_m) / np.linalg.norm(b_m - a_m)
    control = (a_m + b_m) / 2.0 + 2.0 * bow_m * np.array([-ahead[1], ahead[0]])
    t = np.linspace(0.0, 1.0, _PIECES + 1)[:, None]
    curve = [(float(x), float(y)) for x, y in (1 - t) ** 2 * a_m + 2 * t * (1 - t) * control + t**2 * b_m]
    halves = np.linspace(width_a_m, width_b_m, _PIECES + 1) / 2.0
    pieces = zip(itertools.pairwise(curve), itertools.pairwise(halves.tolist()), strict=True)
    return [Drift(a, b, half_a, half_b, square=False) for (a, b), (half_a, half_b) in pieces]


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
