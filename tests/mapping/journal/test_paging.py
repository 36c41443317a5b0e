"""A map with a bound on its memory: it says what a map without one says."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import numpy as np
import pytest

from companion.config.mapping import MapSettings
from companion.mapping import VoxelMap
from companion.mapping.journal import Header, Journal
from companion.mapping.journal.paging import PagedMap
from companion.mapping.voxels.piece import MapPiece
from companion.model import DepthFrame, PlanarScan
from tests.mapping.journal.journals import Contents, held
from tests.mapping.voxels.scenes import camera, frame, pose, room_depth

pytestmark = pytest.mark.timeout(400)
"""Whichever comes first may have to compile the whole map, on a machine that is busy."""

SETTINGS = MapSettings(voxel_m=0.1, max_range_m=3.0)
HEADER = Header.of(SETTINGS)
CAMERA = camera(32, 24)
TUNNEL = np.array([-2.0, -1.5, -1.0]), np.array([90.0, 1.5, 1.2])
THERE = np.arange(0.0, 80.0, 1.0)
TIGHT_BYTES = 300_000


def look(x_m: float, turn: int = 0) -> DepthFrame:
    """What the camera sees in the tunnel, never twice from quite the same place."""
    at = pose(x_m + 0.013 * turn, 0.2 * np.sin(x_m), 0.1, yaw=0.9 * np.sin(0.7 * x_m + turn))
    return frame(CAMERA, at, room_depth(CAMERA, at, *TUNNEL))


def to_and_fro(turns: int = 2) -> list[DepthFrame]:
    """A flight along the tunnel and back."""
    return [look(x_m, turn) for turn in range(turns) for x_m in (THERE if turn % 2 == 0 else THERE[::-1])]


def known(contents: Contents) -> Contents:
    """Without chunks of which nothing is known."""
    nothing = np.full(4096, -32768, np.int16).tobytes()
    return {chunk: values for chunk, values in contents.items() if values != nothing}


def plain_map(frames: list[DepthFrame]) -> VoxelMap:
    """The map without a bound."""
    voxels = VoxelMap(SETTINGS)
    for one in frames:
        voxels.integrate(one)
    return voxels


def flown(paged: PagedMap, frames: list[DepthFrame]) -> list[int]:
    """Feed a map, flush it after every fifth frame; how many chunks were in memory at each time."""
    in_memory: list[int] = []
    for number, one in enumerate(frames):
        paged.integrate(one)
        if number % 5 == 4:
            paged.flush()
            in_memory.append(paged.chunks_in_memory)
    paged.flush()
    return in_memory


def test_it_says_what_a_map_without_a_bound_says(tmp_path: Path) -> None:
    """Protects every voxel while memory is short: chunks are dropped and brought back, and none is a bit different."""
    frames = to_and_fro(3)
    plain = plain_map(frames)
    with Journal.open(tmp_path, HEADER) as journal:
        paged = PagedMap(SETTINGS, journal, TIGHT_BYTES)
        in_memory = flown(paged, frames)
        assert max(in_memory) < 0.6 * paged.chunks
        assert known(held(paged)) == known(held(plain))
        points = np.random.default_rng(0).uniform([-4.0, -3.0, -3.0], [95.0, 3.0, 3.0], (20_000, 3))
        points[:2] = [[1e9, 0.0, 0.0], [-1e300, 1e300, 0.0]]
        assert np.array_equal(paged.classify(points), plain.classify(points))
        assert len(np.unique(plain.classify(points))) == 3
        asked = np.concatenate([plain.changed()[::3], [[500, 0, 0]]]).astype(np.int32)
        given = paged.piece(asked)
        assert known(_contents(given)) == known(_contents(plain.piece(asked)))
        assert np.array_equal(np.unique(paged.snapshot().states), [0, 1, 2])
        with pytest.raises(ValueError, match="not finite"):
            paged.classify(np.array([[np.nan, 0.0, 0.0]]))


def _contents(part: MapPiece) -> Contents:
    return {(x, y, z): values.tobytes() for (x, y, z), values in zip(part.chunks.tolist(), part.values, strict=True)}


def test_scans_and_frames_in_turn(tmp_path: Path) -> None:
    """Protects planar scanners, whose reach is another than the camera's: they too find what was dropped."""
    bearings = np.linspace(-np.pi, np.pi, 90, endpoint=False)
    plain = VoxelMap(SETTINGS)
    with Journal.open(tmp_path, HEADER) as journal:
        paged = PagedMap(SETTINGS, journal, TIGHT_BYTES)
        for number, one in enumerate(to_and_fro()):
            scan = PlanarScan(0.0, bearings, np.full(90, 2.2), 8.0, one.pose)
            for voxels in (plain, paged):
                voxels.integrate_scan(scan)
                if number % 3 == 0:
                    voxels.integrate(one)
            if number % 5 == 4:
                paged.flush()
        assert paged.chunks_in_memory < 0.6 * paged.chunks
        assert known(held(paged)) == known(held(plain))


def test_a_map_goes_on_where_it_ended(tmp_path: Path) -> None:
    """Protects a restart in flight: everything is there, nothing of it in memory, and later frames add to it."""
    frames = to_and_fro()
    with Journal.open(tmp_path, HEADER) as journal:
        flown(PagedMap(SETTINGS, journal, TIGHT_BYTES), frames[:100])
    with Journal.open(tmp_path, HEADER) as journal:
        paged = PagedMap(SETTINGS, journal, TIGHT_BYTES)
        assert paged.chunks_in_memory == 0
        before = plain_map(frames[:100])
        assert known(held(paged)) == known(held(before))
        assert set(map(tuple, paged.changed(0).tolist())) >= known(held(before)).keys()
        assert len(paged.changed(paged.revision)) == 0
        assert paged.flush().chunks == 0
        flown(paged, frames[100:])
        assert known(held(paged)) == known(held(plain_map(frames)))


