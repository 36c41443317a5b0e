"""Random networks of drifts: a spanning tree of a shaken grid of junctions, a few loops, a few dead ends."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sitl.mines.extrude import Array
from sitl.mines.plan import Drift

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
