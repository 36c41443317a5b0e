"""The referee of vehicles that meet."""

from __future__ import annotations

import math

import pytest

from companion.config.load import load
from companion.model import Pose
from companion.pipeline import spacing
from sitl.scene.fellows import Body
from sitl.sim.encounters import Encounters

SPACING = spacing(load(None, None).settings)


def at(x_m: float, z_m: float = 1.5) -> Pose:
    """On the x axis."""
    return Pose(0.0, x_m, 0.0, z_m, 0.0)


@pytest.fixture
def encounters() -> Encounters:
    return Encounters(Body(0.35, 0.3), SPACING)


def test_nobody_met_nobody(encounters: Encounters) -> None:
    """One alone has no distance to another."""
    encounters.look([at(0.0)], 0.1)
    assert (encounters.least_apart_m, encounters.too_near_s, encounters.collisions) == (math.inf, 0.0, 0)


def test_the_least_distance_is_that_of_any_pair_at_any_time(encounters: Encounters) -> None:
    """In space, from middle to middle."""
    encounters.look([at(0.0), at(5.0), at(9.0)], 0.1)
    encounters.look([at(0.0), at(0.3, 1.1), at(9.0)], 0.1)
    encounters.look([at(0.0), at(5.0), at(9.0)], 0.1)
    assert encounters.least_apart_m == pytest.approx(0.5)


def test_too_near_is_near_in_the_plane_and_in_height(encounters: Encounters) -> None:
    """One above the other at a layer's distance is as it should be, and so is one beside the other."""
    encounters.look([at(0.0), at(0.0, 1.5 + SPACING.apart_m)], 0.1)
    encounters.look([at(0.0), at(SPACING.keep_m)], 0.1)
    assert encounters.too_near_s == 0.0
    encounters.look([at(0.0), at(0.9 * SPACING.keep_m, 1.4)], 0.1)
    assert encounters.too_near_s == pytest.approx(0.1)
    assert encounters.collisions == 0


def test_a_collision_is_counted_once_while_it_lasts(encounters: Encounters) -> None:
    """They touch for two looks, part, and touch again: two."""
    for x_m in (2.0, 0.6, 0.5, 2.0, 0.6):
        encounters.look([at(0.0), at(x_m)], 0.1)
    assert encounters.collisions == 2
