"""The plan grid that tells the way to unseen ground: it only weighs a choice, but it has to weigh it right."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.config.sensors import CameraSettings
from companion.control.known_ground import (
    CELL_M,
    FIRST_CELLS,
    MOST_CELLS,
    SEEN_FROM_M,
    KnownGround,
    WallFollowing,
)
from companion.model import Pose
from tests.control.scene import Scene
from tests.control.stages import compiled, random_scan

EAST, WEST = 0.0, math.pi

DRIFT = Scene([(-12.0, -2.0), (40.0, -2.0), (40.0, 2.0), (-12.0, 2.0)])
"""A drift 4 m wide along the x axis: a dead end in the west, and the east far beyond what is looked at."""


def at(x_m: float, y_m: float = 0.0) -> Pose:
    """A pose there, heading east."""
    return Pose(0.0, x_m, y_m, 1.5, 0.0)


def seen_along(scene: Scene, from_x_m: float, to_x_m: float) -> KnownGround:
    """What is known after a flight along the x axis that looked all round, four times a metre."""
    ground = KnownGround()
    for x_m in np.arange(from_x_m, to_x_m + 0.01, 0.25):
        ground.see(scene.scan(at(float(x_m))), at(float(x_m)))
    return ground


def way_m(ground: KnownGround, x_m: float, y_m: float, direction_rad: float, gamma: int) -> float:
    """The way to unseen ground when a wall is followed from a point on."""
    (way,) = ground.way_to_unseen_m((x_m, y_m), (WallFollowing(x_m, y_m, direction_rad, gamma),))
    return way


def test_nothing_is_known_before_the_first_look() -> None:
    """No preference without knowledge: all ways are alike, and the choice falls back to p."""
    starts = (WallFollowing(3.0, 0.0, 0.0, 1), WallFollowing(9.0, 0.0, 0.0, -1))
    assert len(set(KnownGround().way_to_unseen_m((0.0, 0.0), starts))) == 1


@pytest.mark.parametrize(("x_m", "y_m"), [(30.0, 0.0), (20.0, 25.0), (-3.0, -40.0)])
def test_unseen_ground_is_where_one_stands_in_it(x_m: float, y_m: float) -> None:
    """A way that begins in unseen ground ends there: what remains is the flight to its beginning, along the axes."""
    ground = seen_along(DRIFT, 0.0, 0.0)
    assert way_m(ground, x_m, y_m, EAST, 1) == 0.0
    assert ground.way_to_unseen_m((0.0, 0.0), (WallFollowing(x_m, y_m, EAST, 1),)) == [abs(x_m) + abs(y_m)]


@pytest.mark.parametrize("gamma", [-1, 1])
def test_a_seen_dead_end_is_further_than_an_open_drift(gamma: int) -> None:
    """West was seen to its end, east was not: following either wall east is the shorter way to something new."""
    ground = seen_along(DRIFT, -10.0, 0.0)
    east, west = way_m(ground, 0.0, 0.0, EAST, gamma), way_m(ground, 0.0, 0.0, WEST, gamma)
    # Seen is at most 5 m ahead; the dead end is 12 m away, and the way back is as long.
    assert east <= 5.0 + 2.0 * CELL_M
    assert west >= 12.0
    assert east < west


#    ---------------------+         branch on the right: who follows the right wall turns into it,
#      >     x            |         who follows the left one first sees the dead end again
#    --------+     +------+
#            |  ?  |                and mirrored
@pytest.mark.parametrize("side", [-1, 1])
def test_the_wall_on_the_side_of_an_unseen_branch_leads_there_sooner(side: int) -> None:
    """Γ in the grid is Γ in the world: the hand on the wall turns into the branch on that hand."""
    corners = [
        (-12.0, 2.0),
        (-12.0, -2.0),
        (-2.0, -2.0),
        (-2.0, -25.0),
        (2.0, -25.0),
        (2.0, -2.0),
        (10.0, -2.0),
        (10.0, 2.0),
    ]
    scene = Scene([(x, -side * y) for x, y in corners])
    ground = seen_along(scene, -11.0, 9.0)
    into, past = way_m(ground, -6.0, 0.0, EAST, side), way_m(ground, -6.0, 0.0, EAST, -side)
    assert into < past
    # 6 m to the branch, 2 m to its mouth, 5 m of it seen, counted along the grid's axes: half as much again.
    assert into <= 1.5 * (6.0 + 2.0 + 5.0)


def test_looking_again_changes_nothing() -> None:
    """The same place seen twice is known as well as once: no wall wears off, no ground is forgotten."""
    once = seen_along(DRIFT, -10.0, 0.0)
    twice = seen_along(DRIFT, -10.0, 0.0)
    for x_m in np.arange(-10.0, 0.01, 0.25):
        twice.see(DRIFT.scan(at(float(x_m))), at(float(x_m)))
    np.testing.assert_array_equal(once._cells, twice._cells)


@pytest.mark.parametrize(("x_m", "y_m"), [(70.0, 0.0), (-70.0, 0.0), (0.0, 70.0), (0.0, -70.0), (300.0, 300.0)])
def test_the_grid_grows_and_keeps_what_it_knows(x_m: float, y_m: float) -> None:
    """Flying off the first 128 m doubles the grid; what was known is known at the same place."""
    ground = seen_along(DRIFT, -10.0, 0.0)
    before = [way_m(ground, 0.0, 0.0, direction, gamma) for direction in (EAST, WEST) for gamma in (-1, 1)]
    known = np.count_nonzero(ground._cells)
    # A look into nothing, far from the drift.
    ground.see(Scene().scan(at(x_m, y_m)), at(x_m, y_m))
    assert len(ground._cells) > FIRST_CELLS
    assert np.count_nonzero(ground._cells) > known
    after = [way_m(ground, 0.0, 0.0, direction, gamma) for direction in (EAST, WEST) for gamma in (-1, 1)]
    assert after == before


@pytest.mark.parametrize("far_m", [3000.0, 1e6, 1e12])
def test_places_outside_of_the_largest_grid_do_no_harm(far_m: float) -> None:
    """A pose that has run away costs the preference there, not the flight, and not what is known nearer by."""
    ground = seen_along(DRIFT, -10.0, 0.0)
    before = way_m(ground, 0.0, 0.0, EAST, 1)
    for x_m, y_m in ((far_m, 0.0), (-far_m, far_m), (0.0, -far_m)):
        ground.see(Scene().scan(at(x_m, y_m)), at(x_m, y_m))
        assert way_m(ground, x_m, y_m, EAST, 1) >= 0.0
        (way,) = ground.way_to_unseen_m((0.0, 0.0), (WallFollowing(x_m, y_m, EAST, 1),))
        assert way >= far_m
    assert len(ground._cells) <= MOST_CELLS
    assert way_m(ground, 0.0, 0.0, EAST, 1) == before


@compiled
@given(
    seed=st.integers(0, 2**32 - 1),
    x_m=st.floats(-100.0, 100.0),
    y_m=st.floats(-100.0, 100.0),
    direction_rad=st.floats(-10.0, 10.0),
    gamma=st.sampled_from([-1, 1]),
)
def test_a_way_is_never_shorter_than_the_flight_to_its_beginning(
    seed: int, x_m: float, y_m: float, direction_rad: float, gamma: int
) -> None:
    """Whatever was seen, from wherever and in any direction: a length or inf, never NaN, never negative."""
    rng = np.random.default_rng(seed)
    ground = KnownGround()
    for _ in range(3):
        x, y, yaw = rng.uniform(-10.0, 10.0, 3)
        ground.see(random_scan(rng), Pose(0.0, float(x), float(y), 1.5, float(yaw)))
    (way,) = ground.way_to_unseen_m((0.0, 0.0), (WallFollowing(x_m, y_m, direction_rad, gamma),))
    assert way >= abs(x_m) + abs(y_m)


def test_ground_is_seen_from_where_the_camera_sees_floor_and_roof() -> None:
    """Protects the corners: what is nearer is in no picture, and was looked for by laps when it counted as seen."""
    camera = CameraSettings()
    assert camera.sees_from_m(1.5) == pytest.approx(SEEN_FROM_M, abs=0.01)
    assert CameraSettings(mount_pitch_deg=10.0).sees_from_m(1.5) > 4.0, "the roof is seen from further off"
    assert CameraSettings(mount_pitch_deg=30.0).sees_from_m(1.5) == math.inf
    near, far = KnownGround(1.0), KnownGround(3.0)
    for ground in (near, far):
        ground.see(DRIFT.scan(at(0.0)), at(0.0))
    place = WallFollowing(2.25, 0.0, EAST, 1)
    assert far.way_to_unseen_m((2.25, 0.0), (place,)) == [0.0]
    assert near.way_to_unseen_m((2.25, 0.0), (place,)) > [0.0]
