"""Questions to a map: how far the nearest obstacle is, and whether one point is seen from another."""

from __future__ import annotations

import math
from fractions import Fraction
from itertools import product

import numpy as np
import pytest

from companion.mapping import FREE, OCCUPIED, UNKNOWN
from companion.mapping.frontiers.nearest import MOST_VOXELS, nearest_not_free_m, nearest_obstacle_m
from companion.mapping.frontiers.sight import UNIT, Verdict, sight, sights
from companion.mapping.frontiers.state_grid import StateGrid
from companion.model import FloatArray
from tests.mapping.frontiers.scenes import Dense, snapshot, speckled


def _known(dense: Dense) -> StateGrid:
    known = StateGrid(0.1)
    known.update(snapshot(dense))
    return known


def _nearest(wanted: Dense, corner: int, point_m: FloatArray, most_m: float) -> float:
    """The distance to the nearest box of all that are set, whose first is voxel ``corner`` along each axis."""
    low_m = (np.argwhere(wanted) + corner) * 0.1
    gaps_m = np.maximum(np.maximum(low_m - point_m, point_m - low_m - 0.1), 0.0)
    return min(float(np.sqrt((gaps_m**2).sum(axis=1).min(initial=math.inf))), most_m)


@pytest.mark.parametrize("seed", range(3))
def test_it_is_the_distance_to_the_nearest_box(seed: int) -> None:
    """Protects the margin: exactly what looking at every voxel gives, near and far, inside of the map and beside it."""
    dense = speckled(seed)
    known = _known(dense)
    points_m = np.random.default_rng(seed).uniform(-0.8, 4.8, (40, 3))
    points_m[:5] = np.round(points_m[:5], 1)
    rim = 12
    obstacles = np.pad((dense == OCCUPIED).astype(np.uint8), rim)
    not_free = np.pad((dense != FREE).astype(np.uint8), rim, constant_values=1)
    for point_m, near_m, not_free_m in zip(
        points_m, nearest_obstacle_m(known, points_m, 1.0), nearest_not_free_m(known, points_m, 1.0), strict=True
    ):
        assert near_m == pytest.approx(_nearest(obstacles, -rim, point_m, 1.0), abs=1e-9)
        assert not_free_m == pytest.approx(_nearest(not_free, -rim, point_m, 1.0), abs=1e-9)


def test_across_many_chunks() -> None:
    """Protects the search in shells: one voxel far away is found wherever it is, and not beyond what was asked for."""
    dense = np.full((112, 112, 112), FREE, np.uint8)
    dense[100, 7, 51] = OCCUPIED
    known = _known(dense)
    points_m = np.random.default_rng(1).uniform(0.0, 11.2, (50, 3))
    expected_m = np.array([_nearest((dense == OCCUPIED).astype(np.uint8), 0, point_m, 8.0) for point_m in points_m])
    assert np.allclose(nearest_obstacle_m(known, points_m, 8.0), expected_m, atol=1e-9)
    assert 0 < np.count_nonzero(expected_m < 8.0) < 50


def test_nothing_is_near_where_nobody_looked() -> None:
    """Protects the difference between the two: unknown is no obstacle that was seen, but it is not free."""
    known = StateGrid(0.1)
    point = np.array([[0.0, 0.0, 0.0], [1e300, 0.0, 0.0]])
    assert nearest_obstacle_m(known, point, 2.0).tolist() == [2.0, 2.0]
    assert nearest_not_free_m(known, point, 2.0).tolist() == [0.0, 0.0]
    assert nearest_obstacle_m(known, point[:0], 2.0).shape == (0,)


@pytest.mark.parametrize("most_m", [-0.1, math.nan, math.inf, 0.1 * MOST_VOXELS + 1.0])
def test_questions_without_an_end_are_refused(most_m: float) -> None:
    """Protects the tick of the navigator: no question may take for ever."""
    with pytest.raises(ValueError, match="most_m"):
        nearest_obstacle_m(StateGrid(0.1), np.zeros((1, 3)), most_m)


def test_a_point_that_is_no_number_is_refused() -> None:
    """Protects the margin: NaN is never far from everything."""
    with pytest.raises(ValueError, match="not finite"):
        nearest_obstacle_m(StateGrid(0.1), np.array([[math.nan, 0.0, 0.0]]), 1.0)


# Whether one point can be seen from another: no line slips between two voxels.


Point = tuple[float, float, float]


