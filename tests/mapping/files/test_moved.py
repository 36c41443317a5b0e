"""A map in another frame: what is exact, what is near, and that nothing is known where nothing was seen."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from companion.control.sharing import Frame
from companion.mapping.files.merge import MergedMap
from companion.mapping.files.moved import MovedMap
from companion.mapping.voxels.chunks import EDGE, NOTHING, OFFSETS, VOLUME
from tests.mapping.files.test_merge import HIGHEST, LOWEST, Held, contents, held

VOXEL_M = 0.1

Voxels = dict[tuple[int, ...], int]

shifts = st.tuples(*[st.integers(-70, 70)] * 3)
quarters = st.integers(-4, 4)


def voxels_of(found: dict[tuple[int, ...], bytes]) -> Voxels:
    """Every voxel of which something is known, and its value."""
    known: Voxels = {}
    for chunk, data in found.items():
        values = np.frombuffer(data, np.int16)
        places = np.flatnonzero(values != NOTHING)
        at = np.array(chunk) * EDGE + OFFSETS[places]
        known |= dict(zip(map(tuple, at.tolist()), values[places].tolist(), strict=True))
    return known


def moved(source: Held, lies: Frame) -> Voxels:
    """The voxels of a map that is moved, and nothing else."""
    map_ = MovedMap(source, lies)
    found = contents(MergedMap([map_], 847, LOWEST, HIGHEST))
    assert set(found) == {tuple(chunk) for chunk in map_.chunks.tolist()}
    return voxels_of(found)


def few(seed: int) -> Held:
    """Some voxels in a chunk or two, so that each can be followed."""
    random = np.random.default_rng(seed)
    chunks = np.unique(random.integers(-2, 2, (2, 3)), axis=0).astype(np.int32)
    values = np.full((len(chunks), VOLUME), NOTHING, np.int16)
    for row in values:
        row[random.choice(VOLUME, 50, replace=False)] = random.integers(LOWEST, HIGHEST, 50)
    return Held(chunks, values)


def everything(source: Held) -> Voxels:
    return voxels_of({chunk: row.tobytes() for chunk, row in source._values.items()})


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 1000), shifts, quarters)
def test_whole_voxels_and_right_angles_come_out_exactly(seed: int, by: tuple[int, int, int], quarter: int) -> None:
    """Protects from a loss that need not be: each voxel is there once, at its place, with its value."""
    source = few(seed)
    lies = Frame(by[0] * VOXEL_M, by[1] * VOXEL_M, by[2] * VOXEL_M, quarter * math.pi / 2.0)
    expected = {}
    for (x, y, z), value in everything(source).items():
        for _ in range(quarter % 4):
            x, y = -y - 1, x
        expected[x + by[0], y + by[1], z + by[2]] = value
    assert moved(source, lies) == expected


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 1000), st.tuples(*[st.floats(-9.0, 9.0)] * 3), st.floats(-math.pi, math.pi))
def test_each_voxel_takes_what_its_centre_falls_into(seed: int, by_m: tuple[float, float, float], yaw: float) -> None:
    """Protects the rule, in any frame: the value at a voxel's centre, and nothing where nothing is known there."""
    source, lies = few(seed), Frame(*by_m, yaw)
    theirs, made = everything(source), moved(source, lies)
    for voxel, value in made.items():
        own = np.array(lies.own(*((np.array(voxel) + 0.5) * VOXEL_M))) / VOXEL_M
        near = {tuple(int(n) for n in np.floor(own + sign * 2e-6)) for sign in (0, 1)}
        assert value in [theirs.get(one) for one in near]
    # And none is left out whose centre falls into a voxel that is known.
    for voxel, value in theirs.items():
        shared = np.array(lies.shared(*((np.array(voxel) + 0.5) * VOXEL_M))) / VOXEL_M
        around: NDArray[np.int64] = np.floor(shared).astype(np.int64)
        centre = np.array(lies.own(*((around + 0.5) * VOXEL_M))) / VOXEL_M
        if np.abs(centre - np.array(voxel) - 0.5).max() < 0.49:
            assert made[tuple(around.tolist())] == value


def test_a_map_that_is_not_moved_merges_as_it_did() -> None:
    """Protects merging as it was: a frame that is the shared one changes no voxel of the sum."""
    a, b = held(1), held(2)
    plain = contents(MergedMap([a, b], 847, LOWEST, HIGHEST))
    assert contents(MergedMap([MovedMap(a, Frame()), MovedMap(b, Frame())], 847, LOWEST, HIGHEST)) == plain


def test_two_vehicles_that_saw_the_same_agree() -> None:
    """Protects V: a wall that two vehicles saw from frames of their own is one wall, and surer."""
    a = few(3)
    lies = Frame(1.2, -0.7, 0.3, math.pi / 2.0)
    there = MovedMap(a, Frame(*lies.own(0.0, 0.0, 0.0), -lies.yaw_rad))
    piece = there.read(there.chunks)
    b = Held(piece.chunks, piece.values)
    both = voxels_of(contents(MergedMap([a, MovedMap(b, lies)], 847, 2 * LOWEST, 2 * HIGHEST)))
    assert both == {voxel: 2 * value for voxel, value in everything(a).items()}


@pytest.mark.parametrize("degrees", [1.0, 20.0, 45.0, 70.0])
def test_a_wall_of_one_voxel_stays_closed(degrees: float) -> None:
    """Protects from a turned map with holes in its walls, through which ways would lead."""
    chunks = np.array([[x, 0, 0] for x in range(-2, 2)], np.int32)
    values = np.full((len(chunks), VOLUME), NOTHING, np.int16)
    values[:, (OFFSETS[:, 1] == 5) & (OFFSETS[:, 2] == 3)] = 2000
    angle = math.radians(degrees)
    wall = moved(Held(chunks, values), Frame(0.03, 0.07, 0.0, angle))
    major = 0 if degrees <= 45.0 else 1
    columns = {voxel[major] for voxel in wall}
    assert columns == set(range(min(columns), max(columns) + 1))
    assert len(columns) >= 64 * max(abs(math.cos(angle)), abs(math.sin(angle))) - 2


@pytest.mark.parametrize("lies", [Frame(math.nan, 0.0, 0.0, 0.0), Frame(1e9, 0.0, 0.0, 0.0)])
def test_a_place_that_is_none_is_refused(lies: Frame) -> None:
    """Protects from voxels anywhere."""
    with pytest.raises(ValueError, match="cannot be moved"):
        MovedMap(few(1), lies)


def test_a_map_with_nothing_in_it_stays_one() -> None:
    """Protects a vehicle that has seen nothing yet."""
    empty = Held(np.empty((0, 3), np.int32), np.empty((0, VOLUME), np.int16))
    assert moved(empty, Frame(1.0, 2.0, 3.0, 0.4)) == {}
