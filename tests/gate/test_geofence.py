"""How far a place is outside."""

from __future__ import annotations

import math

import pytest

from companion.gate.geofence import excess_m
from companion.gate.plan import Geofence

BOX = Geofence(north_m=(-8.0, 4.0), east_m=(-2.0, 1.0), down_m=(-3.0, 0.5))


def test_nothing_fenced_is_everywhere_inside() -> None:
    """Protects flights without a fence."""
    assert excess_m(Geofence(), 1e6, -1e6, 1e6) == -math.inf


@pytest.mark.parametrize(
    ("place_m", "expected_m"),
    [
        ((0.0, 0.0, -1.0), -1.0),
        ((4.0, 0.0, -1.0), 0.0),
        ((5.5, 0.0, -1.0), 1.5),
        ((-9.0, 0.0, -1.0), 1.0),
        ((0.0, 1.25, -1.0), 0.25),
        ((0.0, -2.5, -1.0), 0.5),
        ((0.0, 0.0, -3.75), 0.75),
        ((0.0, 0.0, 1.0), 0.5),
        ((5.0, 1.5, 2.5), 2.0),
    ],
)
def test_each_side_of_the_box(place_m: tuple[float, float, float], expected_m: float) -> None:
    """Protects every wall of the fence; of several the one that is passed furthest counts."""
    assert excess_m(BOX, *place_m) == expected_m


def test_the_radius_is_about_the_origin_and_in_the_plane() -> None:
    """Protects the cylinder: height does not count, and both directions do."""
    round_m = Geofence(radius_m=5.0)
    assert excess_m(round_m, 3.0, 4.0, -100.0) == 0.0
    assert excess_m(round_m, -6.0, 8.0, 0.0) == 5.0
    assert excess_m(round_m, 0.0, 0.0, 0.0) == -5.0
    assert excess_m(Geofence(north_m=(-8.0, 4.0), radius_m=5.0), 0.0, 7.0, 0.0) == 2.0
