"""How far it is to the nearest obstacle: never too far."""

from __future__ import annotations

import math

import numpy as np
import pytest

from companion.mapping import FREE, OCCUPIED
from companion.mapping.frontiers.nearest import MOST_VOXELS, nearest_not_free_m, nearest_obstacle_m
from companion.mapping.frontiers.state_grid import StateGrid
from companion.model import FloatArray
from tests.mapping.frontiers.scenes import Dense, snapshot, speckled


def _known(dense: Dense) -> StateGrid:
    known = StateGrid(0.1)
    known.update(snapshot(dense))
    return known


def _brute(wanted: Dense, corner: int, point_m: FloatArray, most_m: float) -> float:
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
        points_m,
        nearest_obstacle_m(known, points_m, 1.0),
        nearest_not_free_m(known, points_m, 1.0),
        strict=True,
    ):
        assert near_m == pytest.approx(_brute(obstacles, -rim, point_m, 1.0), abs=1e-9)
        assert not_free_m == pytest.approx(_brute(not_free, -rim, point_m, 1.0), abs=1e-9)


def test_across_many_chunks() -> None:
    """Protects the search in shells: one voxel far away is found wherever it is, and not beyond what was asked for."""
    dense = np.full((112, 112, 112), FREE, np.uint8)
    dense[100, 7, 51] = OCCUPIED
    known = _known(dense)
    points_m = np.random.default_rng(1).uniform(0.0, 11.2, (50, 3))
    expected_m = np.array([_brute((dense == OCCUPIED).astype(np.uint8), 0, point_m, 8.0) for point_m in points_m])
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
