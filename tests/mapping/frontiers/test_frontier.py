"""Frontiers, what a map says of the end of a mission, and surveys of a growing map."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from numpy.typing import NDArray

from companion.control.completion import MapWord
from companion.mapping import FREE, OCCUPIED, UNKNOWN, MapSnapshot
from companion.mapping.frontiers.frontier import Access, Survey
from companion.mapping.frontiers.surveyor import Surveyor, survey
from companion.model import FloatArray
from tests.mapping.frontiers.scenes import REACH, Dense, room, snapshot, some_chunks


def flown(*places: tuple[float, float, float]) -> NDArray[np.float64]:
    return np.array(places)


# The floor of `room` is at 0.2 m, so H is at 1.7 m.
MIDDLE = flown((4.0, 3.0, 1.7))


@pytest.mark.parametrize("voxel_m", [0.05, 0.1, 0.2])
def test_a_room_that_was_seen_is_complete(voxel_m: float) -> None:
    """Whatever the size of the voxels: no frontier, all of floor and roof, the area at flight height right."""
    found = survey(snapshot(room(voxel_m=voxel_m), voxel_m), flown((4.0, 3.0, 1.5 + 2.0 * voxel_m)), REACH)
    assert len(found.frontiers_m) == 0
    assert found.seen_share == 1.0
    assert found.completeness == 1.0
    assert found.free_m2 == pytest.approx(48.0, rel=0.01)
    # 1 m from every wall leaves 6 m x 4 m; the tolerance is two cells at most at every wall.
    cell_m = max(voxel_m, 0.1)
    assert 24.0 <= found.reachable_m2 <= (6.0 + 4.01 * cell_m) * (4.0 + 4.01 * cell_m)
    assert found.word(REACH) == MapWord(0.0, 1.0, found.surfaces_seen, has_room=True)


def test_an_opening_into_the_unknown_is_a_frontier() -> None:
    """A doorway that nobody looked through keeps the mission going, and its width is told."""
    dense = room()
    dense[-2:, 20:44, 2:-2] = UNKNOWN
    found = survey(snapshot(dense), MIDDLE, REACH)
    assert len(found.frontiers_m) == 1
    # 2.4 m, less what lies at the frame of the door and could be its undecided voxels.
    assert 1.8 <= found.frontiers_m[0] <= 2.4
    assert found.completeness < 0.95
    assert found.word(REACH).frontier_m == found.frontiers_m[0], "a way out must never be given up"


def test_specks_are_no_frontier() -> None:
    """What depth noise and missing pixels leave unknown must not keep a vehicle in the air for ever."""
    dense = room()
    random = np.random.default_rng(1)
    specks = random.random(dense.shape) < 0.05
    dense[specks & (dense == FREE)] = UNKNOWN
    dense[-2:, 20:23, 2:-2] = UNKNOWN
    assert len(survey(snapshot(dense), MIDDLE, REACH).frontiers_m) == 0


def test_undecided_voxels_before_a_wall_are_no_frontier() -> None:
    """A surface has voxels before it of which the looks did not decide: they are the wall, not a way."""
    dense = room()
    dense[-3:-1, 2:-2, 2:-2] = UNKNOWN
    assert len(survey(snapshot(dense), MIDDLE, REACH).frontiers_m) == 0


def test_what_no_reachable_place_looks_at_is_no_frontier() -> None:
    """Behind a gap that is too narrow, round a corner: the vehicle must not wait for it, but the operator is told."""
    dense = room()
    # A second room beside the first, free but with unknown behind it, joined through a gap of 0.4 m at one end.
    beside = np.full((dense.shape[0], 40, dense.shape[2]), OCCUPIED, np.uint8)
    beside[2:-2, 2:-2, 2:-2] = FREE
    beside[-2:, 2:-2, 2:-2] = UNKNOWN
    both = np.concatenate([dense, beside], axis=1)
    both[4:8, 58:70, 2:-2] = FREE
    found = survey(snapshot(both), MIDDLE, REACH)
    assert len(found.frontiers_m) == 0
    assert [frontier.access for frontier in found.frontiers] == [Access.TOO_NARROW]
    # The same with a gap that is wide enough: now the vehicle can go there.
    both[4:40, 58:70, 2:-2] = FREE
    assert len(survey(snapshot(both), MIDDLE, REACH).frontiers_m) == 1


@pytest.mark.parametrize("slope", [0.27, -0.27, 0.6])
def test_the_plan_follows_the_ground(slope: float) -> None:
    """A ramp is a way and not a wall: level flight would end at its floor or its roof, and the mission before it."""
    length, rise = 160, round(160 * abs(slope))
    dense = np.full((length, 44, 44 + rise), OCCUPIED, np.uint8)
    for i in range(length):
        low = 2 + round(i * abs(slope) if slope > 0 else (length - i) * abs(slope))
        dense[i, 2:-2, low : low + 30] = FREE
    start_m = 0.2 + (0.0 if slope > 0 else length * abs(slope) * 0.1) + 10 * slope * 0.1 + 1.5
    found = survey(snapshot(dense), flown((1.0, 2.2, start_m)), REACH)
    assert found.free_m2 == pytest.approx(16.0 * 4.0, rel=0.05)
    # Open at both ends of the ramp. Only the upper or lower one is far away.
    assert len(found.frontiers_m) == 2


def test_places_above_each_other_stay_apart() -> None:
    """A drift below another one, as in a spiral ramp: each has its own frontier."""
    lower, upper = room(), room()
    upper[-2:, 20:44, 2:-2] = UNKNOWN
    both = np.concatenate([lower, upper], axis=2)
    top_m = lower.shape[2] * 0.1
    assert len(survey(snapshot(both), MIDDLE, REACH).frontiers_m) == 0
    found = survey(snapshot(both), np.concatenate([MIDDLE, MIDDLE + np.array([0.0, 0.0, top_m])]), REACH)
    assert len(found.frontiers_m) == 1
    assert found.free_m2 == pytest.approx(2 * 48.0, rel=0.01)


def test_floor_and_roof_have_to_be_seen() -> None:
    """The slab alone is seen minutes before floor and roof are: a tenth of both missing is not complete."""
    dense = room()
    dense[2:22, 2:-2, :5] = UNKNOWN
    dense[2:22, 2:-2, -6:] = UNKNOWN
    found = survey(snapshot(dense), MIDDLE, REACH)
    assert len(found.frontiers_m) == 0
    assert found.seen_share == pytest.approx(0.75, abs=0.01)
    assert found.word(REACH).seen_share == found.seen_share


def test_a_roof_out_of_sight_does_not_count() -> None:
    """In a hall the camera never sees the roof; waiting for it would be waiting for ever."""
    dense = room(z_m=8.0)
    dense[:, :, 50:] = UNKNOWN
    found = survey(snapshot(dense), MIDDLE, REACH)
    assert found.seen_share == 1.0


@pytest.mark.parametrize("places", [flown((4.0, 3.0, 1.7)), flown((1e5, -1e5, 0.0)), np.zeros((0, 3))])
def test_an_empty_map_is_not_complete(places: NDArray[np.float64]) -> None:
    """No look yet, or a place outside the map: there is no frontier because nothing is known."""
    unknown = snapshot(np.full((16, 16, 16), UNKNOWN, np.uint8))
    for nothing in (unknown, MapSnapshot(0.1, 0, unknown.chunks[:0], unknown.states[:0])):
        found = survey(nothing, places, REACH)
        assert found.completeness == 0.0
        assert not found.word(REACH).has_room


# Surveys of a growing map: the same as of the whole one, whatever became known when.


def _mine(seed: int) -> Dense:
    """Two rooms with a drift between them, an opening, a ledge, and what noise leaves."""
    random = np.random.default_rng(seed)
    dense = np.full((112, 64, 40), OCCUPIED, np.uint8)
    dense[2:40, 2:40, 2:32] = FREE
    dense[40:72, 8:34, 2:30] = FREE
    dense[72:110, 2:62, 5:34] = FREE
    dense[88:100, 30:42, 2:20] = OCCUPIED
    dense[108:, 12:40, 5:34] = UNKNOWN
    dense[10:20, 38:, 2:32] = UNKNOWN
    noise = random.random(dense.shape)
    dense[noise < 0.04] = UNKNOWN
    dense[noise > 0.9995] = OCCUPIED
    return dense


FLOWN_M = np.array([[1.5 + 0.2 * n, 2.0 + 0.1 * math.sin(n), 1.7 + 0.002 * n] for n in range(36)])


def _same(one: Survey, other: Survey) -> None:
    assert np.array_equal(one.frontiers_m, other.frontiers_m)
    for field in dataclasses.fields(Survey):
        if field.name not in ("frontiers_m", "frontiers"):
            assert getattr(one, field.name) == getattr(other, field.name), field.name
    assert len(one.frontiers) == len(other.frontiers)
    for a, b in zip(one.frontiers, other.frontiers, strict=True):
        assert a.access == b.access
        assert a.cells == b.cells
        assert (a.x_m, a.y_m, a.z_m, a.bearing_rad) == pytest.approx((b.x_m, b.y_m, b.z_m, b.bearing_rad))


def _at(places_m: FloatArray) -> tuple[float, float, float]:
    x_m, y_m, z_m = places_m[-1].tolist()
    return x_m, y_m, z_m


@pytest.mark.parametrize("seed", range(4))
def test_piece_by_piece_is_the_same_as_at_once(seed: int) -> None:
    """Protects the end of a mission: whatever became known or wrong in between, and in whatever order."""
    random = np.random.default_rng(seed)
    final = snapshot(_mine(seed))
    surveyor = Surveyor(0.1, REACH)
    chunks = len(final.chunks)
    flown = 0
    for turn in range(6):
        # Something else first: what is taken back must leave nothing behind.
        wrong = snapshot(_mine(100 + 10 * seed + turn))
        for part in np.array_split(random.permutation(chunks)[: chunks // 2], 2):
            surveyor.update(some_chunks(wrong if random.random() < 0.6 else final, part))
        more = min(flown + int(random.integers(0, 12)), len(FLOWN_M))
        surveyor.flew(FLOWN_M[flown:more])
        flown = more
        surveyor.survey(_at(FLOWN_M[: max(flown, 1)]))
    surveyor.flew(FLOWN_M[flown:])
    for part in np.array_split(random.permutation(chunks), 4):
        surveyor.update(some_chunks(final, part))
        if random.random() < 0.5:
            surveyor.survey(_at(FLOWN_M))
    at_once = survey(final, FLOWN_M, REACH)
    _same(surveyor.survey(_at(FLOWN_M)), at_once)
    assert at_once.free_m2 > 20.0
    assert len(at_once.frontiers) > 0


def test_a_place_that_was_only_looked_from_leaves_nothing() -> None:
    """Protects the estimate: a vehicle that climbs or hovers somewhere else does not count as having flown there."""
    dense = _mine(1)
    surveyor = Surveyor(0.1, REACH)
    surveyor.update(snapshot(dense))
    surveyor.flew(FLOWN_M)
    before = surveyor.survey(_at(FLOWN_M))
    surveyor.survey((3.0, 3.0, 0.6))
    surveyor.survey((9.0, 5.0, 2.6))
    _same(surveyor.survey(_at(FLOWN_M)), before)


def test_a_way_that_closes_takes_all_behind_it_away() -> None:
    """Protects the operator: behind a fall of rock nothing is reachable any more, and it comes back when it opens."""
    dense = np.concatenate([room(), room()], axis=0)
    dense[78:90, 20:44, 2:-2] = FREE
    surveyor = Surveyor(0.1, REACH)
    place = np.array([[4.0, 3.0, 1.7]])
    surveyor.update(snapshot(dense))
    surveyor.flew(place)
    opened = surveyor.survey(_at(place))
    closed = dense.copy()
    closed[82:86] = OCCUPIED
    surveyor.update(snapshot(closed))
    found = surveyor.survey(_at(place))
    assert found.free_m2 == pytest.approx(48.0, rel=0.02)
    assert opened.free_m2 > 90.0
    surveyor.update(snapshot(dense))
    _same(surveyor.survey(_at(place)), opened)


def test_what_a_frontier_says_of_itself() -> None:
    """Protects the operator's screen: where it is, which way the unknown lies, and how far the way is."""
    dense = room()
    dense[-2:, 20:44, 2:-2] = UNKNOWN
    (found,) = survey(snapshot(dense), np.array([[4.0, 3.0, 1.7]]), REACH).frontiers
    assert found.access is Access.REACHABLE
    assert found.x_m == pytest.approx(8.25, abs=0.2)
    assert found.y_m == pytest.approx(3.2, abs=0.2)
    assert found.z_m == pytest.approx(1.7, abs=0.05)
    assert abs(found.bearing_rad) < 0.3
    assert 4.0 <= found.path_m < 8.0
    assert found.low_m[0] < found.x_m < found.high_m[0]
    assert found.length_m == pytest.approx(0.1 * found.cells)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_place_that_is_no_number_is_refused(bad: float) -> None:
    """Protects the plan: a flood never begins at NaN."""
    surveyor = Surveyor(0.1, REACH)
    with pytest.raises(ValueError, match="not finite"):
        surveyor.flew(np.array([[0.0, bad, 1.0]]))
    with pytest.raises(ValueError, match="not finite"):
        surveyor.survey((0.0, 0.0, bad))


def test_far_from_everything_nothing_is_complete() -> None:
    """Protects against an estimate of a map that nobody has: no chunk, or a place beyond all that can be mapped."""
    surveyor = Surveyor(0.1, REACH)
    surveyor.update(MapSnapshot(0.1, 0, np.zeros((0, 3), np.int32), np.zeros((0, 4096), np.uint8)))
    for place in ((0.0, 0.0, 1.5), (1e12, 0.0, 1.5)):
        found = surveyor.survey(place)
        assert found.completeness == 0.0
        assert not found.word(REACH).has_room
        assert found.reachable_m2 == found.free_m2 <= math.pi * (REACH.critical_margin_m + 0.1) ** 2
