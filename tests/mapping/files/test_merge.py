"""Adding maps: the arithmetic, and the join of their chunks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from companion.mapping.files.merge import MergedMap
from companion.mapping.voxels.chunks import NOTHING, VOLUME
from companion.mapping.voxels.piece import MapPiece, add_log_odds

LOWEST, HIGHEST = -1992, 3476
NOT_CLAMPED = -32767, 32767

values = st.one_of(st.just(int(NOTHING)), st.integers(LOWEST, HIGHEST))
rows = st.lists(values, min_size=8, max_size=8)


def added(first: Sequence[int], second: Sequence[int], clamps: tuple[int, int] = (LOWEST, HIGHEST)) -> list[int]:
    ours, theirs = (np.array([row], np.int16) for row in (first, second))
    add_log_odds(ours, theirs, *clamps)
    return [int(value) for value in ours[0]]


class Held:
    """A map in memory that gives chunks when asked, in an order of its own."""

    def __init__(self, chunks: NDArray[np.int32], values: NDArray[np.int16], voxel_m: float = 0.1) -> None:
        self.voxel_m = voxel_m
        self.chunks = chunks
        self._values = {tuple(chunk): row for chunk, row in zip(chunks.tolist(), values, strict=True)}

    def read(self, chunks: NDArray[np.int32]) -> MapPiece:
        found = [tuple(chunk) for chunk in chunks.tolist()[::-1] if tuple(chunk) in self._values]
        stacked = [self._values[chunk] for chunk in found]
        return MapPiece(np.array(found, np.int32).reshape(-1, 3), np.array(stacked, np.int16).reshape(-1, VOLUME))


def held(seed: int, count: int = 40) -> Held:
    """Random chunks of a small region, so that maps of different seeds overlap in part."""
    random = np.random.default_rng(seed)
    places = random.choice(4 * 4 * 4, count, replace=False)
    chunks = np.stack(np.unravel_index(places, (4, 4, 4)), axis=1).astype(np.int32) - 2
    voxels = random.integers(LOWEST, HIGHEST, (count, VOLUME)).astype(np.int16)
    voxels[random.random(voxels.shape) < 0.3] = NOTHING
    return Held(chunks, voxels)


def contents(voxels: MergedMap, most_chunks: int = 7) -> dict[tuple[int, ...], bytes]:
    found: dict[tuple[int, ...], bytes] = {}
    for piece in voxels.pieces(most_chunks):
        assert len(piece.chunks) <= most_chunks
        for chunk, row in zip(piece.chunks.tolist(), piece.values, strict=True):
            assert tuple(chunk) not in found
            found[tuple(chunk)] = row.tobytes()
    return found


def merged(*maps: Held) -> MergedMap:
    return MergedMap(maps, 847, LOWEST, HIGHEST)


@given(rows, rows)
def test_the_order_of_two_maps_does_not_matter(first: list[int], second: list[int]) -> None:
    """Protects from a merged map that depends on which vehicle is named first."""
    assert added(first, second) == added(second, first)


@given(rows, rows, rows)
def test_without_clamps_the_grouping_does_not_matter(a: list[int], b: list[int], c: list[int]) -> None:
    """Protects merging three maps in steps: whatever is added first, the sum is the same."""
    assert added(added(a, b, NOT_CLAMPED), c, NOT_CLAMPED) == added(a, added(b, c, NOT_CLAMPED), NOT_CLAMPED)


@given(rows)
def test_a_map_that_knows_nothing_changes_nothing(row: list[int]) -> None:
    """Protects the neutral element: nothing seen is not a value of zero, and not evidence for anything."""
    nothing = [int(NOTHING)] * len(row)
    assert added(row, nothing) == row
    assert added(nothing, row) == row


@given(values, values)
def test_the_sum_is_what_log_odds_say(a: int, b: int) -> None:
    """Protects the arithmetic itself: known plus known is the clamped sum, and only nothing plus nothing is nothing."""
    known = [value for value in (a, b) if value != NOTHING]
    expected = min(max(sum(known), LOWEST), HIGHEST) if known else NOTHING
    assert added([a], [b]) == [expected]


@given(rows, rows)
def test_the_sum_stays_within_the_clamps(a: list[int], b: list[int]) -> None:
    """Protects the bounds of the sensor model: a merged map can still be changed by what is seen later."""
    assert all(value == NOTHING or LOWEST <= value <= HIGHEST for value in added(a, b))


def test_the_greatest_sums_fit_into_16_bits() -> None:
    """Protects from a voxel that wraps around from sure to be occupied to sure to be free."""
    assert added([32767, -32767], [32767, -32767], NOT_CLAMPED) == [32767, -32767]


def test_the_order_of_several_maps_does_not_matter() -> None:
    """Protects the command: A B C and C A B give the same map, because nothing is clamped before all are added."""
    a, b, c = held(1), held(2), held(3)
    assert contents(merged(a, b, c)) == contents(merged(c, a, b))


def test_the_join_holds_every_chunk_with_its_sum() -> None:
    """Protects the join of the chunk lists: each chunk of any map is there once, at its own place."""
    a, b = held(1), held(2)
    found = contents(merged(a, b))
    keys = {tuple(chunk) for one in (a, b) for chunk in one.chunks.tolist()}
    assert set(found) == keys
    assert len(keys) < len(a.chunks) + len(b.chunks), "the maps overlap, or this would show little"
    nothing = np.full(VOLUME, NOTHING)
    for key, voxels in found.items():
        ours, theirs = (one._values.get(key, nothing).astype(np.int64) for one in (a, b))
        known = (ours != NOTHING).astype(np.int64), (theirs != NOTHING).astype(np.int64)
        total = np.clip(ours * known[0] + theirs * known[1], LOWEST, HIGHEST)
        expected = np.where(known[0] + known[1] > 0, total, NOTHING)
        assert (np.frombuffer(voxels, np.int16) == expected).all()


def test_a_map_alone_stays_as_it_is() -> None:
    """Protects what only one of the maps has seen."""
    only = held(5)
    assert contents(merged(only)) == {chunk: row.tobytes() for chunk, row in only._values.items()}


def test_voxels_of_different_size_are_refused() -> None:
    """Protects from adding up what is not at the same place."""
    other = Held(np.zeros((1, 3), np.int32), np.zeros((1, VOLUME), np.int16), voxel_m=0.2)
    with pytest.raises(ValueError, match=r"0\.1, 0\.2"):
        merged(held(1), other)


def test_no_map_is_refused() -> None:
    """Protects from a result without a voxel size."""
    with pytest.raises(ValueError, match="cannot merge"):
        merged()
