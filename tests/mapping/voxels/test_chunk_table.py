"""Where voxels are kept: what needs memory, and what does not."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.mapping import VoxelMap
from companion.mapping.voxels.chunks import NOTHING
from companion.mapping.voxels.growing_array import GrowingArray
from companion.mapping.voxels.piece import MapPiece
from tests.mapping.voxels.scenes import EXACT, camera, contents, frame, pose

CHUNK = np.zeros((1, 3), np.int32)


def test_space_that_is_free_for_sure_needs_no_memory() -> None:
    """Protects long tunnels: what was flown through often enough costs 4 bytes for 64 voxels, not 128."""
    voxels = VoxelMap(EXACT)
    far = frame(camera(), pose(), 20.0)
    voxels.integrate(far)
    once = voxels.memory_bytes
    for _ in range(5):
        voxels.integrate(far)
    often = voxels.memory_bytes
    # From -0.41 to the clamp at -1.99 it takes five looks; then all voxels of a brick within the view are alike.
    assert voxels.counts().free > 50_000
    assert often <= once
    rim = voxels.piece(voxels.changed()).values.reshape(-1, 64)
    mixed = np.count_nonzero(rim.min(axis=1) != rim.max(axis=1))
    assert voxels._store._used[1] - voxels._store._used[2] == mixed


def test_what_changes_nothing_is_not_told() -> None:
    """Protects the journal and the link to the ground: hovering before a wall soon brings nothing new."""
    voxels = VoxelMap(EXACT)
    wall = frame(camera(), pose(), 3.05)
    for _ in range(10):
        report = voxels.integrate(wall)
    revision = voxels.revision
    report = voxels.integrate(wall)
    assert report.chunks_updated == 0
    assert len(voxels.changed(revision)) == 0
    assert report.hits > 0


values = st.lists(st.sampled_from([int(NOTHING), -1992, -405, 0, 847, 3476]), min_size=1, max_size=9)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.tuples(*[st.integers(-3, 3)] * 3), values, st.booleans()), max_size=12))
def test_chunks_come_back_as_they_were_put(steps: list[tuple[tuple[int, int, int], list[int], bool]]) -> None:
    """Protects everything that stands on `put`, `piece` and `drop`: paging, resuming, merging. Against a dictionary."""
    voxels = VoxelMap(EXACT)
    expected: dict[tuple[int, int, int], bytes] = {}
    for chunk, some, stays in steps:
        at = np.array([chunk], np.int32)
        # Some bricks are alike throughout and some are not.
        whole = np.repeat(np.resize(np.array(some, np.int16), 64), 64)
        whole[: 64 * len(some)] = np.resize(np.array(some, np.int16), 64 * len(some))
        voxels.put(MapPiece(at, whole[np.newaxis]))
        expected[chunk] = whole.tobytes()
        if not stays:
            voxels.drop(at)
            del expected[chunk]
    found = {
        tuple(at): held.tobytes()
        for piece in voxels.pieces(2)
        for at, held in zip(piece.chunks.tolist(), piece.values, strict=True)
    }
    assert found == expected


def test_what_was_dropped_is_used_anew() -> None:
    """Protects the memory of a flight that lasts: dropping and loading a thousand times takes what one chunk takes."""
    voxels = VoxelMap(EXACT)
    random = np.random.default_rng(1)
    piece = MapPiece(CHUNK, random.integers(-1992, 3476, (1, 4096)).astype(np.int16))
    voxels.put(piece)
    memory = voxels.memory_bytes
    for _ in range(1000):
        voxels.drop(CHUNK)
        voxels.put(piece)
    assert voxels.memory_bytes == memory
    assert (voxels.piece(CHUNK).values == piece.values).all()
    voxels.drop(CHUNK)
    assert contents(voxels) == {}


def test_memory_grows_in_place() -> None:
    """Protects from copies of a large map: what was there is there still, and new room is zero and costs nothing."""
    memory = GrowingArray(4, (64,), np.int16)
    memory.array[...] = 7
    memory.grow(1_000_000)
    assert memory.array.shape == (1_000_000, 64)
    assert (memory.array[:4] == 7).all()
    assert not memory.array[4:1000].any()
    held = memory.array
    memory.grow(2_000_000)
    memory.array[0] = 8
    assert (held[:4] == 7).all(), "who still looks at it sees what was there"
    assert (memory.array[1:4] == 7).all()


def test_no_more_memory_leaves_the_map_as_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects the map when memory ends in the middle of a frame: it can be asked and written, and goes on later."""
    voxels = VoxelMap(EXACT)
    random = np.random.default_rng(1)
    grow = GrowingArray.grow

    def refuse(*_: object) -> None:
        raise OSError(12, "Cannot allocate memory")

    full = MapPiece(
        np.stack([np.arange(600), np.zeros(600), np.zeros(600)], axis=1).astype(np.int32),
        random.integers(-1992, 3476, (600, 4096)).astype(np.int16),
    )
    monkeypatch.setattr(GrowingArray, "grow", refuse)
    with pytest.raises(OSError, match="allocate"):
        voxels.put(full)
    taken = voxels.counts().chunks
    assert 0 < taken < 600
    assert (voxels.piece(full.chunks[:taken]).values == full.values[:taken]).all()
    monkeypatch.setattr(GrowingArray, "grow", grow)
    voxels.put(full)
    assert (voxels.piece(full.chunks).values == full.values).all()
