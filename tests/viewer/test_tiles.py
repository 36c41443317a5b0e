"""A map in tiles: what of it is drawn, how coarse, and which tiles change when it grows."""

from __future__ import annotations

import numpy as np
import pytest

from companion.mapping.voxels.chunks import OFFSETS
from companion.mapping.voxels.lookup import FREE, OCCUPIED, UNKNOWN
from companion.mapping.voxels.piece import MapSnapshot
from companion.viewer.tiles import COARSEST, TILE, Shown, TiledMap, finest, packed_snapshot
from companion.viewer.voxels import PackedVoxels, State
from tests.viewer.maps import VOXEL_M, nothing, tunnel


def tiled(voxels: PackedVoxels) -> TiledMap:
    made = TiledMap(voxels.voxel_m)
    made.put(voxels)
    return made


def centres_m(tiles: TiledMap, state: State, shown: Shown, level: int = 0, every: int = 1) -> set[tuple[float, ...]]:
    """The centres of the cubes that are drawn, rounded to mm."""
    found: set[tuple[float, ...]] = set()
    for tile in tiles.tiles:
        cloud = tiles.cloud(tile, state, shown, level, every)
        places = (cloud.cubes + 0.5) * VOXEL_M * 2**level + np.array(tiles.corner_m(tile))
        assert places[:, 2] == pytest.approx(cloud.heights_m, abs=1e-4)
        found |= set(map(tuple, places.round(3).tolist()))
    return found


def test_with_its_roof_every_voxel_is_drawn_where_it_is() -> None:
    """Protects places: tiles, chunks and Morton order lead back to the voxels that the map has."""
    voxels, everything = tunnel(200), Shown(roof=True)
    tiles = tiled(voxels)
    assert len(list(tiles.tiles)) > 2
    for state in State:
        there = np.concatenate(list(voxels.numbers(state)))
        expected = set(map(tuple, ((there + 0.5) * VOXEL_M).round(3).tolist()))
        assert centres_m(tiles, state, everything) == expected


def test_what_is_taken_off_is_the_roof_over_what_is_free_and_nothing_else() -> None:
    """Protects the sight from above: ground and walls stay, also across the borders of chunks."""
    tiles = tiled(tunnel())
    hidden = centres_m(tiles, State.OCCUPIED, Shown(roof=True)) - centres_m(tiles, State.OCCUPIED, Shown())
    assert hidden == {
        (round((x + 0.5) * VOXEL_M, 3), round((y + 0.5) * VOXEL_M, 3), round(12.5 * VOXEL_M, 3))
        for x in range(60)
        for y in range(20)
    }


def test_a_roof_is_taken_off_when_the_free_space_under_it_comes_later() -> None:
    """Protects growth: the chunk above was complete before anybody saw what is under it."""
    whole = tunnel()
    tiles = TiledMap(VOXEL_M)
    sliced = PackedVoxels(VOXEL_M, whole.chunks + np.array([0, 0, 1], np.int32), whole.bits)
    # The free space moved up by a chunk ends in the chunk above: its roof is at 28 voxels, its ground at 15.
    tiles.put(sliced.where(sliced.chunks[:, 2] >= 2))
    tiles.put(sliced.where(sliced.chunks[:, 2] < 2))
    assert centres_m(tiles, State.OCCUPIED, Shown()) == centres_m(tiled(sliced), State.OCCUPIED, Shown())


def test_ground_is_told_from_walls() -> None:
    """Protects the light: ground is what has free space above it."""
    tiles = tiled(tunnel())
    ground = {
        round(float(height), 3)
        for tile in tiles.tiles
        for cloud in [tiles.cloud(tile, State.OCCUPIED, Shown(), 0)]
        for height in cloud.heights_m[cloud.ground]
    }
    assert ground == {round(-0.5 * VOXEL_M, 3)}


def test_a_slice_has_what_is_between_its_heights() -> None:
    """Protects the slider."""
    tiles = tiled(tunnel())
    heights = {z for _, _, z in centres_m(tiles, State.OCCUPIED, Shown(low_m=0.2, high_m=0.5))}
    assert heights == {0.25, 0.35, 0.45}


@pytest.mark.parametrize("level", range(COARSEST + 1))
def test_coarser_cubes_are_those_around_the_voxels(level: int) -> None:
    """Protects large maps: nothing vanishes when they are drawn coarser, and the number of cubes is foretold."""
    voxels = tunnel()
    tiles = tiled(voxels)
    numbers = {tuple(n) for part in voxels.numbers(State.OCCUPIED, level) for n in part.tolist()}
    edge_m = VOXEL_M * 2**level
    expected = {tuple(round((n + 0.5) * edge_m, 3) for n in number) for number in numbers}
    assert centres_m(tiles, State.OCCUPIED, Shown(roof=True), level) == expected
    assert tiles.counts()[State.OCCUPIED, level] == len(expected)


@pytest.mark.parametrize("most", [1, 7, 100, 5000])
def test_there_are_never_more_points_than_allowed(most: int) -> None:
    """Protects the limit also where the coarsest cubes are too many."""
    tiles = tiled(tunnel(600))
    for state in State:
        level, every = finest(tiles.counts()[state], tiles.chunks, most)
        assert len(centres_m(tiles, state, Shown(roof=True), level, every)) <= most


def test_only_tiles_around_what_changed_are_drawn_anew() -> None:
    """Protects the network: a vehicle that adds a chunk does not send the mine again."""
    tiles = tiled(tunnel(1000))
    chunk = np.array([[TILE * 2 + 1, 0, 1]], np.int32)
    states = np.full((1, 4096), FREE, np.uint8)
    assert tiles.put(packed_snapshot(MapSnapshot(VOXEL_M, 1, chunk, states))) == {(2, 0, 0)}
    at_the_top, below = np.array([[1, 0, TILE]], np.int32), np.array([[1, 0, TILE - 1]], np.int32)
    tiles.put(packed_snapshot(MapSnapshot(VOXEL_M, 1, below, states)))
    assert tiles.put(packed_snapshot(MapSnapshot(VOXEL_M, 1, at_the_top, states))) == {(0, 0, 0), (0, 0, 1)}


def test_a_chunk_is_replaced_by_its_newest_state() -> None:
    """Protects from ghosts: what was carved away since is gone."""
    tiles = TiledMap(VOXEL_M)
    chunk = np.array([[0, 0, 0]], np.int32)
    states = np.where(OFFSETS[:, 2] == 0, OCCUPIED, UNKNOWN).astype(np.uint8)[None]
    tiles.put(packed_snapshot(MapSnapshot(VOXEL_M, 1, chunk, states)))
    assert len(centres_m(tiles, State.OCCUPIED, Shown())) == 256
    tiles.put(packed_snapshot(MapSnapshot(VOXEL_M, 2, chunk, np.full((1, 4096), FREE, np.uint8))))
    assert tiles.counts()[:, 0].tolist() == [0, 4096, 0]
    assert centres_m(tiles, State.OCCUPIED, Shown()) == set()


def test_of_an_empty_map_nothing_is_drawn() -> None:
    """Protects a flight that saw nothing."""
    tiles = tiled(nothing())
    assert tiles.counts().sum() == 0
    assert all(not centres_m(tiles, state, Shown(roof=True)) for state in State)
