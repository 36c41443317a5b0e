"""How far a look is off another one of the same place."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from companion.control.homing.matching import FINE_M, FINE_RAD, match
from tests.control.stages import compiled

REACH_M, REACH_RAD = 1.0, math.radians(6.0)


def corner() -> NDArray[np.float64]:
    """Walls about the origin that say where one is: a crossing with a pillar in one arm."""
    along = np.arange(1.5, 6.0, 0.07)
    right_angles = [(s * x, t * 1.5) for x in along for s in (-1, 1) for t in (-1, 1)]
    pillar = [(3.0 + 0.4 * math.cos(a), 0.3 + 0.4 * math.sin(a)) for a in np.arange(0.0, 6.2, 0.2)]
    return np.array([*right_angles, *[(y, x) for x, y in right_angles], *pillar])


def moved(walls_m: NDArray[np.float64], x_m: float, y_m: float, turn_rad: float) -> NDArray[np.float64]:
    cos, sin = math.cos(turn_rad), math.sin(turn_rad)
    return np.asarray(walls_m @ np.array([[cos, sin], [-sin, cos]]) + (x_m, y_m), np.float64)


@compiled
@given(
    x_m=st.floats(-0.6, 0.6),
    y_m=st.floats(-0.6, 0.6),
    turn_rad=st.floats(-REACH_RAD, REACH_RAD).map(lambda rad: 0.7 * rad),
)
def test_a_look_that_is_off_is_put_right(x_m: float, y_m: float, turn_rad: float) -> None:
    """Protects the last metres home: what a drifted position is off by, the walls tell to a step of the search."""
    known = corner()
    look = moved(known[::2], x_m, y_m, turn_rad)
    found = match(look, (x_m, y_m), known, REACH_M, REACH_RAD)
    assert (found.x_m, found.y_m) == pytest.approx((-x_m, -y_m), abs=2.0 * FINE_M)
    assert found.turn_rad == pytest.approx(-turn_rad, abs=3.0 * FINE_RAD)
    assert found.share > 0.6


def test_another_place_is_not_the_same() -> None:
    """Protects from walls that fit nowhere: hardly half of them lie on known ones however they are moved."""
    rng = np.random.default_rng(1)
    scattered = rng.uniform(-5.0, 5.0, (200, 2))
    assert match(scattered, (0.0, 0.0), corner(), REACH_M, REACH_RAD).share < 0.5


def test_along_a_smooth_drift_nothing_says_how_far() -> None:
    """Protects a position that is right: two straight walls hold it across, and along them it stays as it was."""
    x = np.arange(-6.0, 6.0, 0.05)
    walls = np.concatenate([np.stack([x, np.full_like(x, y)], axis=1) for y in (-1.5, 1.5)])
    found = match(walls[np.abs(walls[:, 0]) < 4.0] + (0.0, 0.3), (0.0, 0.3), walls, REACH_M, REACH_RAD)
    assert found.y_m == pytest.approx(-0.3, abs=FINE_M)
    assert found.x_m == pytest.approx(0.0, abs=FINE_M)


def test_posts_that_stand_in_a_row_tell_no_place() -> None:
    """Protects the landing: a place beside agrees less, but the next post is as good, and nobody knows which it is."""
    x = np.arange(-9.0, 9.0, 0.05)
    walls = np.concatenate([np.stack([x, np.full_like(x, y)], axis=1) for y in (-1.5, 1.5)])
    posts = np.array([(at, y) for at in np.arange(-8.4, 8.5, 1.2) for y in np.arange(-1.5, -1.0, 0.02)])
    known = np.concatenate([walls, np.repeat(posts, 4, axis=0)])
    found = match(known[np.abs(known[:, 0]) < 3.5], (0.0, 0.0), known, 2.0, REACH_RAD)
    assert (found.x_m, found.y_m, found.share) == pytest.approx((0.0, 0.0, 1.0), abs=FINE_M)
    assert found.better_by < 0.05
    alone = np.concatenate([walls, np.repeat(posts[np.abs(posts[:, 0]) < 0.1], 20, axis=0)])
    assert match(alone[np.abs(alone[:, 0]) < 3.5], (0.0, 0.0), alone, 2.0, REACH_RAD).better_by > 0.1
