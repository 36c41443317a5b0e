"""The scan memory: what was seen a moment ago is still there, and what is gone is forgotten."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from companion.model import CLEAR, HIT, UNKNOWN, Pose, Scan, wrap_rad
from companion.perception.look import bin_bearings
from companion.perception.scan_memory import CELL_M, CELLS, SEEN_THROUGH_M, SEEN_THROUGH_PER_M, ScanMemory

BINS = 360
BEARINGS = bin_bearings(BINS)
HALF_BIN_RAD = math.pi / BINS
MAX_AGE_S = 60.0
MAX_DISTANCE_M = 5.0
HALF_HEIGHT_M = 0.25
ROUNDING = 1e-9
"""Sums of a few doubles of up to a thousand."""

Segment = tuple[float, float, float, float]
"""A straight piece of wall: x, y of both ends, in m."""

places = st.floats(-1000.0, 1000.0)
angles = st.floats(-math.pi, math.pi, exclude_max=True)


def memory() -> ScanMemory:
    return ScanMemory(MAX_AGE_S, MAX_DISTANCE_M, HALF_HEIGHT_M)


def at(x_m: float, y_m: float, yaw_rad: float = 0.0) -> Pose:
    return Pose(0.0, x_m, y_m, 1.5, yaw_rad)


def nothing_known() -> Scan:
    return Scan(BEARINGS, np.zeros(BINS), np.full(BINS, UNKNOWN, np.uint8), np.zeros(BINS, np.bool_))


def remember(where: ScanMemory, pose: Pose, bearing_rad: float, range_m: float, t_s: float = 0.0) -> None:
    where.remember(pose, np.array([bearing_rad]), np.array([range_m]), t_s)


def recalled(where: ScanMemory, pose: Pose, t_s: float = 0.0) -> Scan:
    scan = nothing_known()
    where.recall(scan, pose, t_s)
    return scan


def looked(walls: list[Segment], pose: Pose, half_view_rad: float) -> Scan:
    """A perfect fresh scan of walls in a plane: the nearest of nine rays in each bin within the view, else UNKNOWN."""
    scan = nothing_known()
    spread = np.linspace(-HALF_BIN_RAD, HALF_BIN_RAD, 9)
    nearest = np.full(BINS, np.inf)
    for x1, y1, x2, y2 in walls:
        for off in spread:
            way = np.stack([np.cos(pose.yaw_rad + BEARINGS + off), np.sin(pose.yaw_rad + BEARINGS + off)])
            along = np.array([x2 - x1, y2 - y1])
            start = np.array([x1 - pose.x_m, y1 - pose.y_m])
            cross = way[0] * along[1] - way[1] * along[0]
            with np.errstate(divide="ignore", invalid="ignore"):
                distance = (start[0] * along[1] - start[1] * along[0]) / cross
                share = (start[0] * way[1] - start[1] * way[0]) / cross
            met = (distance > 0.0) & (share >= 0.0) & (share <= 1.0)
            nearest = np.where(met, np.minimum(nearest, distance), nearest)
    view = np.abs(BEARINGS) <= half_view_rad
    hit = view & (nearest < 10.0)
    scan.state[view], scan.ranges_m[view], scan.fresh[view] = CLEAR, 10.0, True
    scan.state[hit], scan.ranges_m[hit] = HIT, nearest[hit]
    return scan


def fly(where: ScanMemory, walls: list[Segment], poses: list[Pose], half_view_rad: float) -> list[Scan]:
    """What is known at each pose: a fresh look ahead, remembered as far as the memory goes, and what is recalled."""
    scans = []
    for i, pose in enumerate(poses):
        t_s = 0.2 * i
        scan = looked(walls, pose, half_view_rad)
        hit = scan.state == HIT
        where.remember(pose, BEARINGS[hit], scan.ranges_m[hit], t_s)
        where.recall(scan, pose, t_s)
        scans.append(scan)
    return scans


@given(
    x_m=places,
    y_m=places,
    yaw_rad=angles,
    bearing_rad=angles,
    range_m=st.floats(0.2, 5.0),
    ahead_m=st.floats(-4.0, 4.0),
    left_m=st.floats(-4.0, 4.0),
    then_yaw_rad=angles,
)
@settings(deadline=None)
def test_a_point_stays_where_it_is_in_the_world(
    x_m: float,
    y_m: float,
    yaw_rad: float,
    bearing_rad: float,
    range_m: float,
    ahead_m: float,
    left_m: float,
    then_yaw_rad: float,
) -> None:
    """Protects the carrying: wherever the vehicle goes and turns, one point is one HIT, at its distance, in its bin.

    Far from the origin and at negative coordinates too, where the grid has wrapped many times.
    """
    there = memory()
    remember(there, at(x_m, y_m, yaw_rad), bearing_rad, range_m)
    point = (x_m + range_m * math.cos(yaw_rad + bearing_rad), y_m + range_m * math.sin(yaw_rad + bearing_rad))
    pose = at(x_m + ahead_m, y_m + left_m, then_yaw_rad)
    distance_m = math.hypot(point[0] - pose.x_m, point[1] - pose.y_m)
    assume(0.1 < distance_m < MAX_DISTANCE_M - ROUNDING)
    scan = recalled(there, pose)
    (hit,) = np.flatnonzero(scan.state == HIT)
    assert scan.ranges_m[hit] == pytest.approx(distance_m, abs=ROUNDING)
    bearing = math.atan2(point[1] - pose.y_m, point[0] - pose.x_m) - pose.yaw_rad
    assert abs(wrap_rad(bearing - BEARINGS[hit])) <= HALF_BIN_RAD + ROUNDING
    assert not scan.fresh[hit]


@pytest.mark.parametrize("turned_rad", [0.3, math.pi / 2.0, -2.0, math.pi])
def test_turning_in_place_turns_all_bearings(turned_rad: float) -> None:
    """Protects the turn on the spot, when nothing else keeps the vehicle from what it does not see."""
    there = memory()
    start = at(-7.3, 2.1, 0.4)
    bearings = np.radians([-120.0, -60.0, 0.0, 45.0, 100.0])
    ranges = np.array([1.0, 2.0, 3.0, 1.5, 4.0])
    there.remember(start, bearings, ranges, 0.0)
    scan = recalled(there, replace(start, yaw_rad=wrap_rad(start.yaw_rad + turned_rad)))
    hit = np.flatnonzero(scan.state == HIT)
    expected = np.array([wrap_rad(bearing - turned_rad) for bearing in bearings])
    order = np.argsort(expected)
    np.testing.assert_allclose(scan.ranges_m[hit], ranges[order], atol=ROUNDING)
    np.testing.assert_allclose(BEARINGS[hit], expected[order], atol=HALF_BIN_RAD + ROUNDING)


def test_a_wall_that_was_passed_is_known_beside_and_behind() -> None:
    """Protects the boundary following between the camera and the side beams: the wall is a curve, not a point.

    One point each 0.1 m is kept, so two neighbours are less than 0.2 m apart: 7.7° at 1.5 m, and less further away.
    """
    walls: list[Segment] = [(-20.0, 1.5, 40.0, 1.5)]
    poses = [at(0.1 * i, 0.0) for i in range(81)]
    scan = fly(memory(), walls, poses, half_view_rad=math.radians(43.0))[-1]
    hits = np.degrees(BEARINGS[scan.state == HIT])
    beside = hits[(hits > 50.0) & (hits < 150.0)]
    assert np.diff(beside).max() <= 9.0  # 7.7°, and each point is somewhere in its bin of 1°
    assert beside.min() <= 59.0
    assert beside.max() >= 141.0
    forgotten_side = np.abs(BEARINGS + math.pi / 2.0) < math.radians(40.0)
    assert (scan.state[forgotten_side] == UNKNOWN).all()
    hit = (scan.state == HIT) & ~scan.fresh
    across = scan.ranges_m[hit] * np.sin(BEARINGS[hit])
    # A point was remembered from the middle of a bin and is recalled in the middle of another: half a bin off, twice.
    np.testing.assert_allclose(across, 1.5, atol=2.0 * MAX_DISTANCE_M * HALF_BIN_RAD)


def test_a_corner_that_is_being_rounded_stays_known() -> None:
    """Protects the turn about a convex corner, which lies between the camera's edge and the side beam all the time.

    The vehicle flies along the lower side of a block and turns about its corner at 1 m. Points near the corner were
    seen in bins of 1° from up to 5 m, 9 cm apart, and the newest of a cell of 0.1 m stands for it: the nearest known
    point is within 0.09 + 0.1·√2 = 0.24 m of the corner, and never nearer than the block by more than half a bin of
    those 5 m.
    """
    corner = (3.0, 1.0)
    walls: list[Segment] = [(-9.0, 1.0, *corner), (*corner, 3.0, 9.0)]
    along = [at(-3.0 + 0.1 * i, 0.0) for i in range(60)]
    turns = np.linspace(0.0, math.pi / 2.0, 20)
    about = [at(corner[0] + math.sin(turn), corner[1] - math.cos(turn), turn) for turn in turns.tolist()]
    scans = fly(memory(), walls, along + about, half_view_rad=math.radians(43.0))
    for scan in scans[len(along) :]:
        nearest_m = float(np.min(scan.ranges_m, where=scan.state == HIT, initial=math.inf))
        assert 1.0 - MAX_DISTANCE_M * HALF_BIN_RAD <= nearest_m <= 1.24


@pytest.mark.parametrize(("age_s", "known"), [(MAX_AGE_S, True), (MAX_AGE_S + 0.01, False)])
def test_a_point_expires_by_age(age_s: float, known: bool) -> None:
    """Protects against drift: the pose of a minute ago is not the pose of now."""
    there = memory()
    remember(there, at(0.0, 0.0), 0.5, 2.0, t_s=100.0)
    assert (recalled(there, at(0.0, 0.0), t_s=100.0 + age_s).state == HIT).any() == known


def test_a_point_seen_again_is_young_again() -> None:
    """Protects a wall beside which the vehicle hovers for minutes."""
    there = memory()
    remember(there, at(0.0, 0.0), 0.5, 2.0, t_s=0.0)
    remember(there, at(0.0, 0.0), 0.5, 2.0, t_s=50.0)
    assert (recalled(there, at(0.0, 0.0), t_s=100.0).state == HIT).any()


def test_a_point_left_behind_is_forgotten_and_does_not_come_back() -> None:
    """Protects the grid, which wraps: what is out of reach must leave its cell for ever."""
    there = memory()
    remember(there, at(0.0, 0.0), 0.0, 2.0)
    assert not (recalled(there, at(-3.1, 0.0)).state == HIT).any()
    assert not (recalled(there, at(0.0, 0.0)).state == HIT).any()


@pytest.mark.parametrize("away", [(1, 0), (0, 1), (-1, 0), (2, -1)])
def test_one_turn_of_the_grid_away_nothing_is_mistaken_for_the_old_place(away: tuple[int, int]) -> None:
    """Protects the wrap: 12.8 m further the same cells are in use, and the old points are not there."""
    there = memory()
    for bearing_rad in np.linspace(-3.0, 3.0, 50).tolist():
        remember(there, at(-0.05, -0.05), bearing_rad, 2.0)
    far = at(-0.05 + away[0] * CELLS * CELL_M, -0.05 + away[1] * CELLS * CELL_M)
    assert not (recalled(there, far).state == HIT).any()
    remember(there, far, 0.1, 3.0)
    scan = recalled(there, far)
    assert scan.ranges_m[scan.state == HIT] == pytest.approx([3.0], abs=ROUNDING)


@pytest.mark.parametrize(("longest_m", "range_m", "known"), [(5.0, 4.9, True), (5.0, 5.1, False), (100.0, 6.5, False)])
def test_only_what_is_near_enough_is_remembered(longest_m: float, range_m: float, known: bool) -> None:
    """Protects the grid from points that would be taken for ones on its other side: half of it is the most."""
    there = ScanMemory(MAX_AGE_S, longest_m, HALF_HEIGHT_M)
    remember(there, at(0.0, 0.0), 0.5, range_m)
    assert (recalled(there, at(0.0, 0.0)).state == HIT).any() == known


def test_without_age_nothing_is_remembered() -> None:
    """Protects the setting memory_age_s = 0, even for the tick of the look itself."""
    there = ScanMemory(0.0, MAX_DISTANCE_M, HALF_HEIGHT_M)
    remember(there, at(0.0, 0.0), 0.5, 2.0)
    scan = recalled(there, at(0.0, 0.0))
    assert (scan.state == UNKNOWN).all()
    assert (scan.ranges_m == 0.0).all()


def fresh(bearing_rad: float, state: np.uint8, range_m: float) -> Scan:
    """A look at that bearing and the two beside it."""
    scan = nothing_known()
    b = int((bearing_rad + math.pi) / (2.0 * math.pi) * BINS)
    near = slice(b - 1, b + 2)
    scan.state[near], scan.ranges_m[near], scan.fresh[near] = state, range_m, True
    return scan


@pytest.mark.parametrize(
    ("state", "range_m", "kept"),
    [
        (CLEAR, 10.0, False),
        (HIT, 4.0, False),
        (HIT, 2.0, True),
        (HIT, 1.0, True),
        (UNKNOWN, 0.0, True),
    ],
)
def test_a_look_that_sees_through_a_point_forgets_it(state: np.uint8, range_m: float, kept: bool) -> None:
    """Protects against ghosts: what has gone, or never was, must not stay a minute; the dark proves nothing."""
    there = memory()
    remember(there, at(0.0, 0.0), 0.5, 2.0)
    scan = fresh(0.5, state, range_m)
    there.recall(scan, at(0.0, 0.0), 0.0)
    assert (recalled(there, at(0.0, 0.0)).state == HIT).any() == kept


@pytest.mark.parametrize("beside", [-1, 0, 1])
@pytest.mark.parametrize("dark", [True, False])
def test_a_thin_pillar_is_not_forgotten_for_a_look_past_it(beside: int, dark: bool) -> None:
    """Its pose is known to a fraction of a degree: what fell into one bearing is seen in the next one then.

    A flight along an uneven wall forgot a thin rib that it had seen a second before, and flew into it.
    """
    there = memory()
    remember(there, at(0.0, 0.0), 0.5, 2.0)
    scan = fresh(0.5, CLEAR, 10.0)
    b = int((0.5 + math.pi) / (2.0 * math.pi) * BINS) + beside
    scan.state[b], scan.ranges_m[b] = (UNKNOWN, 0.0) if dark else (HIT, 2.0)
    there.recall(scan, at(0.0, 0.0), 0.0)
    assert np.min(scan.ranges_m[scan.state == HIT]) == pytest.approx(2.0)
    assert (recalled(there, at(0.0, 0.0)).state == HIT).any()


@pytest.mark.parametrize("range_m", [1.0, 3.0, 4.5])
def test_noise_alone_does_not_forget_a_wall(range_m: float) -> None:
    """Protects walls against the noise of the next look, up to the bound that the module states and no further."""
    bound_m = SEEN_THROUGH_M + SEEN_THROUGH_PER_M * range_m**2
    for nearer_m, kept in ((0.9 * bound_m, True), (1.1 * bound_m, False)):
        there = memory()
        remember(there, at(0.0, 0.0), 0.5, range_m - nearer_m)
        there.recall(fresh(0.5, HIT, range_m), at(0.0, 0.0), 0.0)
        assert (recalled(there, at(0.0, 0.0)).state == HIT).any() == kept


@pytest.mark.parametrize(("state", "range_m"), [(HIT, 3.0), (HIT, 1.0), (CLEAR, 10.0)])
def test_what_is_seen_now_counts_more_than_what_is_remembered(state: np.uint8, range_m: float) -> None:
    """Protects the fresh look: memory only fills what nobody sees."""
    there = memory()
    remember(there, at(0.0, 0.0), 0.5, 2.0)
    scan = fresh(0.5, state, range_m)
    before = (scan.state.copy(), scan.ranges_m.copy(), scan.fresh.copy())
    there.recall(scan, at(0.0, 0.0), 0.0)
    for now, then in zip((scan.state, scan.ranges_m, scan.fresh), before, strict=True):
        np.testing.assert_array_equal(now, then)


def test_a_bearing_in_the_dark_is_filled_and_marked_as_remembered() -> None:
    """Protects black rock that was visible a moment ago, and the tangent rule, which wants fresh edges only."""
    there = memory()
    remember(there, at(0.0, 0.0), 0.5, 2.0)
    scan = fresh(0.5, UNKNOWN, 0.0)
    there.recall(scan, at(0.0, 0.0), 0.0)
    (hit,) = np.flatnonzero(scan.state == HIT)
    assert scan.ranges_m[hit] == pytest.approx(2.0)
    assert not scan.fresh[hit]


def test_of_several_points_at_one_bearing_the_nearest_counts() -> None:
    """Protects d: a pillar before a wall."""
    for order in ((2.0, 3.0), (3.0, 2.0)):
        there = memory()
        for range_m in order:
            remember(there, at(0.0, 0.0), 0.5, range_m)
        scan = recalled(there, at(0.0, 0.0))
        assert scan.ranges_m[scan.state == HIT] == pytest.approx([2.0])


def points(scan: Scan) -> NDArray[np.float64]:
    hit = scan.state == HIT
    return np.column_stack([scan.ranges_m[hit], BEARINGS[hit]])


def test_of_several_points_in_one_cell_the_newest_counts() -> None:
    """Protects the bounded memory: a cell holds one point, and it is not the oldest."""
    there = memory()
    bearing_rad = BEARINGS[200]
    # Both in the cell from 1.0 to 1.1 m to either side, seen from its own corner.
    corner = at(1.0, 1.0)
    for distance_m in (0.02, 0.08):
        remember(there, at(1.0 + distance_m, 1.05), 0.0, 0.0)
    scan = recalled(there, replace(corner, yaw_rad=-bearing_rad))
    assert len(points(scan)) == 1
    assert points(scan)[0, 0] == pytest.approx(math.hypot(0.08, 0.05))
