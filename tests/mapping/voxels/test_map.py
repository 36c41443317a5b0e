"""The map as a container: growing, asking, merging, telling what changed; and settings that make none."""

from __future__ import annotations

import math
import pickle
from dataclasses import replace
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from companion.config.load import load_settings
from companion.config.mapping import MapSettings
from companion.config.show import dump_yaml
from companion.mapping import FREE, OCCUPIED, UNKNOWN, MapSnapshot, VoxelMap
from companion.mapping.voxels.chunk_table import Store, find_row, forget_rows, has_room, keep_row, next_row
from companion.mapping.voxels.chunks import OFFSETS, place_of
from companion.mapping.voxels.depth_image import clear_depth
from companion.mapping.voxels.marks import mark_hits
from companion.mapping.voxels.sensor_model import steps_of
from companion.mapping.voxels.update import update_chunks
from companion.model import DepthFrame, Pose
from tests.mapping.voxels.scenes import EXACT, camera, contents, frame, pose, room_depth, voxel_numbers

ROOM = np.array([-3.03, -2.51, -1.27]), np.array([4.13, 2.27, 1.61])


def view(x_m: float, yaw: float) -> DepthFrame:
    """A frame of the room from somewhere on its long axis."""
    cam, at = camera(40, 30), pose(x_m, 0.1, 0.05, yaw=yaw)
    return frame(cam, at, room_depth(cam, at, *ROOM))


def mapped(*frames: DepthFrame) -> VoxelMap:
    """A map of these frames, with OctoMap's sensor model."""
    voxels = VoxelMap(EXACT)
    for one in frames:
        voxels.integrate(one)
    return voxels


views = st.builds(view, st.floats(-2.0, 3.0), st.floats(-3.1, 3.1))


@settings(max_examples=20, deadline=None)
@given(views, views)
def test_order_does_not_matter(first: DepthFrame, second: DepthFrame) -> None:
    """Protects from any dependence on the order in which chunks are made. Two looks reach no clamp, so sums commute."""
    assert contents(mapped(first, second)) == contents(mapped(second, first))


@settings(max_examples=20, deadline=None)
@given(views, views)
def test_merging_commutes_and_adds(first: DepthFrame, second: DepthFrame) -> None:
    """Protects several vehicles: who merges whom must not matter, and two maps say what one map of both would."""
    ab, ba = mapped(first), mapped(second)
    ab.merge(mapped(second))
    ba.merge(mapped(first))
    assert contents(ab) == contents(ba) == contents(mapped(first, second))


def test_merging_changes_only_the_receiver_and_keeps_the_clamps() -> None:
    """Protects the vehicle whose map is merged into another's, and bounds certainty: a merged map can still learn."""
    wall = frame(camera(40, 30), pose(), 2.05)
    ours, theirs = mapped(*[wall] * 20), mapped(*[wall] * 20)
    before = contents(theirs)
    ours.merge(theirs)
    assert contents(theirs) == before
    gone = frame(camera(40, 30), pose(), 4.05)
    # Nine looks from the upper clamp, as without the merge; log-odds of twice that would take eighteen.
    for _ in range(9):
        ours.integrate(gone)
    assert ours.classify(np.array([[2.05, 0.04, 0.04]])) == [FREE]


def test_merging_an_empty_map_changes_nothing() -> None:
    """Protects the first seconds of a second vehicle."""
    voxels = mapped(view(0.0, 0.0))
    before = contents(voxels)
    voxels.merge(VoxelMap(EXACT))
    assert contents(voxels) == before
    empty = VoxelMap(EXACT)
    empty.merge(voxels)
    assert contents(empty) == before


def test_merging_other_voxels_is_refused() -> None:
    """Protects from voxels that mean different places."""
    with pytest.raises(ValueError, match=r"voxels of 0\.2 m into one of 0\.1 m"):
        VoxelMap(EXACT).merge(VoxelMap(EXACT.model_copy(update={"voxel_m": 0.2})))


@settings(max_examples=20, deadline=None)
@given(views, st.integers(0, 2**32 - 1))
def test_occupied_near_is_the_27_voxels_around(one: DepthFrame, seed: int) -> None:
    """Protects the test of completeness (METHOD), against comparing each point with each occupied voxel."""
    voxels = mapped(one)
    points = np.random.default_rng(seed).uniform(-4.5, 4.5, (300, 3))
    occupied = voxel_numbers(voxels.occupied(), EXACT.voxel_m)
    apart = np.abs(voxel_numbers(points, EXACT.voxel_m)[:, np.newaxis] - occupied[np.newaxis]).max(axis=2)
    assert (voxels.occupied_near(points) == (apart <= 1).any(axis=1)).all()


