"""Looks made by hand, and navigators that the rules alone have brought into each mode."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from hypothesis import settings

from companion.control.navigator import Navigator
from companion.model import CLEAR, HIT, UNKNOWN, Measurement, Mode, Pose, Scan
from tests.control.scene import BEARINGS_RAD, BINS, law_parameters, measurement, scan_of

ALWAYS, NEVER = 1.0 - 1e-12, 1e-12
"""Probabilities of a tangent that leave nothing to chance in a test, and still lie strictly between 0 and 1."""

AT_ONCE_MPS2 = 1e6
"""An acceleration that limits nothing."""

QUARTER = math.pi / 2.0
ORIGIN = Pose(0.0, 0.0, 0.0, 1.5, 0.0)
DT_S = law_parameters().period_s


compiled = settings(deadline=None)
"""For property tests of compiled functions: the first call may take seconds, which says nothing about the code."""


class Fixed(np.random.Generator):
    """A generator whose every draw gives the same number."""

    def __init__(self, value: float) -> None:
        super().__init__(np.random.PCG64(0))
        self.value = value
        self.draws = 0

    def random(self, *_: Any, **__: Any) -> Any:
        """That number."""
        self.draws += 1
        return self.value


def navigator_with(seed: int = 0, rng: np.random.Generator | None = None, **changes: Any) -> Navigator:
    """A navigator that has just been switched on, with the paper's coin and speed law unless told otherwise.

    Its speed and climb may jump, so that one step shows what the laws say.
    """
    law = {"choice": "coin", "speed_law": "paper", **changes}
    parameters = law_parameters(**law).model_copy(update={"max_accel_mps2": AT_ONCE_MPS2})
    return Navigator(parameters, rng or np.random.default_rng(seed))


def mode_of(navigator: Navigator) -> Mode:
    """What it is doing now."""
    return navigator.status.mode


# Looks from ORIGIN. They are shared: who changes one makes his own with `two_walls`.


def two_walls(right_m: float, left_m: float) -> Scan:
    """A wall at each side of the heading, as arcs about the vehicle; NaN is UNKNOWN, inf is CLEAR."""
    return scan_of(lambda bearing_rad: right_m if bearing_rad < 0.0 else left_m)


@functools.cache
def edge_scan(gamma: int) -> Scan:
    """One edge 4 m straight ahead, whose target is at (4, -Γ)."""
    return two_walls(4.0, 9.0) if gamma < 0 else two_walls(9.0, 4.0)


@functools.cache
def edge_to_the_unknown(gamma: int) -> Scan:
    """The same near wall; beside it nobody has looked."""
    return two_walls(4.0, math.nan) if gamma < 0 else two_walls(math.nan, 4.0)


@functools.cache
def wall_scan(gamma: int) -> Scan:
    """A straight wall at d_s on the side that Γ names, which ends abeam of the vehicle."""
    return scan_of(lambda b: 1.0 / math.sin(gamma * b) if 1.5 < gamma * b < 2.1 else math.inf)


def beside(gamma: int, ahead: Scan | None = None) -> Measurement:
    """That wall; further ahead another scan, or nothing."""
    scan = wall_scan(gamma)
    if ahead is not None:
        narrow = np.abs(BEARINGS_RAD) < 1.0
        ranges, state = np.where(narrow, ahead.ranges_m, scan.ranges_m), np.where(narrow, ahead.state, scan.state)
        scan = Scan(BEARINGS_RAD, ranges, state, scan.fresh)
    return measurement(scan, d_m=1.0, d_bearing_rad=gamma * QUARTER, d_front_m=1.0, d_dot_mps=0.0)


def wall_ahead(d_m: float, bearing_rad: float = 0.1) -> Measurement:
    """A wall across the way at that distance and bearing."""
    scan = scan_of(lambda b: d_m / math.cos(b - bearing_rad) if abs(b - bearing_rad) < 1.2 else math.inf)
    return measurement(scan, d_m=d_m, d_bearing_rad=bearing_rad, d_front_m=d_m, d_dot_mps=-0.5 * math.cos(bearing_rad))


OPEN = measurement(scan_of(lambda _: math.inf))
"""Seen free all round."""


def random_scan(rng: np.random.Generator) -> Scan:
    """Walls, free and unknown ground in stretches."""
    stretch = np.searchsorted(np.sort(rng.integers(0, BINS, 12)), np.arange(BINS))
    state = rng.choice([HIT, HIT, CLEAR, UNKNOWN], 13)[stretch].astype(np.uint8)
    near = rng.uniform(0.3, 9.8, 13)[stretch] + rng.uniform(0.0, 0.1, BINS)
    ranges = np.where(state == HIT, near, np.where(state == CLEAR, 10.0, 0.0))
    return Scan(BEARINGS_RAD.copy(), ranges, state, np.ones(BINS, np.bool_))


# Navigators.


def in_tangent(gamma: int, **changes: Any) -> Navigator:
    """In R2 since t = 0 at ORIGIN, on the way to (4, -Γ)."""
    navigator = navigator_with(**changes)
    navigator.step(measurement(edge_scan(gamma)), ORIGIN, 0.0)
    assert mode_of(navigator) is Mode.TANGENT
    return navigator


def in_boundary(gamma: int, **changes: Any) -> Navigator:
    """In R3 with that Γ since just before t = 0, at ORIGIN."""
    navigator = navigator_with(**changes)
    begin = replace(ORIGIN, x_m=-4.0, y_m=float(gamma))
    navigator.step(measurement(edge_scan(gamma)), begin, -2.0 * DT_S)
    navigator.step(beside(gamma), ORIGIN, -DT_S)
    assert mode_of(navigator) is Mode.BOUNDARY
    assert navigator.status.gamma == gamma
    return navigator


IN_MODE: dict[Mode, Callable[..., Navigator]] = {
    Mode.CIRCLE: navigator_with,
    Mode.TANGENT: lambda **changes: in_tangent(1, **changes),
    Mode.BOUNDARY: lambda **changes: in_boundary(1, **changes),
}
"""Each mode of (7), at ORIGIN; R3 with the wall on the left."""
