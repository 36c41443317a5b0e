"""False returns from what is in the air: small clouds in depth images, short readings of beams, in puffs."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from companion.model import Camera
from sitl.mines.conditions import Dust

PERIOD_S = 8.0
"""A puff comes this often, and lasts for half of it."""

CLOUD_M = 0.03
"""Radius of a cloud that the camera takes for something."""

NEAREST_M, FARTHEST_M = 0.3, 3.0
"""Between these are the clouds that matter: nearer nothing is measured, farther they are too thin."""


def is_puffing(t_s: float) -> bool:
    """Whether there is dust now."""
    return math.fmod(t_s, PERIOD_S) < PERIOD_S / 2.0


def in_image(dust: Dust, camera: Camera, depth_m: NDArray[np.float32], rng: np.random.Generator) -> None:
    """Puts clouds into a depth image (height, width), in place, where they are nearer than what is there."""
    rows, columns = np.indices(depth_m.shape)
    for _ in range(int(rng.poisson(dust.clouds))):
        away_m = rng.uniform(NEAREST_M, FARTHEST_M)
        row, column = rng.uniform((0.0, 0.0), depth_m.shape)
        radius_px = CLOUD_M * camera.fx_px / away_m
        there = (rows - row) ** 2 + (columns - column) ** 2 <= radius_px**2
        depth_m[there] = np.fmin(depth_m[there], away_m)


def in_ranges(dust: Dust, ranges_m: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float64]:
    """Ranges (n,) of beams, some of which end in the dust."""
    false_m = rng.uniform(NEAREST_M, FARTHEST_M, ranges_m.shape)
    return np.where(rng.random(ranges_m.shape) < dust.beam_share, np.fmin(ranges_m, false_m), ranges_m)