def test_lists_and_classes_agree() -> None:
    """Protects the three ways to ask: what is listed as occupied or free is classified so, and nothing is left out."""
    voxels = mapped(view(0.0, 0.4), view(1.0, 2.0))
    occupied, free, counts = voxels.occupied(), voxels.free(), voxels.counts()
    assert (voxels.classify(occupied) == OCCUPIED).all()
    assert (voxels.classify(free) == FREE).all()
    assert (counts.occupied, counts.free) == (len(occupied), len(free))
    assert len(np.unique(np.concatenate([occupied, free]), axis=0)) == len(occupied) + len(free)
    everywhere = np.stack(np.meshgrid(*[np.arange(-60, 60)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    states = voxels.classify((everywhere + 0.5) * EXACT.voxel_m)
    assert np.count_nonzero(states == OCCUPIED) == len(occupied)
    assert np.count_nonzero(states == FREE) == len(free)


def test_points_that_are_no_points_are_refused() -> None:
    """Protects from answers about NaN, which would be UNKNOWN or anything else."""
    with pytest.raises(ValueError, match="not finite"):
        VoxelMap(EXACT).classify(np.array([[0.0, np.nan, 0.0]]))
    with pytest.raises(ValueError, match=r"\(2,\), not \(n, 3\)"):
        VoxelMap(EXACT).occupied_near(np.zeros(2))
    assert len(VoxelMap(EXACT).classify(np.zeros((0, 3)))) == 0


def test_points_of_single_precision_are_taken() -> None:
    """Protects samples that come from Open3D, which are float32."""
    voxels = mapped(view(0.0, 0.0))
    centres = voxels.occupied()
    assert (voxels.classify(centres.astype(np.float32)) == OCCUPIED).all()
    assert voxels.occupied_near(centres.astype(np.float32)).all()


def test_any_kind_of_image_is_taken_without_compiling_anew() -> None:
    """Protects a flight from a pause of many seconds: read-only, strided and float64 images, and whole numbers.

    Images from another process's memory are read-only; a camera may come from a file that says 10 instead of 10.0.
    """
    cam = camera(40, 30)
    whole = replace(cam, fx_px=20, fy_px=20, max_range_m=10, min_range_m=0, mount_x_m=0)
    plain = np.full((30, 40), 2.05, np.float32)
    frozen = plain.copy()
    frozen.setflags(write=False)
    wide = np.full((60, 80), 2.05, np.float32)[::2, ::2]
    voxels = VoxelMap(EXACT)
    voxels.integrate(DepthFrame(0.0, plain, cam, pose()))
    compiled = [len(function.signatures) for function in (mark_hits, clear_depth, update_chunks)]
    for depth in (frozen, wide, np.asfortranarray(plain), plain.astype(np.float64)):
        report = voxels.integrate(DepthFrame(0.0, depth, whole, Pose(0, 0, 0, 0, 0)))  # type: ignore[arg-type]
        assert report.pixels_hit == 30 * 40
    assert [len(function.signatures) for function in (mark_hits, clear_depth, update_chunks)] == compiled


def test_the_table_grows_without_losing_anything() -> None:
    """Protects growth in the middle of a frame: small voxels fill the first table many times over."""
    small = EXACT.model_copy(update={"voxel_m": 0.02})
    voxels = VoxelMap(small)
    memory = voxels.memory_bytes
    report = voxels.integrate(frame(camera(40, 30), pose(0.003, 0.003, 0.003), 2.005))
    # Seen are 2 x 3 x 4 m / 3, in chunks of 0.32 m: 120 whole ones and those at the rim.
    assert report.chunks_new > 128
    assert voxels.memory_bytes > memory
    assert (report.hits, report.misses) == (voxels.counts().occupied, voxels.counts().free)
    # Volume of the pyramid up to the wall: base (2 x 2) (2 x 1.5), height 2, less what the rim of the image costs.
    assert len(voxels.free()) * 0.02**3 == pytest.approx(4.0 * 3.0 * 2.0 / 3.0, rel=0.03)


@settings(max_examples=50, deadline=None)
@given(st.sets(st.tuples(*[st.integers(-(2**20), 2**20 - 1)] * 3), max_size=60), st.randoms(use_true_random=False))
def test_each_chunk_has_its_own_row(coordinates: set[tuple[int, int, int]], random: Random) -> None:
    """Protects the hash table: keys are unique over the whole grid, and neither growing nor forgetting loses a row."""
    store = Store(4)
    for number, (x, y, z) in enumerate(sorted(coordinates)):
        assert find_row(store.table, x, y, z) == -1
        if not has_room(store.table):
            store.grow()
        assert next_row(store.table, x, y, z) == number
        keep_row(store.table)
    for number, (x, y, z) in enumerate(sorted(coordinates)):
        assert find_row(store.table, x, y, z) == number
    gone = [one for one in sorted(coordinates) if random.random() < 0.5]
    forget_rows(store.table, np.array(gone, np.int32).reshape(-1, 3))
    assert store.chunks == len(coordinates) - len(gone)
    for x, y, z in coordinates:
        row = find_row(store.table, x, y, z)
        assert row == -1 if (x, y, z) in gone else tuple(store.table.coords[row]) == (x, y, z)


def test_places_are_in_morton_order() -> None:
    """Protects the one layout that bit sets, snapshots and the OctoMap file share."""
    places = [place_of(int(x), int(y), int(z)) for x, y, z in OFFSETS]
    assert places == list(range(4096))
    assert [place_of(*c) for c in [(1, 0, 0), (0, 1, 0), (0, 0, 1), (2, 0, 0), (3, 3, 3)]] == [1, 2, 4, 8, 63]


def test_a_snapshot_holds_what_changed_since() -> None:
    """Protects the way to the ground station: differences, put together, are the map."""
    voxels = VoxelMap(EXACT)
    known: dict[tuple[int, ...], bytes] = {}
    revision = 0
    for yaw in (0.0, 2.0, -2.0):
        voxels.integrate(view(0.0, yaw))
        difference = voxels.snapshot(since=revision)
        known |= contents(difference)
        assert revision < difference.revision
        revision = difference.revision
    assert known == contents(voxels.snapshot())
    assert len(difference.chunks) < len(voxels.snapshot().chunks)
    assert len(voxels.snapshot(since=revision).chunks) == 0


def test_a_snapshot_is_a_copy_that_travels() -> None:
    """Protects the move to a process of its own: what was handed out does not change, and can be pickled."""
    voxels = mapped(view(0.0, 0.0))
    snapshot = voxels.snapshot()
    before = contents(snapshot)
    voxels.integrate(view(0.0, 2.0))
    assert contents(snapshot) == before
    there: MapSnapshot = pickle.loads(pickle.dumps(snapshot))  # noqa: S301
    assert contents(there) == before
    assert (there.occupied() == snapshot.occupied()).all()
    assert np.count_nonzero(there.states == UNKNOWN) > 0


# Settings of the map that would make a map which means nothing are refused, with the number and the bound.


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"voxel_m": 0.01}, "greater than or equal to 0.02"),
        ({"voxel_m": math.nan}, "finite"),
        ({"max_range_m": 31.0}, "less than or equal to 30"),
        ({"hit_probability": 0.5}, "mapping.hit_probability = 0.5 must be above 0.5"),
        ({"miss_probability": 0.5}, "mapping.miss_probability = 0.5 must be below 0.5"),
        ({"clamp_min_probability": 0.6}, "mapping.clamp_min_probability = 0.6 must be below 0.5"),
        ({"clamp_max_probability": 0.7}, "= 0.7 must be above mapping.occupied_probability = 0.7"),
        ({"occupied_probability": 0.49}, "greater than or equal to 0.5"),
        ({"voxel_size": 0.1}, "Extra inputs are not permitted"),
        ({"model": "octo"}, "'robust' or 'octomap'"),
        ({"model": "octomap", "clamp_max_probability": 0.5}, "= 0.5 must be above mapping.occupied_probability = 0.5"),
        ({"saturated_m": 5.9}, "mapping.saturated_m = 5.9 m must be at least mapping.max_range_m = 6 m"),
        ({"memory_mb": 63}, "greater than or equal to 64"),
        ({"journal_period_s": 0.05}, "greater than or equal to 0.1"),
        ({"journal_period_s": 11.0}, "less than or equal to 10"),
    ],
)
def test_refused(wrong: dict[str, Any], message: str) -> None:
    """Protects from a map that no look could change: each message names the value and the bound."""
    with pytest.raises(ValidationError) as refusal:
        MapSettings(**wrong)
    assert message in str(refusal.value)


