"""The plan of a mine: drifts as shapes in the plane, and the grid on which they are meshed."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

CORNER_M = 0.01
"""How far the grid lines beside a straight wall lie from it: so much do sharp corners lose."""


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
