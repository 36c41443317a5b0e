"""By a point from which the way on is free, where the straight is not."""

from __future__ import annotations

import math

import pytest

from companion.control.dogleg import dogleg
from companion.control.edges import corridor_is_free
from companion.model import Pose
from tests.control.scene import CAMERA_RAD, Scene, box

HALF_WIDTH_M = 0.85
TO_GO_M = 6.0
HERE = Pose(0.0, 0.0, 0.0, 1.5, 0.0)


def gap(width_m: float, middle_m: float) -> Scene:
    """A drift 6 m wide, along x, with a wall across it 3 m ahead in which a gap is open."""
    return Scene(
        box(-5.0, -3.0, 20.0, 3.0),
        box(3.0, -3.0, 3.2, middle_m - width_m / 2.0),
        box(3.0, middle_m + width_m / 2.0, 3.2, 3.0),
    )


@pytest.mark.parametrize("middle_m", [0.4, -0.4, 0.6, -0.6])
def test_it_leads_through_a_gap_beside_the_straight(middle_m: float) -> None:
    """Protects the way home through a narrow place: hardly one straight leads through, and that one is found."""
    scene = gap(1.9, middle_m)
    scan = scene.scan(HERE, CAMERA_RAD)
    assert not corridor_is_free(scan, 0.0, 4.0, HALF_WIDTH_M)
    found = dogleg(scan, 0.0, TO_GO_M, HALF_WIDTH_M)
    assert found is not None
    (bearing_rad, range_m), end = found
    assert corridor_is_free(scene.scan(HERE), bearing_rad, range_m, HALF_WIDTH_M)
    x_m, y_m = range_m * math.cos(bearing_rad), range_m * math.sin(bearing_rad)
    on_x_m, on_y_m = end[1] * math.cos(end[0]) - x_m, end[1] * math.sin(end[0]) - y_m
    there = Pose(0.0, x_m, y_m, 1.5, math.atan2(on_y_m, on_x_m))
    assert corridor_is_free(scene.scan(there), 0.0, math.hypot(on_x_m, on_y_m), HALF_WIDTH_M - 0.05)
    assert x_m + on_x_m > 4.0, "it is through"


def test_the_shorter_way_round_is_taken() -> None:
    """A post stands in the straight, nearer to its right: it is passed on the left."""
    scan = Scene(box(-5.0, -4.0, 20.0, 4.0), box(3.0, -0.4, 3.2, 0.2)).scan(HERE, CAMERA_RAD)
    found = dogleg(scan, 0.0, TO_GO_M, HALF_WIDTH_M)
    assert found is not None
    assert found[0][0] > 0.0


@pytest.mark.parametrize("width_m", [0.0, 1.6])
def test_where_nothing_leads_through_there_is_no_point(width_m: float) -> None:
    """Protects from a gap that the body would touch."""
    assert dogleg(gap(width_m, 0.3).scan(HERE, CAMERA_RAD), 0.0, TO_GO_M, HALF_WIDTH_M) is None


def test_a_target_that_is_near_has_no_room_for_one() -> None:
    assert dogleg(gap(1.9, 0.6).scan(HERE, CAMERA_RAD), 0.0, 0.3, HALF_WIDTH_M) is None