def test_settings_do_not_change() -> None:
    """Protects a map from settings that change while it is built."""
    with pytest.raises(ValidationError, match="frozen"):
        MapSettings().voxel_m = 0.2  # type: ignore[misc]


def test_every_setting_is_described() -> None:
    """Protects the page of settings, which is made from the descriptions."""
    assert all(field.description for field in MapSettings.model_fields.values())


def test_the_octomap_model_is_octomap_s() -> None:
    """Protects comparisons with OctoMap: the numbers are those of its OcTree, whatever ours become."""
    model = MapSettings(model="octomap")
    assert (model.hit_probability, model.miss_probability) == (0.7, 0.4)
    assert (model.clamp_min_probability, model.clamp_max_probability) == (0.1192, 0.971)
    assert (model.occupied_probability, model.margin_m) == (0.5, 0.0)
    steps = steps_of(model)
    # OctoMap's log-odds: 0.85, -0.4, clamps of -2 and 3.5, and occupied from 0 on. Its hits count alike at every depth.
    assert set(steps.hits.tolist()) == {847}
    assert (steps.miss, steps.lowest, steps.highest, steps.threshold) == (-405, -2000, 3511, 0)


def test_a_key_that_is_given_is_not_the_model_s(tmp_path: Path) -> None:
    """Protects who compares with OctoMap at another threshold, and settings.yaml, which has to give the same map."""
    file = tmp_path / "settings.yaml"
    file.write_text("mapping: {model: octomap, occupied_probability: 0.6}", encoding="utf-8")
    settings = load_settings(file)
    assert (settings.mapping.occupied_probability, settings.mapping.clamp_max_probability) == (0.6, 0.971)
    file.write_text(dump_yaml(settings), encoding="utf-8")
    assert load_settings(file).mapping == settings.mapping
    assert MapSettings().occupied_probability == 0.7, "the robust model is the default"