def _seen(dense: Dense, begin_m: FloatArray, end_m: FloatArray) -> tuple[Verdict, float]:
    """The verdict and the share of the line before it, from every closed box around the line, with exact fractions."""
    begin = [round(part) for part in begin_m / 0.1 * UNIT]
    end = [round(part) for part in end_m / 0.1 * UNIT]
    ranges = [range(min(p, q) // UNIT - 1, max(p, q) // UNIT + 2) for p, q in zip(begin, end, strict=True)]
    first = {OCCUPIED: Fraction(2), UNKNOWN: Fraction(2)}
    for cell in product(*ranges):
        inside = all(0 <= at < edge for at, edge in zip(cell, dense.shape, strict=True))
        state = dense[cell] if inside else UNKNOWN
        if state == FREE:
            continue
        enters, leaves = Fraction(0), Fraction(1)
        for at, p, q in zip(cell, begin, end, strict=True):
            low, high = at * UNIT - p, (at + 1) * UNIT - p
            if p == q:
                leaves = leaves if low <= 0 <= high else Fraction(-1)
            else:
                near, far = sorted((Fraction(low, q - p), Fraction(high, q - p)))
                enters, leaves = max(enters, near), min(leaves, far)
        if enters <= leaves:
            first[state] = min(first[state], enters)
    if first[OCCUPIED] <= 1:
        return Verdict.BLOCKED, float(first[OCCUPIED])
    return (Verdict.UNKNOWN, float(first[UNKNOWN])) if first[UNKNOWN] <= 1 else (Verdict.CLEAR, 1.0)


def _lines(seed: int) -> tuple[FloatArray, FloatArray]:
    """Any lines, lines through corners and edges of voxels, along axes on their faces, and short ones."""
    random = np.random.default_rng(seed)
    begins, ends = random.uniform(0.0, 4.0, (2, 24, 3))
    ends[:6] = begins[:6] + random.uniform(-0.8, 0.8, (6, 3))
    begins[6:12] = random.integers(0, 40, (6, 3)) * 0.1
    ends[6:12] = begins[6:12] + random.integers(-8, 9, (6, 1)) * random.integers(-1, 2, (6, 3)) * 0.1
    begins[12:18] = random.integers(0, 80, (6, 3)) * 0.05
    ends[12:18] = begins[12:18]
    ends[np.arange(12, 18), random.integers(0, 3, 6)] += random.uniform(-1.5, 1.5, 6)
    return begins, ends


@pytest.mark.parametrize("seed", range(5))
def test_it_is_what_every_box_on_the_line_says(seed: int) -> None:
    """Protects the vehicle from a line that slips through: as exact fractions over all boxes say, both ways."""
    dense = speckled(seed)
    known = _known(dense)
    begins_m, ends_m = _lines(seed)
    verdicts, where_m = sights(known, begins_m, ends_m)
    back, _ = sights(known, ends_m, begins_m)
    assert np.array_equal(verdicts, back)
    for n, (begin_m, end_m) in enumerate(zip(begins_m, ends_m, strict=True)):
        verdict, share = _seen(dense, begin_m, end_m)
        assert verdicts[n] == verdict
        # The ends are rounded to a thousandth of a voxel.
        assert np.allclose(where_m[n], begin_m + share * (end_m - begin_m), atol=3e-4)


def test_a_line_through_an_edge_or_a_corner_touches_what_meets_there() -> None:
    """Protects against sight through a crack: two voxels that meet at an edge are a wall for the line between them."""
    dense = np.full((16, 16, 16), FREE, np.uint8)
    dense[8, 7, 5] = OCCUPIED
    known = _known(dense)
    # Through the edge x = y = 0.8 m, where only voxels (7, 7) and (8, 8) lie on the diagonal itself.
    assert sight(known, (0.45, 0.45, 0.55), (1.25, 1.25, 0.55)).verdict == Verdict.BLOCKED
    assert sight(known, (0.45, 0.45, 0.75), (1.25, 1.25, 0.75)).verdict == Verdict.CLEAR
    # Along the face y = 0.8 m of the voxel, and just beside it.
    assert sight(known, (0.45, 0.8, 0.55), (1.25, 0.8, 0.55)).verdict == Verdict.BLOCKED
    assert sight(known, (0.45, 0.81, 0.55), (1.25, 0.81, 0.55)).verdict == Verdict.CLEAR


@pytest.mark.parametrize(
    ("point", "verdict"),
    [((0.85, 0.75, 0.55), Verdict.BLOCKED), ((0.35, 0.35, 0.35), Verdict.CLEAR), ((9.0, 0.0, 0.0), Verdict.UNKNOWN)],
)
def test_a_point_sees_itself_when_it_is_free(point: Point, verdict: Verdict) -> None:
    """Protects the degenerate line: the same point twice, in an obstacle, in free space, beyond the map."""
    dense = np.full((16, 16, 16), FREE, np.uint8)
    dense[8, 7, 5] = OCCUPIED
    found = sight(_known(dense), point, point)
    assert found.verdict == verdict
    assert found.where_m is None if verdict == Verdict.CLEAR else found.where_m == pytest.approx(point)


def test_an_obstacle_behind_something_unknown_is_still_told() -> None:
    """Protects whoever waits for a better look: through the unknown, and into rock, and the place is the rock's."""
    dense = np.full((32, 16, 16), FREE, np.uint8)
    dense[8] = UNKNOWN
    known = _known(dense)
    assert sight(known, (0.15, 0.55, 0.55), (3.05, 0.55, 0.55)).where_m == pytest.approx((0.8, 0.55, 0.55))
    dense[20] = OCCUPIED
    found = sight(_known(dense), (0.15, 0.55, 0.55), (3.05, 0.55, 0.55))
    assert found.verdict == Verdict.BLOCKED
    assert found.where_m == pytest.approx((2.0, 0.55, 0.55))


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_ends_that_are_no_numbers_are_refused(bad: float) -> None:
    """Protects the callers: nothing is ever clear up to NaN."""
    with pytest.raises(ValueError, match="not finite"):
        sight(StateGrid(0.1), (0.0, 0.0, 0.0), (bad, 0.0, 0.0))


def test_lines_without_an_end_are_refused() -> None:
    """Protects the tick of the navigator, and the whole numbers from running over."""
    with pytest.raises(ValueError, match="m long"):
        sight(StateGrid(0.1), (0.0, 0.0, 0.0), (5000.0, 0.0, 0.0))
    with pytest.raises(ValueError, match="1 lines begin and 2 end"):
        sights(StateGrid(0.1), np.zeros((1, 3)), np.zeros((2, 3)))