def test_whoever_follows_sees_every_change(tmp_path: Path) -> None:
    """Protects frontiers and the live view: asking for what changed, now and then, gives the whole map in the end."""
    copy: Contents = {}
    since, told = 0, 0
    frames = to_and_fro(3)
    with Journal.open(tmp_path, HEADER) as journal:
        paged = PagedMap(SETTINGS, journal, TIGHT_BYTES)
        for number, one in enumerate(frames):
            paged.integrate(one)
            if number % 4 == 3:
                paged.flush()
            if number % 7 == 6:
                changed = paged.changed(since)
                since = paged.revision
                told += len(changed)
                copy.update(_contents(paged.piece(changed)))
        copy.update(_contents(paged.piece(paged.changed(since))))
        assert known(copy) == known(held(paged))
        assert told < 0.3 * paged.chunks * len(frames) / 7


def test_bringing_back_is_no_change(tmp_path: Path) -> None:
    """Protects the disk: a chunk that was only read back is neither written again nor told to who follows."""
    with Journal.open(tmp_path, HEADER) as journal:
        flown(PagedMap(SETTINGS, journal), to_and_fro(1))
        paged = PagedMap(SETTINGS, journal, TIGHT_BYTES)
        since = paged.revision
        nothing = frame(CAMERA, pose(40.0), np.nan)
        paged.integrate(nothing)
        assert paged.chunks_in_memory > 20
        assert len(paged.changed(since)) == 0
        assert paged.flush().chunks == 0


def test_frames_that_need_nothing_ask_for_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects the time of a frame: as long as the vehicle stays near, the journal is not looked at."""
    with Journal.open(tmp_path, HEADER) as journal:
        flown(PagedMap(SETTINGS, journal), to_and_fro(1))
        paged = PagedMap(SETTINGS, journal, TIGHT_BYTES)
        reads = 0
        real = Journal.read

        def read(self: Journal, chunks: np.ndarray) -> MapPiece:
            nonlocal reads
            reads += 1
            return real(self, chunks)

        monkeypatch.setattr(Journal, "read", read)
        paged.integrate(look(40.0))
        assert reads > 0
        before = reads
        for turn in range(50):
            paged.integrate(frame(CAMERA, pose(40.0 + 0.001 * turn, yaw=turn / 7.0), 2.0))
        assert reads == before


def test_what_is_near_or_not_written_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects the map on a full disk: it grows beyond its bound rather than lose anything, and shrinks afterwards."""
    frames = to_and_fro(1)
    real = os.pwrite

    def full(*_: object) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with Journal.open(tmp_path, HEADER) as journal:
        paged = PagedMap(SETTINGS, journal, memory_bytes=1)
        paged.integrate(frames[0])
        paged.flush()
        first = paged.chunks_in_memory
        assert paged.trim() == 0
        assert paged.chunks_in_memory == first > 0
        monkeypatch.setattr(os, "pwrite", full)
        for number, one in enumerate(frames[1:]):
            paged.integrate(one)
            if number % 5 == 4:
                with pytest.raises(OSError, match="No space"):
                    paged.flush()
        full_memory = paged.chunks_in_memory
        assert full_memory > 0.9 * paged.chunks - first
        monkeypatch.setattr(os, "pwrite", real)
        assert paged.flush().chunks > 0
        paged.trim()
        assert paged.chunks_in_memory < 0.6 * full_memory
        assert known(held(paged)) == known(held(plain_map(frames)))
    with Journal.read_only(tmp_path) as reader:
        assert known(held(reader)) == known(held(plain_map(frames)))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -1e300, 1e7])
def test_a_pose_that_is_nonsense_changes_nothing(tmp_path: Path, bad: float) -> None:
    """Protects from a broken estimate: the same error as from a plain map, and no step into nowhere."""
    with Journal.open(tmp_path, HEADER) as journal:
        paged = PagedMap(SETTINGS, journal, TIGHT_BYTES)
        paged.integrate(look(0.0))
        before = held(paged)
        for at in (pose(bad), pose(0.0, bad), pose(0.0, 0.0, bad)):
            with pytest.raises(ValueError, match=r"finite|outside"):
                paged.integrate(frame(CAMERA, at, 2.0))
        assert held(paged) == before


def test_without_a_journal_it_is_a_plain_map() -> None:
    """Protects callers that keep no journal: one class serves them too, without a bound, and nothing is written."""
    frames = to_and_fro(1)
    paged = PagedMap(SETTINGS, memory_bytes=1)
    for one in frames:
        paged.integrate(one)
    assert paged.flush().chunks == paged.trim() == 0
    assert held(paged) == held(plain_map(frames))
    points = np.random.default_rng(0).uniform(-5.0, 5.0, (1000, 3))
    assert np.array_equal(paged.classify(points), plain_map(frames).classify(points))


def test_a_journal_of_another_map_is_refused(tmp_path: Path) -> None:
    """Protects from voxels of two sizes in one map."""
    with Journal.open(tmp_path, HEADER) as journal, pytest.raises(ValueError, match=r"voxel_m is 0\.2, not 0\.1"):
        PagedMap(MapSettings(voxel_m=0.2), journal)
