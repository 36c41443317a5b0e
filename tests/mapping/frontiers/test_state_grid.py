"""What is known of each voxel: the same as the map says, whatever was known before."""

from __future__ import annotations

import math

import numpy as np
import pytest

from companion.config.mapping import MapSettings
from companion.mapping import FREE, OCCUPIED, UNKNOWN, MapSnapshot, VoxelMap
from companion.mapping.frontiers.state_grid import StateGrid
from companion.mapping.voxels.chunks import NOTHING
from companion.mapping.voxels.piece import MapPiece
from tests.mapping.frontiers.scenes import snapshot, some_chunks, speckled

INDICES = np.indices((40, 40, 40)).reshape(3, -1).T


def test_every_voxel_is_what_was_put() -> None:
    """Protects all queries: chunks put over others, with more and fewer mixed bricks, in pieces, read back exactly."""
    known = StateGrid(0.1)
    random = np.random.default_rng(3)
    for seed in range(6):
        dense = speckled(seed)
        dense[random.integers(0, 40, 2000), random.integers(0, 40, 2000), :] = OCCUPIED if seed % 2 else FREE
        whole = snapshot(dense)
        order = random.permutation(len(whole.chunks))
        for part in np.array_split(order, 5):
            known.update(some_chunks(whole, part))
        assert np.array_equal(known.classify((INDICES + 0.5) * 0.1), dense.ravel())
        assert known.occupied_count == np.count_nonzero(dense == OCCUPIED)


def test_room_that_was_given_up_is_used_again() -> None:
    """Protects the memory of long flights: a map that changes for ever does not grow for ever."""
    known = StateGrid(0.1)
    maps = [snapshot(speckled(seed)) for seed in range(3)]
    for turn in range(9):
        known.update(maps[turn % 3])
    bricks_before = int(known.grid.used[1])
    for turn in range(60):
        known.update(maps[turn % 3])
    assert int(known.grid.used[1]) == bricks_before


def test_it_says_which_bricks_are_different() -> None:
    """Protects the plan: what is not told as different is never looked at again."""
    known = StateGrid(0.1)
    dense = speckled(1)
    assert known.update(snapshot(dense)).any()
    assert not known.update(snapshot(dense)).any()
    dense[17, 34, 6] = FREE if dense[17, 34, 6] != FREE else OCCUPIED
    changed = known.update(snapshot(dense))
    chunks = snapshot(dense).chunks
    row = int(np.flatnonzero((chunks == [1, 2, 0]).all(axis=1))[0])
    # The voxel is (1, 2, 6) in its chunk, so the brick is (0, 0, 1): number 4.
    assert changed[row] == 1 << 4
    assert np.count_nonzero(changed) == 1


def test_what_nobody_saw_is_unknown_and_costs_nothing() -> None:
    """Protects the rule that unknown is not free, beyond the chunks, far away and at the rim of all that can be."""
    known = StateGrid(0.1)
    known.update(snapshot(np.full((32, 16, 16), UNKNOWN, np.uint8)))
    assert known.chunk_count == 0
    known.update(snapshot(np.full((16, 16, 16), FREE, np.uint8)))
    points = np.array([[0.8, 0.8, 0.8], [-0.01, 0.8, 0.8], [1.61, 0.8, 0.8], [1e5, 0.0, 0.0], [1e300, -1e300, 0.0]])
    assert known.classify(points).tolist() == [FREE, UNKNOWN, UNKNOWN, UNKNOWN, UNKNOWN]


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_what_is_no_number_is_refused(bad: float) -> None:
    """Protects the callers: NaN never comes back as some voxel."""
    with pytest.raises(ValueError, match="not finite"):
        StateGrid(0.1).classify(np.array([[0.0, bad, 0.0]]))
    with pytest.raises(ValueError, match="voxel_m"):
        StateGrid(bad)


def test_voxels_of_another_size_are_refused() -> None:
    """Protects against a plan in which two maps are mixed up."""
    other = MapSnapshot(0.2, 1, np.zeros((0, 3), np.int32), np.zeros((0, 4096), np.uint8))
    with pytest.raises(ValueError, match=r"0\.2"):
        StateGrid(0.1).update(other)


def test_a_whole_map_is_read_from_any_source() -> None:
    """Protects `companion map`: log-odds become the states that the map itself gives them."""
    voxels = VoxelMap(MapSettings(voxel_m=0.1))
    values = np.full((2, 4096), NOTHING, np.int16)
    values[0, ::3] = voxels.threshold
    values[0, 1::3] = -400
    values[1, 7] = voxels.threshold - 1
    values[1, 8] = voxels.threshold + 1
    voxels.put(MapPiece(np.array([[0, 0, 0], [-3, 2, 1]], np.int32), values))
    points = np.random.default_rng(2).uniform(-6.0, 6.0, (5000, 3))
    points[:2000] = np.random.default_rng(3).uniform(0.0, 1.6, (2000, 3))
    known = StateGrid.of(voxels)
    assert np.array_equal(known.classify(points), voxels.classify(points))
    assert known.occupied_count == voxels.counts().occupied
