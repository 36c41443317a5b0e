"""The way over known ground: as short as it is, in the middle of the drift, and none where there is none."""

from __future__ import annotations

import heapq
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from companion.control.ground_grid import FREE, UNSEEN, WALL, GroundGrid
from companion.control.informed import (
    NEAR_STEPS,
    TRACE_CELLS,
    WallFollowing,
    Way,
    Ways,
    _cost,
    _frontier,
    _room,
    _steps,
    find_ways,
)
from companion.control.known_ground import CELL_M, FIRST_CELLS, KnownGround, Place
from tests.control.stages import compiled

EAST, WEST = 0.0, math.pi

#: Rows grow with y: the first line is the north. A drift 3.5 m wide with a branch to the north, seen but for the
#: end of the branch and the end in the east; the west is a dead end.
MINE = """
               #.......#
               #.......#
               #.......#
               #.......#
               #.......#
               #.......#
               #.......#
################.......#################
#......................................
#......................................
#......................................
#......................................
#......................................
#......................................
#......................................
########################################
"""
WEST_END, CROSSING = Place(2.25, 2.25, 0.0), Place(9.75, 2.25, 0.0)
"""In the middle of the drift, x and y in m from the corner in the south-west."""


def level_ground(cells: NDArray[np.uint8]) -> GroundGrid:
    return GroundGrid(cells[np.newaxis], np.zeros((1, *cells.shape), np.int16), np.zeros((1, *cells.shape), np.int8))


def known(plan: str = MINE) -> KnownGround:
    """The ground of a plan: walls, seen cells, and all else unseen."""
    lines = plan.strip("\n").split("\n")[::-1]
    ground = KnownGround()
    ground._origin = (-20.0, -20.0)
    cells = np.full((FIRST_CELLS, FIRST_CELLS), UNSEEN, np.uint8)
    for r, line in enumerate(lines):
        for c, what in enumerate(line):
            cells[r + 40, c + 40] = {"#": WALL, ".": FREE, " ": UNSEEN}[what]
    ground._grid = level_ground(cells)
    return ground


def ways_at(ground: KnownGround, place: Place) -> Ways:
    ways = find_ways(ground, place)
    assert ways is not None
    return ways


def way_at(ground: KnownGround, place: Place, yaw_rad: float = EAST) -> Way:
    way = ways_at(ground, place).way(place, yaw_rad, 0.5)
    assert way is not None
    return way


def test_nothing_is_known_before_the_first_look() -> None:
    """No way without knowledge: the law follows its wall."""
    assert find_ways(KnownGround(), Place(0.0, 0.0, 0.0)) is None


def test_it_leads_to_where_the_unseen_begins_and_first_straight_on() -> None:
    """From the dead end the branch is nearer than the east: along the middle of the drift to the corner, then north."""
    way = way_at(known(), WEST_END)
    assert way.goal.x_m == pytest.approx(9.75, abs=1.5), "in the branch"
    assert way.goal.y_m == pytest.approx(7.75, abs=0.5)
    assert way.length_m == pytest.approx(7.5 + 5.5, abs=1.5)
    # As far as a straight line keeps two cells from every wall.
    assert 5.0 < way.straight.x_m < 10.0
    assert 1.5 < way.straight.y_m < 3.0
    onward = way_at(known(), Place(9.25, 3.0, 0.0), yaw_rad=math.pi / 2.0)
    assert (onward.straight.x_m, onward.straight.y_m) == (onward.goal.x_m, onward.goal.y_m), (
        "from the crossing it is straight"
    )


def test_what_lies_behind_costs_the_turn() -> None:
    """Of two that are as far the one ahead is nearer: the faster a vehicle flies, the more a turn costs it."""
    for turn_m_per_rad in (0.5, 1.5):
        ways = [ways_at(known(), WEST_END).way(WEST_END, yaw_rad, turn_m_per_rad) for yaw_rad in (EAST, WEST)]
        ahead_m, behind_m = (way.length_m for way in ways if way is not None)
        assert behind_m - ahead_m == pytest.approx(turn_m_per_rad * math.pi, rel=0.2)


def test_a_goal_is_one_until_it_has_been_seen() -> None:
    """Protects from flying to the end of a way whose goal is in view already; beyond what was searched it stays."""
    ground = known()
    goal = way_at(ground, WEST_END).goal
    assert ways_at(ground, WEST_END).is_goal(goal)
    ground._grid.cells[0, 56:70, 55:64] = FREE
    assert not ways_at(ground, WEST_END).is_goal(goal)
    assert ways_at(ground, WEST_END).is_goal(Place(1e4, 0.0, 0.0))


def test_a_wall_that_leads_there_is_as_near_and_one_that_does_not_is_further() -> None:
    """Into the branch leads the wall on the left; the one on the right leads past it, to the east."""
    ways = ways_at(known(), CROSSING)
    left_m, right_m = (ways.along_m(WallFollowing(Place(8.25, 2.25, 0.0), EAST, gamma)) for gamma in (1, -1))
    assert left_m < right_m < math.inf
    back_m = ways.along_m(WallFollowing(Place(8.25, 2.25, 0.0), WEST, 1))
    assert back_m > max(left_m, 0.5 * TRACE_CELLS * CELL_M), "round the dead end, and the way from there"


