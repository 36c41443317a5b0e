"""The figures of a map, against rooms and walls whose figures are known."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest
from numpy.typing import NDArray

from companion.mapping.files.facts import SurfaceArea, facts_of
from companion.mapping.files.merge import ClippedMap
from companion.mapping.voxels.chunks import NOTHING, OFFSETS, VOLUME
from companion.mapping.voxels.piece import MOST_CHUNKS, MapPiece
from companion.model import FloatArray

VOXEL_M = 0.1
THRESHOLD = 847
FREE, OCCUPIED, UNDECIDED = -1500, 3000, 300

Inside = Callable[[FloatArray], NDArray[np.bool_]]


class Held:
    """A map in memory."""

    voxel_m = VOXEL_M
    threshold = THRESHOLD

    def __init__(self, chunks: NDArray[np.int32], values: NDArray[np.int16]) -> None:
        self._chunks, self._values = chunks, values

    def pieces(self, most_chunks: int = MOST_CHUNKS) -> Iterator[MapPiece]:
        for first in range(0, len(self._chunks), most_chunks):
            yield MapPiece(self._chunks[first : first + most_chunks], self._values[first : first + most_chunks])


def map_of(half_m: float, occupied: Inside, free: Inside) -> Held:
    """A map of a cube around the origin, from what its voxels' centres are in."""
    last = int(np.ceil(half_m / VOXEL_M / 16))
    chunks = np.stack(np.meshgrid(*[np.arange(-last, last)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    centres = (chunks[:, None] * 16 + OFFSETS + 0.5) * VOXEL_M
    values = np.full(centres.shape[:2], NOTHING)
    at: FloatArray = centres.astype(np.float64)
    values[free(at)] = FREE
    values[occupied(at)] = OCCUPIED
    return Held(chunks.astype(np.int32), values)


def in_box(low_m: tuple[float, ...], high_m: tuple[float, ...]) -> Inside:
    return lambda at: np.asarray(((at > low_m) & (at < high_m)).all(axis=-1))


def room() -> Held:
    """Free from (-2, -1, 0) to (2, 1, 1.6), with walls of one voxel, whose floor is the edge of a chunk."""
    free, outside = in_box((-2, -1, 0), (2, 1, 1.6)), in_box((-2.1, -1.1, -0.1), (2.1, 1.1, 1.7))
    return map_of(3.0, lambda at: outside(at) & ~free(at), free)


def test_the_figures_of_a_room() -> None:
    """Protects what a surveyor reads: volume, area, bounds and counts of a box of 4 x 2 x 1.6 m."""
    facts = facts_of(room())
    assert facts.free == 40 * 20 * 16
    assert facts.occupied == 42 * 22 * 18 - 40 * 20 * 16
    assert facts.undecided == 0
    assert facts.free_m3 == pytest.approx(4 * 2 * 1.6)
    assert facts.low_m == pytest.approx((-2.1, -1.1, -0.1))
    assert facts.high_m == pytest.approx((2.1, 1.1, 1.7))
    assert facts.extent_m == pytest.approx((4.2, 2.2, 1.8))
    # Every occupied voxel touches one plane only, but for cubes of 4 that hold an edge of the room: there are none.
    assert facts.surface_m2 == pytest.approx(2 * (4 * 2 + 4 * 1.6 + 2 * 1.6))


def test_faces_between_chunks_are_counted() -> None:
    """Protects a floor at z = 0: its voxels and the free ones above are in different chunks."""
    plate = map_of(1.6, in_box((-1, -1, -0.1), (1, 1, 0)), in_box((-1, -1, 0), (1, 1, 0.5)))
    assert facts_of(plate).surface_m2 == pytest.approx(4.0)


def test_the_pieces_may_come_in_any_order() -> None:
    """Protects the sum over borders: chunks of a journal come in no order at all."""
    source = room()
    order = np.random.default_rng(1).permutation(len(source._chunks))
    assert facts_of(Held(source._chunks[order], source._values[order])) == facts_of(source)


@pytest.mark.parametrize("normal", [(1, 0, 0), (1, 1, 0), (1, 1, 1), (3, 2, 1), (5, 1, 0), (-2, 7, 3)])
def test_the_area_of_a_slanted_wall(normal: tuple[float, ...]) -> None:
    """Protects from counting steps: the faces of a wall along (1, 1, 1) have 1.7 times its area.

    A disc of 2 m. What is allowed is its rim: half a voxel of the radius is 5 % of the area.
    """
    n = np.array(normal) / np.linalg.norm(normal)

    def disc(low_m: float, high_m: float) -> Inside:
        def inside(at: FloatArray) -> NDArray[np.bool_]:
            depth = at @ n - 0.03
            return np.asarray(
                (depth > low_m) & (depth <= high_m) & (np.linalg.norm(at - depth[..., None] * n, axis=-1) < 2.0)
            )

        return inside

    facts = facts_of(map_of(2.5, disc(0.0, 0.2), disc(-0.5, 0.0)))
    assert facts.surface_m2 == pytest.approx(4 * np.pi, rel=0.05)


def test_no_area_next_to_the_unknown() -> None:
    """Protects the estimate from the back of walls: what was never seen bounds nothing."""
    slab = map_of(1.6, in_box((-1, -1, 0), (1, 1, 0.2)), lambda at: np.zeros(at.shape[:-1], np.bool_))
    assert facts_of(slab).surface_m2 == 0.0


def test_an_empty_map_has_no_bounds() -> None:
    """Protects a flight that saw nothing: zeros, and no infinite box."""
    for empty in (Held(np.zeros((0, 3), np.int32), np.zeros((0, VOLUME), np.int16)), map_of(1.6, *[_never] * 2)):
        facts = facts_of(empty)
        assert (facts.chunks, facts.occupied, facts.free, facts.surface_m2) == (0, 0, 0, 0.0)
        assert (facts.low_m, facts.high_m, facts.extent_m) == (None, None, (0.0, 0.0, 0.0))
    assert SurfaceArea().in_faces() == 0.0


def test_the_undecided_are_counted_apart() -> None:
    """Protects the word unknown: seen, but not well enough, is neither free nor occupied nor inside the bounds."""
    values = np.full((1, VOLUME), NOTHING)
    values[0, :3] = UNDECIDED, THRESHOLD - 1, 0
    facts = facts_of(Held(np.array([[0, 0, 0]], np.int32), values))
    assert (facts.occupied, facts.free, facts.undecided, facts.low_m) == (0, 0, 3, None)


def test_progress_counts_chunks() -> None:
    """Protects the bar of a large map: it is told how far it is, up to the end."""
    told: list[int] = []
    facts = facts_of(room(), told.append)
    assert told == sorted(told)
    assert told[-1] == facts.chunks


def test_a_box_cuts_whole_voxels() -> None:
    """Protects a part that is exported: exactly the voxels whose centres are in the box."""
    clipped = ClippedMap(room(), (-1.0, -0.5, 0.0, 0.5, 0.5, 1.0))
    facts = facts_of(clipped)
    assert facts.free == 15 * 10 * 10
    assert facts.occupied == 0
    assert facts.low_m == pytest.approx((-1.0, -0.5, 0.0))
    assert facts.high_m == pytest.approx((0.5, 0.5, 1.0))


def test_a_box_beside_the_map_holds_nothing() -> None:
    """Protects from chunks that are given though nothing of them is in the box."""
    assert list(ClippedMap(room(), (50.0, 50.0, 50.0, 51.0, 51.0, 51.0)).pieces()) == []


@pytest.mark.parametrize("box", [(0, 0, 0, 0, 1, 1), (1, 0, 0, 0, 1, 1), (0, 0, 0, float("nan"), 1, 1)])
def test_what_is_no_box_is_refused(box: tuple[float, float, float, float, float, float]) -> None:
    """Protects from an empty file where corners were given the wrong way round."""
    with pytest.raises(ValueError, match="is no box"):
        ClippedMap(room(), box)


def _never(at: FloatArray) -> NDArray[np.bool_]:
    return np.zeros(at.shape[:-1], np.bool_)
