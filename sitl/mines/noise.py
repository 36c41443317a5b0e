"""Rough rock: one continuous field that moves the vertices of a smooth mine."""

from __future__ import annotations

import numpy as np

from sitl.mines.extrude import Array

_WAVES = 24
_WAVELENGTH_M = (1.0, 3.0)
_FLOOR_SHARE = 0.4
_FLOOR_RISE = 0.25


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