def test_a_mine_that_was_seen_has_no_way() -> None:
    """Protects the end of a flight: it does not fly to and fro before walls."""
    plan = MINE.replace("#.......#\n               #.......#", "#########\n               #.......#", 1)
    closed = "\n".join(line if len(line) < 39 or line.endswith("#") else line[:38] + "#" for line in plan.split("\n"))
    ways = ways_at(known(closed), WEST_END)
    assert ways.way(WEST_END, EAST, 0.5) is None
    assert ways.along_m(WallFollowing(WEST_END, EAST, 1)) == math.inf


def test_a_chink_attracts_nobody_until_nothing_else_is_left() -> None:
    """Protects from flying back for two cells that a beam did not meet; at the end they are looked at."""
    chink = known()
    chink._grid.cells[0, 43, 50:52] = UNSEEN
    assert way_at(chink, WEST_END).goal.y_m > 7.0
    only = known(MINE.replace("#.......#", "#########", 1))
    only._grid.cells[0, 41:48, 78] = WALL
    only._grid.cells[0, 43, 50:52] = UNSEEN
    assert way_at(only, WEST_END).goal.x_m == pytest.approx(5.5, abs=1.0)


def test_where_the_scan_did_not_confirm_a_straight_no_way_leads_any_more() -> None:
    """Protects from trying the same hole for ever; when it is taken up again it may be tried."""
    ground = known()
    for y_m in (0.75, 2.25, 3.75):
        ground.block(Place(6.25, y_m, 0.0))
    assert ways_at(ground, WEST_END).way(WEST_END, EAST, 0.5) is None
    assert way_at(ground, CROSSING).goal.y_m > 7.0, "beyond it there still is one"
    ground.take_up_again()
    assert way_at(ground, WEST_END).goal.y_m > 7.0


def test_what_is_given_up_attracts_nobody_and_comes_back() -> None:
    """Protects from standing before what cannot be seen from there."""
    ground = known()
    goal = way_at(ground, WEST_END)
    ground.give_up(goal.goal, 2.5)
    assert way_at(ground, WEST_END).goal.x_m > 18.0, "the east is left"
    ground.take_up_again()
    assert way_at(ground, WEST_END).goal.y_m > 7.0


def reference(cells: NDArray[np.uint8], room: NDArray[np.uint8], frontier: NDArray[np.bool_]) -> NDArray[np.int32]:
    """Dijkstra's algorithm as in the books."""
    steps = np.full(cells.shape, -1, np.int32)
    heap = [(0, int(r), int(c)) for r, c in zip(*np.nonzero(frontier), strict=True) if 1 < r < 28 and 1 < c < 28]
    for _, r, c in heap:
        steps[r, c] = 0
    while heap:
        step, r, c = heapq.heappop(heap)
        if step > steps[r, c]:
            continue
        for a, b in ((r + 1, c), (r - 1, c), (r, c + 1), (r, c - 1)):
            onward = step + _cost(room[np.newaxis], 0, a, b)
            flown = room[a, b] > 0 or (onward <= NEAR_STEPS and cells[a, b] == FREE)
            if 1 < a < 28 and 1 < b < 28 and flown and not 0 <= steps[a, b] <= onward:
                steps[a, b] = onward
                heapq.heappush(heap, (onward, a, b))
    return steps


@compiled
@given(seed=st.integers(0, 2**32 - 1), walls=st.floats(0.0, 0.2), unseen=st.floats(0.0, 0.3))
def test_ways_are_the_shortest_and_end_in_the_unseen(seed: int, walls: float, unseen: float) -> None:
    """Protects the search: its queues give what a heap does, and whoever walks down its steps arrives."""
    rng = np.random.default_rng(seed)
    cells = rng.choice([WALL, UNSEEN, FREE], (30, 30), p=[walls, unseen, 1.0 - walls - unseen]).astype(np.uint8)
    grid = level_ground(cells)
    room, frontier = _room(grid), _frontier(grid, 1)
    steps = _steps(grid, room, frontier)
    np.testing.assert_array_equal(steps[0], reference(cells, room[0], frontier[0]))
    ground = KnownGround()
    ground._origin, ground._grid = (0.0, 0.0), grid
    ways = Ways(ways_at(ground, Place(7.0, 7.0, 0.0)).window, room, steps)
    for x_m, y_m in rng.uniform(0.0, 15.0, (5, 2)):
        place = Place(float(x_m), float(y_m), 0.0)
        way = ways.way(place, 0.0, 0.5)
        along_m = ways.along_m(WallFollowing(place, float(rng.uniform(-4.0, 4.0)), 1))
        assert along_m >= 0.0
        if way is not None:
            row, column = ways.window.cell(way.goal)
            assert steps[0, row, column] == 0
            assert 0.0 <= way.length_m < math.inf
