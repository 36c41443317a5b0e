"""What is known of the plan, and by levels: it only weighs a choice, but it has to weigh it right."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.config.sensors import CameraSettings
from companion.control.ground_grid import FREE, GIVEN_UP, LEVEL_DM, WALL, GroundGrid, level_at
from companion.control.informed import WallFollowing, find_ways
from companion.control.known_ground import (
    CELL_M,
    FIRST_CELLS,
    MOST_CELLS,
    NOWHERE,
    UPRIGHT_57_DEG,
    KnownGround,
    Outlook,
    Place,
    Window,
)
from companion.model import Measurement, Pose
from tests.control.scene import Scene, measurement
from tests.control.stages import compiled, random_scan

EAST, WEST = 0.0, math.pi

DRIFT = Scene([(-12.0, -2.0), (40.0, -2.0), (40.0, 2.0), (-12.0, 2.0)])
"""A drift 4 m wide along the x axis: a dead end in the west, and the east far beyond what is looked at."""

H_M = 1.5

ALL_ROUND = UPRIGHT_57_DEG._replace(half_width_rad=math.pi)
"""As if it turned once round at each place; floor and roof come into the picture as early everywhere."""


def at(x_m: float, y_m: float = 0.0, ground_m: float = 0.0) -> Pose:
    """A pose above a place, heading east."""
    return Pose(0.0, x_m, y_m, ground_m + H_M, 0.0)


def look(ground: KnownGround, scene: Scene, pose: Pose, slope: float = 0.0) -> None:
    ground.see(replace(scene.measure(pose, h_m=H_M), ground_slope=slope), pose)


def seen_along(scene: Scene, from_x_m: float, to_x_m: float, ground: KnownGround | None = None) -> KnownGround:
    """What is known after a flight along the x axis that looked all round, four times a metre."""
    ground = KnownGround(ALL_ROUND) if ground is None else ground
    # Walls lie in the middle of cells, not at the edge between two.
    for x_m in np.arange(from_x_m + 0.2, to_x_m + 0.21, 0.25):
        look(ground, scene, at(float(x_m), 0.2))
    return ground


def way_m(ground: KnownGround, place: Place, direction_rad: float, gamma: int) -> float:
    """The way to unseen ground when a wall is followed from a place on."""
    ways = find_ways(ground, place)
    assert ways is not None
    return ways.along_m(WallFollowing(place, direction_rad, gamma))


START = Place(0.0, 0.0, 0.0)


def test_nothing_is_known_before_the_first_look() -> None:
    """No preference without knowledge: the choice falls back to p."""
    assert find_ways(KnownGround(), START) is None
    blind = KnownGround()
    blind.see(measurement(None), at(0.0))
    assert find_ways(blind, START) is None


@pytest.mark.parametrize(("x_m", "y_m"), [(30.0, 0.0), (20.0, 25.0), (-3.0, -40.0)])
def test_unseen_ground_is_where_one_stands_in_it(x_m: float, y_m: float) -> None:
    """A way that begins in unseen ground ends there."""
    assert way_m(seen_along(DRIFT, 0.0, 0.0), Place(x_m, y_m, 0.0), EAST, 1) == 0.0


@pytest.mark.parametrize("gamma", [-1, 1])
def test_a_seen_dead_end_is_further_than_an_open_drift(gamma: int) -> None:
    """West was seen to its end, east was not: following either wall east is the shorter way to something new."""
    ground = seen_along(DRIFT, -10.0, 0.0)
    east, west = way_m(ground, START, EAST, gamma), way_m(ground, START, WEST, gamma)
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
    here = Place(-6.0, 0.0, 0.0)
    into, past = way_m(ground, here, EAST, side), way_m(ground, here, EAST, -side)
    assert into < past
    # 6 m to the branch, 2 m to its mouth, 5 m of it seen, counted along the grid's axes: half as much again.
    assert into <= 1.6 * (6.0 + 2.0 + 5.0)


def test_looking_again_changes_nothing() -> None:
    """The same place seen twice is known as well as once: no wall wears off, no ground is forgotten."""
    once = seen_along(DRIFT, -10.0, 0.0)
    twice = seen_along(DRIFT, -10.0, 0.0, seen_along(DRIFT, -10.0, 0.0))
    np.testing.assert_array_equal(once._grid.cells, twice._grid.cells)


@pytest.mark.parametrize(("x_m", "y_m"), [(70.0, 0.0), (-70.0, 0.0), (0.0, 70.0), (0.0, -70.0), (300.0, 300.0)])
def test_the_grid_grows_and_keeps_what_it_knows(x_m: float, y_m: float) -> None:
    """Flying off the first 128 m doubles the grid; what was known is known at the same place."""
    ground = seen_along(DRIFT, -10.0, 0.0)
    before = [way_m(ground, START, direction, gamma) for direction in (EAST, WEST) for gamma in (-1, 1)]
    known = np.count_nonzero(ground._grid.cells)
    # A look into nothing, far from the drift.
    look(ground, Scene(), at(x_m, y_m))
    assert ground._grid.cells.shape[1] > FIRST_CELLS
    assert np.count_nonzero(ground._grid.cells) > known
    after = [way_m(ground, START, direction, gamma) for direction in (EAST, WEST) for gamma in (-1, 1)]
    assert after == before


@pytest.mark.parametrize("far_m", [3000.0, 1e6, 1e12])
def test_places_outside_of_the_largest_grid_do_no_harm(far_m: float) -> None:
    """A pose that has run away costs the preference there, not the flight, and not what is known nearer by."""
    ground = seen_along(DRIFT, -10.0, 0.0)
    before = way_m(ground, START, EAST, 1)
    for x_m, y_m in ((far_m, 0.0), (-far_m, far_m), (0.0, -far_m)):
        look(ground, Scene(), at(x_m, y_m, ground_m=far_m))
        assert way_m(ground, Place(x_m, y_m, far_m), EAST, 1) >= 0.0
    assert ground._grid.cells.shape[1] <= MOST_CELLS
    assert way_m(ground, START, EAST, 1) == before


@compiled
@given(
    seed=st.integers(0, 2**32 - 1),
    place=st.builds(Place, st.floats(-100.0, 100.0), st.floats(-100.0, 100.0), st.floats(-20.0, 20.0)),
    direction_rad=st.floats(-10.0, 10.0),
    gamma=st.sampled_from([-1, 1]),
)
def test_a_way_has_a_length_whatever_was_seen(seed: int, place: Place, direction_rad: float, gamma: int) -> None:
    """From wherever, in any direction, with grounds of any height above each other: a length or inf, never NaN."""
    rng = np.random.default_rng(seed)
    ground = KnownGround()
    for _ in range(6):
        x, y, z, yaw = (float(number) for number in rng.uniform(-10.0, 10.0, 4))
        seen = replace(measurement(random_scan(rng)), h_m=H_M, ground_slope=float(rng.uniform(-0.4, 0.4)))
        ground.see(seen, Pose(0.0, x, y, z, yaw))
    assert way_m(ground, place, direction_rad, gamma) >= 0.0
    ways = find_ways(ground, place)
    assert ways is not None
    way = ways.way(place, direction_rad, 0.5)
    assert way is None or 0.0 <= way.length_m < math.inf


class TestOutlook:
    """Ground counts as seen from where the camera sees its floor and its roof."""

    def test_what_is_nearer_is_in_no_picture(self) -> None:
        """Protects the corners that are only passed: they were looked for by laps when they counted as seen."""
        assert UPRIGHT_57_DEG.seen_m(1.5, 1.5) == pytest.approx((2.76, 5.0), abs=0.01)
        level, tilted = (CameraSettings(mount_pitch_deg=pitch) for pitch in (0.0, 10.0))
        assert Outlook.of(*level.elevations_rad(), *level.bearings_rad(), 6.0) == pytest.approx(UPRIGHT_57_DEG)
        assert Outlook.of(*tilted.elevations_rad(), *tilted.bearings_rad(), 6.0).seen_m(1.5, 1.5)[0] > 4.0, (
            "the roof is seen from further off"
        )

    def test_a_high_roof_is_seen_from_further_away(self) -> None:
        """Protects the roof over a corner: 2.1 m above the vehicle it comes into the picture at 3.9 m."""
        near, far = KnownGround(), KnownGround()
        for ground, roof_m in ((near, 1.5), (far, 2.1)):
            ground.see(replace(DRIFT.measure(at(0.0)), roof_m=roof_m), at(0.0))
        place = Place(3.25, 0.0, 0.0)
        assert way_m(near, place, EAST, 1) > 0.0
        assert way_m(far, place, EAST, 1) == 0.0

    def test_what_never_comes_into_the_picture_holds_nobody_up(self) -> None:
        """Protects from a mine of which nothing ever counts as seen: a hall, or a camera that looks down."""
        assert UPRIGHT_57_DEG.seen_m(1.5, 30.0) == pytest.approx((3.7, 4.2))
        from_m, to_m = Outlook.of(-1.0, -0.1, -0.7, 0.7, 6.0).seen_m(1.5, 1.5)
        assert from_m == to_m - 0.5

    def test_aside_it_comes_into_the_picture_further_away(self) -> None:
        """Protects the corners once more: the picture is flat, and at its edge lower; beyond it nothing is."""
        hall = Scene([(-20.0, -20.0), (20.0, -20.0), (20.0, 20.0), (-20.0, 20.0)])
        ground = KnownGround()
        look(ground, hall, at(0.0))

        def is_seen(distance_m: float, bearing_deg: float) -> bool:
            bearing_rad = math.radians(bearing_deg)
            window = ground.window(0.0, 0.0)
            assert window is not None
            row, column = window.cell(
                Place(distance_m * math.cos(bearing_rad), distance_m * math.sin(bearing_rad), 0.0)
            )
            return level_at(window.grid, row, column, 0) >= 0

        assert is_seen(3.25, 2.0)
        assert not is_seen(3.0, 40.0)
        assert is_seen(4.5, 40.0)
        assert not is_seen(4.5, 60.0)

    @pytest.mark.parametrize("camera", [CameraSettings(vertical_fov_deg=74.0), CameraSettings(height_px=90)])
    def test_as_far_as_floor_counts_as_seen_the_rows_of_the_picture_are_close(self, camera: CameraSettings) -> None:
        """Protects the map from holes: a wide picture of few rows meets the floor 5 m ahead a quarter of a metre apart.

        In a tunnel that a vehicle with such a camera flew through, it had nothing left to look for with 97 % of it.
        """
        model, h_m, apart_m = camera.model(), 1.2, 0.15
        outlook = Outlook.of(*camera.elevations_rad(), *camera.bearings_rad(), 5.0, apart_m * model.fy_px)
        _, to_m = outlook.seen_m(h_m, h_m)
        rows_m = model.fy_px * h_m / (np.arange(int(model.cy_px) + 1, model.height_px) - model.cy_px)
        seen_m = rows_m[rows_m <= to_m]
        assert np.abs(np.diff(seen_m)).max() <= apart_m
        assert to_m >= 0.7 * 5.0

    @given(
        h_m=st.floats(0.0, 1e4),
        roof_m=st.floats(0.0, 1e4),
        reach_m=st.floats(0.5, 30.0),
        dense_m=st.floats(0.0, math.inf),
    )
    def test_there_is_always_something_to_see(self, h_m: float, roof_m: float, reach_m: float, dense_m: float) -> None:
        """Whatever the heights: from nearer to further, and no further than the map believes."""
        from_m, to_m = Outlook.of(-0.5, 0.4, -0.7, 0.7, reach_m, dense_m).seen_m(h_m, roof_m)
        assert 0.0 <= from_m < to_m <= reach_m


class TestLevels:
    """A mine has ramps: what lies above each other is not one place."""

    def test_a_drift_below_another_is_unseen_until_it_is_seen(self) -> None:
        """Protects from leaving out the lower level: one cell for both counted it as known."""
        ground = seen_along(DRIFT, -10.0, 0.0)
        below = Place(0.0, 0.0, -6.0)
        assert way_m(ground, below, EAST, 1) == 0.0
        look(ground, DRIFT, at(0.0, ground_m=-6.0))
        look(ground, DRIFT, at(0.0, ground_m=-6.0))
        assert len(ground._grid.cells) == 2, "with the second look there is a level for it"
        assert way_m(ground, Place(4.0, 0.0, -6.0), WEST, 1) > 0.0
        assert way_m(ground, START, WEST, 1) == way_m(seen_along(DRIFT, -10.0, 0.0), START, WEST, 1)

    def test_its_walls_are_not_those_of_the_one_above(self) -> None:
        """Protects the way: a cross-cut ends at no wall of the level below."""
        ground = seen_along(DRIFT, -10.0, 0.0)
        room = Scene([(-12.0, -12.0), (12.0, -12.0), (12.0, 12.0), (-12.0, 12.0)])
        for _ in range(2):
            for y_m in np.arange(-6.0, 6.1, 0.5):
                look(ground, room, at(0.0, float(y_m), ground_m=-6.0))
        window = ground.window(0.0, 0.0)
        assert window is not None
        row, column = window.cell(Place(-2.75, 2.0, 0.0))
        upper, lower = (level_at(window.grid, row, column, ground_dm) for ground_dm in (0, -60))
        assert window.grid.cells[upper, row, column] == WALL
        assert window.grid.cells[lower, row, column] == FREE

    def test_a_ramp_is_one_way_from_level_to_level(self) -> None:
        """Protects from cutting a ramp: 15 % down over 40 m and the unseen at its end is reached over known ground."""
        ramp = Scene([(-12.0, -2.0), (60.0, -2.0), (60.0, 2.0), (-12.0, 2.0)])
        ground = KnownGround(ALL_ROUND)
        for x_m in np.arange(-10.0, 40.0, 0.25):
            look(ground, ramp, at(float(x_m), ground_m=-0.15 * float(x_m)), slope=-0.15)
        ways = find_ways(ground, Place(-8.0, 0.0, 1.2))
        assert ways is not None
        way = ways.way(Place(-8.0, 0.0, 1.2), EAST, 0.5)
        assert way is not None
        assert way.goal.x_m == pytest.approx(44.5, abs=1.0)
        assert way.goal.ground_m == pytest.approx(-0.15 * way.goal.x_m, abs=0.5)
        assert len(ground._grid.cells) == 1

    def test_noise_of_the_height_makes_no_level(self) -> None:
        """Protects from a second ground where the estimate of the height wanders, by a metre."""
        ground = KnownGround()
        rng = np.random.default_rng(1)
        for _ in range(200):
            look(ground, DRIFT, at(float(rng.uniform(-8.0, 8.0)), ground_m=float(rng.uniform(-0.5, 0.5))))
        assert len(ground._grid.cells) == 1
        assert LEVEL_DM >= 10

    def test_what_is_given_up_on_one_level_stays_to_be_seen_on_the_other(self) -> None:
        """A place is given up at its own height."""
        ground = seen_along(DRIFT, -10.0, 0.0)
        ground.give_up(Place(4.0, 0.0, 0.0), 3.0)
        assert way_m(ground, Place(6.0, 0.0, 0.0), EAST, 1) > 0.0
        assert way_m(ground, Place(6.0, 0.0, -6.0), EAST, 1) == 0.0

    def test_more_levels_than_there_may_be_do_no_harm(self) -> None:
        """Protects memory: a height that runs away makes no end of levels."""
        ground = KnownGround()
        for k in range(40):
            look(ground, DRIFT, at(0.0, ground_m=3.0 * k))
        assert len(ground._grid.cells) == 8
        assert way_m(ground, Place(4.0, 0.0, 0.0), WEST, 1) > 0.0


class TestWalls:
    """A wall is believed as long as nothing is seen behind it."""

    def bump(self, ground: KnownGround) -> None:
        """One look at a wall across the drift that is none, as a nod shows the roof."""
        look(ground, Scene([(-12.0, -2.0), (4.0, -2.0), (4.0, 2.0), (-12.0, 2.0)]), at(0.0))

    def test_one_that_was_none_goes_away(self) -> None:
        """Protects the far end of a drift: closed by one wrong look, it was never flown into again."""
        ground = KnownGround(ALL_ROUND)
        self.bump(ground)
        assert way_m(ground, Place(3.0, 0.0, 0.0), EAST, 1) > 1.0
        for x_m in np.arange(0.0, 3.0, 0.5):
            look(ground, DRIFT, at(float(x_m)))
        ways = find_ways(ground, Place(3.0, 0.0, 0.0))
        assert ways is not None
        way = ways.way(Place(3.0, 0.0, 0.0), EAST, 0.5)
        assert way is not None
        assert way.goal.x_m > 5.0

    def test_one_that_is_passed_along_stays(self) -> None:
        """Protects the way: rays along a wall pass through its cells, and end in it further on."""
        ground = seen_along(DRIFT, -10.0, 20.0)
        window = ground.window(0.0, 0.0)
        assert window is not None
        for x_m in np.arange(-9.0, 20.0, 0.5):
            for y_m in (-2.01, 2.01):
                row, column = window.cell(Place(float(x_m), y_m, 0.0))
                assert window.grid.cells[0, row, column] == WALL

    def test_small_vehicles_know_the_ground_more_finely(self) -> None:
        """Protects narrow drifts: with cells of 0.5 m a drift 2 m wide has none that is not beside a wall."""
        narrow = Scene([(-12.0, -0.9), (40.0, -0.9), (40.0, 0.9), (-12.0, 0.9)])
        for cell_m, leads_on in ((CELL_M, False), (0.25, True)):
            ground = KnownGround(ALL_ROUND, cell_m)
            for x_m in np.arange(-10.0, 0.01, 0.25):
                look(ground, narrow, at(float(x_m)))
            ways = find_ways(ground, Place(-5.0, 0.0, 0.0))
            assert ways is not None
            assert (ways.way(Place(-5.0, 0.0, 0.0), EAST, 0.5) is not None) is leads_on


def test_a_measurement_without_height_is_entered_at_the_vehicles_own() -> None:
    """Protects from NaN in the grid: law and choice go on where h is not known."""
    ground = KnownGround()
    seen: Measurement = replace(DRIFT.measure(at(0.0)), h_m=None, ground_slope=None)
    ground.see(seen, at(0.0))
    assert way_m(ground, Place(4.0, 0.0, H_M), WEST, 1) > 0.0


# From one sortie to the next.


def going_on(earlier: KnownGround, ground: KnownGround | None = None) -> KnownGround:
    """A flight that goes on from what another one has seen."""
    ground = KnownGround(ALL_ROUND) if ground is None else ground
    ground.go_on_from(earlier.seen())
    return ground


@pytest.mark.parametrize("gamma", [-1, 1])
@pytest.mark.parametrize("direction_rad", [EAST, WEST])
def test_what_an_earlier_flight_saw_counts_as_seen(direction_rad: float, gamma: int) -> None:
    """Before its first look it knows every way that the other one knew, and where the unseen begins."""
    first = seen_along(DRIFT, -10.0, 0.0)
    second = going_on(first)
    for place in (START, Place(-8.0, 0.5, 0.0)):
        assert way_m(second, place, direction_rad, gamma) == way_m(first, place, direction_rad, gamma)
    assert second.seen().free_m2 == first.seen().free_m2 > 0.0


def test_afterwards_it_holds_what_both_have_seen() -> None:
    """As if one had flown all of it, from any place: what is written then is the ground of the next sortie."""
    both = seen_along(DRIFT, 6.0, 12.0, going_on(seen_along(DRIFT, -10.0, 5.75))).seen()
    alone = seen_along(DRIFT, -10.0, 12.0).seen()
    assert (both.x_m, both.y_m) == pytest.approx((alone.x_m, alone.y_m))
    np.testing.assert_array_equal(both.grid.cells, alone.grid.cells)
    np.testing.assert_array_equal(both.grid.ground_dm, alone.grid.ground_dm)


def test_a_wall_that_lies_elsewhere_now_is_soon_forgotten() -> None:
    """Whoever puts the vehicle back by hand is some degrees off: the walls of before would close the drift for ever."""
    first = seen_along(DRIFT, 0.0, 0.0)
    across = Scene([(-12.0, -2.0), (3.4, -2.0), (3.4, 2.0), (-12.0, 2.0)])
    for _ in range(20):
        look(first, across, at(0.2, 0.2))
    second = going_on(first)
    assert find_ways(second, START) is not None
    row, column = second.seen().cell(Place(3.4, 0.2, 0.0))
    assert second.seen().grid.cells[0, row, column] == WALL
    look(second, DRIFT, at(0.2, 0.2))
    row, column = second.seen().cell(Place(3.4, 0.2, 0.0))
    assert second.seen().grid.cells[0, row, column] == FREE


def test_levels_stay_apart_from_one_sortie_to_the_next() -> None:
    """What lies above each other is taken up as that."""
    first = seen_along(DRIFT, 0.0, 2.0)
    for x_m in np.arange(0.2, 2.21, 0.25):
        look(first, DRIFT, at(float(x_m), 0.2, ground_m=8.0))
    second = going_on(first)
    assert second.seen().free_m2 == first.seen().free_m2
    assert second.seen().grid.cells.shape[0] == 2
    row, column = second.seen().cell(Place(4.0, 0.2, 0.0))
    assert {level_at(second.seen().grid, row, column, ground_dm) for ground_dm in (0, 80)} == {0, 1}


def test_what_was_given_up_or_blocked_may_be_tried_again() -> None:
    """A person may have opened a door, and the camera comes from elsewhere."""
    first = seen_along(DRIFT, 0.0, 0.0)
    first.give_up(Place(6.0, 0.0, 0.0), 3.0)
    first.block(Place(3.0, 0.0, 0.0))
    assert GIVEN_UP in first.seen().grid.cells
    assert len(first.seen().blocked) == 1
    second = going_on(first).seen()
    assert GIVEN_UP not in second.grid.cells
    assert len(second.blocked) == 0
    assert second.free_m2 == first.seen().free_m2


def test_nothing_seen_is_nothing_to_go_on_from() -> None:
    """As after a flight with a coin, which notes nothing: it begins anew."""
    assert find_ways(going_on(KnownGround(ALL_ROUND)), START) is None
    assert seen_along(DRIFT, 0.0, 1.0, going_on(KnownGround(ALL_ROUND))).seen().free_m2 > 0.0


@pytest.mark.parametrize(
    ("cell_m", "columns", "why"),
    [(0.3, 4, "its cells are 0.3 m wide, those of this flight 0.5 m"), (CELL_M, MOST_CELLS + 1, "2048 to a side")],
)
def test_ground_of_another_kind_is_not_taken_up(cell_m: float, columns: int, why: str) -> None:
    """It says what is wrong, and has taken up nothing by then."""
    grid = GroundGrid.unseen(2, columns)
    grid.cells[:] = FREE
    ground = KnownGround(ALL_ROUND)
    with pytest.raises(ValueError, match=why):
        ground.go_on_from(Window(grid, NOWHERE, 0.0, 0.0, cell_m))
    assert ground.whole() is None


def test_as_much_as_a_grid_may_hold_is_taken_up() -> None:
    """The largest ground that a flight leaves behind: 1 km of drift."""
    grid = GroundGrid.unseen(3, MOST_CELLS)
    grid.cells[:] = FREE
    ground = KnownGround(ALL_ROUND)
    ground.go_on_from(Window(grid, NOWHERE, -512.0, -0.75, CELL_M))
    known = ground.seen()
    assert (known.x_m, known.y_m, known.grid.cells.shape) == (-512.0, -0.75, (1, 3, MOST_CELLS))
