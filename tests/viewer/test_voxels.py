"""Packed voxels: that they say what the map says, and what of it is shown coarser."""

from __future__ import annotations

import numpy as np
import pytest

from companion.viewer.voxels import State
from tests.viewer.maps import nothing, tunnel


def coordinates(state: State, level: int = 0) -> set[tuple[int, ...]]:
    return {tuple(row) for numbers in tunnel().numbers(state, level) for row in numbers.tolist()}


def test_every_voxel_is_where_it_is_in_the_map() -> None:
    """Protects the place and the state of each voxel, on both sides of the origin."""
    free = {(x, y, z) for x in range(60) for y in range(20) for z in range(12)}
    around = {(x, y, z) for x in range(-1, 61) for y in range(-1, 21) for z in range(-1, 13)}
    assert coordinates(State.FREE) == free
    assert coordinates(State.OCCUPIED) == around - free
    assert coordinates(State.UNDECIDED) == {(-9, 0, 0)}
    assert [tunnel().count(state) for state in State] == [len(around - free), len(free), 1]


@pytest.mark.parametrize("level", [1, 2, 3, 4])
def test_a_wall_shows_in_every_coarser_cube_that_it_touches(level: int) -> None:
    """Protects from walls that vanish when a large map is shown coarser; free is what is free by half."""
    edge = 2**level
    walls = {tuple(part // edge for part in voxel) for voxel in coordinates(State.OCCUPIED)}
    assert coordinates(State.OCCUPIED, level) == walls
    free = [tuple(part // edge for part in voxel) for voxel in coordinates(State.FREE)]
    cubes, counts = np.unique(np.array(free), axis=0, return_counts=True)
    assert coordinates(State.FREE, level) == {tuple(row) for row in cubes[counts >= edge**3 // 2].tolist()}


def test_an_empty_map() -> None:
    """Protects a flight that saw nothing: no chunks, no voxels, no error."""
    assert len(nothing().chunks) == 0
    assert [nothing().count(state) for state in State] == [0, 0, 0]
    assert list(nothing().numbers(State.FREE)) == []
