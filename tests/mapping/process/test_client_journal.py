"""The map's process and its journal: killed, without room on the disk, without memory, and started again."""

from __future__ import annotations

import asyncio
import errno
import logging
import os
import resource
import signal
from pathlib import Path

import numpy as np
import pytest

from companion.config.mapping import MapSettings
from companion.errors import InputError
from companion.mapping import VoxelMap
from companion.mapping.journal import JOURNAL_NAME, Journal
from companion.mapping.process import supervisor
from companion.mapping.process.client import MapError
from companion.mapping.process.journaled_map import BYTES_PER_MB, JournaledMap, disk_problem
from companion.mapping.voxels.piece import MapSource
from companion.model import DepthFrame
from tests.mapping.process.workers import CAMERA, child_of, give, images, mapper
from tests.mapping.voxels import scenes
from tests.shared.beside import until


def here(frames: list[DepthFrame]) -> VoxelMap:
    """The map of these images, made in this process."""
    voxels = VoxelMap(MapSettings())
    for frame in frames:
        voxels.integrate(frame)
    return voxels


def contents(source: MapSource) -> dict[tuple[int, ...], bytes]:
    """Every chunk with something in it, to be compared."""
    found: dict[tuple[int, ...], bytes] = {}
    for piece in source.pieces():
        for chunk, values in zip(piece.chunks.tolist(), piece.values, strict=True):
            found[tuple(chunk)] = values.tobytes()
    nothing = np.full(4096, -32768, np.int16).tobytes()
    return {chunk: values for chunk, values in found.items() if values != nothing}


def kept(folder: Path) -> dict[tuple[int, ...], bytes]:
    """What the journal in a mission's folder holds."""
    with Journal.read_only(folder / JOURNAL_NAME) as journal:
        return contents(journal)


async def test_a_killed_process_goes_on_with_its_journal(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Protects the map from the death of its process, at rest and while it writes: little is lost, and counted."""
    monkeypatch.setattr(supervisor, "REST_S", 0.01)
    settings = MapSettings(journal_period_s=0.1)
    frames = images(16)

    async with mapper(tmp_path, settings=settings) as maps:
        await give(maps, frames[:8])
        await until(lambda: kept(tmp_path) == contents(here(frames[:8])), "kept, all by itself")
        await asyncio.sleep(0.6)  # and reported
        os.kill(child_of(maps), signal.SIGKILL)
        await until(lambda: not maps.status.alive, "noticed")
        assert (maps.status.frames, maps.status.lost) == (8, 0)
        assert kept(tmp_path) == contents(here(frames[:8]))
        await until(lambda: maps.status.alive, "started again")
        assert maps.status.restarts == 1
        assert maps.status.resumed_chunks >= len(contents(here(frames[:8])))
        # And now in the middle of it, with the disk at work all the time.
        for frame in [*frames, *frames]:
            await until(lambda frame=frame: maps.offer(frame), "taken")  # type: ignore[misc]
        taken, dropped = maps.status.frames, maps.status.dropped
        assert taken > 8
        os.kill(child_of(maps), signal.SIGKILL)
        await until(lambda: not maps.status.alive, "noticed")
        status = maps.status
        assert status.frames + status.lost >= taken, "an image is neither in the map nor lost"
        assert status.frames + status.lost + status.dropped - dropped == 8 + 2 * len(frames)
        await until(lambda: maps.status.alive, "started again")
        assert maps.status.resumed_chunks >= len(contents(here(frames[:8])))
        # Whatever was lost, it is seen again.
        await give(maps, frames)
        assert maps.status.lost == status.lost
    assert kept(tmp_path).keys() == contents(here(frames)).keys()


async def test_a_full_disk_is_told_and_what_was_missed_is_written_later(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Protects a flight from a full disk: the map goes on in memory, says so once, and loses nothing."""
    frames = images(12)

    async with mapper(tmp_path) as maps:
        await give(maps, frames[:2])
        await until(lambda: maps.status.journal_bytes > 10_000, "kept")
        pid = child_of(maps)
        limit = resource.prlimit(pid, resource.RLIMIT_FSIZE, (4096, resource.RLIM_INFINITY))
        await give(maps, frames[2:6])
        await until(lambda: bool(maps.status.problem), "told")
        assert maps.status.problem.startswith("disk full, in memory only: make room")
        await give(maps, frames[6:9])
        assert maps.status.alive
        with pytest.raises(MapError, match=r"cannot write the map to .*disk full"):
            await maps.save()
        # Tried several times meanwhile: it must be said once.
        await asyncio.sleep(0.7)
        assert sum(record.levelno == logging.ERROR for record in caplog.records) == 1
        resource.prlimit(pid, resource.RLIMIT_FSIZE, limit)
        await until(lambda: not maps.status.problem, "room again")
        assert maps.status.frames == 9
        await give(maps, frames[9:])
    assert maps.status.lost == 0
    assert kept(tmp_path) == contents(here(frames))


@pytest.mark.long
async def test_files_are_written_beside_the_map(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Protects images that come while a map is saved, and the map when a file fails or its process is dead."""
    monkeypatch.setattr(supervisor, "RESTARTS", 0)
    frames = images(9)

    async def fly() -> list[Path]:
        async with mapper(tmp_path) as maps:
            await give(maps, frames[:3])
            (tmp_path / "map.ply" / "in-the-way").mkdir(parents=True)
            with pytest.raises(
                MapError, match=r"cannot write the map to .* its journal \(map\.journal\) has everything"
            ):
                await maps.save()
            (tmp_path / "map.ply" / "in-the-way").rmdir()
            (tmp_path / "map.ply").rmdir()
            saving = asyncio.create_task(maps.save())
            await asyncio.sleep(0.1)
            await give(maps, frames[3:])
            assert not saving.done(), "the files took no time: nothing is shown"
            assert await saving
            await until(lambda: kept(tmp_path) == contents(here(frames)), "kept, all by itself")
            os.kill(child_of(maps), signal.SIGKILL)
            await until(lambda: not maps.status.alive, "noticed")
            return await maps.save()

    paths = await fly()
    assert kept(tmp_path) == contents(here(frames))
    ply = next(path for path in paths if path.name == "map.ply").read_bytes()
    assert f"element vertex {here(frames).counts().occupied}\n".encode() in ply


async def test_a_map_is_resumed_only_when_that_is_asked_for(tmp_path: Path) -> None:
    """Protects two missions from becoming one map by accident: another start of the autopilot has another origin."""
    frames = images(6)
    flight = tmp_path / "flight"

    async def fly(resume: bool, settings: MapSettings) -> None:
        async with mapper(flight, resume=resume, settings=settings):
            pytest.fail("started with a map that it must not touch")

    with pytest.raises(InputError, match=r"no map can be resumed in .*flight: it holds no map\.journal"):
        await fly(True, MapSettings())
    with JournaledMap(MapSettings(), flight / JOURNAL_NAME) as first:
        for frame in frames[:3]:
            first.integrate(frame)
    with pytest.raises(InputError, match="holds the map of another flight: resume it"):
        await fly(False, MapSettings())
    with pytest.raises(MapError, match=r"another map: voxel_m is 0\.2, not 0\.1"):
        await fly(True, MapSettings(voxel_m=0.2))
    with JournaledMap(MapSettings(), flight / JOURNAL_NAME) as second:
        for frame in frames[3:]:
            second.integrate(frame)
    assert kept(flight) == contents(here(frames))


def corridor(count: int) -> list[DepthFrame]:
    """A flight along a straight corridor, 5 m from image to image."""
    low_m, high_m = np.array([-2.0, -3.0, 0.0]), np.array([5.0 * count + 2.0, 3.0, 3.0])
    poses = [scenes.pose(5.0 * n, 0.0, 1.5) for n in range(count)]
    return [scenes.frame(CAMERA, at, scenes.room_depth(CAMERA, at, low_m, high_m)) for at in poses]


def test_a_map_larger_than_its_memory_is_whole(tmp_path: Path) -> None:
    """Protects a long tunnel on a small computer: what has no room in memory is in the journal, and comes back."""
    settings = MapSettings(voxel_m=0.05).model_copy(update={"memory_mb": 4})
    frames = corridor(24)
    whole = VoxelMap(settings)
    for frame in frames:
        whole.integrate(frame)
    assert whole.memory_bytes > 2 * 4 * BYTES_PER_MB, "it would fit: this test shows nothing"
    with JournaledMap(settings, tmp_path / JOURNAL_NAME) as voxels:
        for n, frame in enumerate(frames):
            voxels.integrate(frame)
            voxels.turn(float(n))
            assert voxels.keep() == ""
        assert voxels.chunks_in_memory < voxels.chunks / 2, "nothing was dropped"
    assert kept(tmp_path) == contents(whole)


def test_what_the_disk_does_not_take_has_a_bound_too(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Protects the computer from a map that eats all its memory because the disk is full: images are refused then."""
    settings = MapSettings(voxel_m=0.05).model_copy(update={"memory_mb": 4})

    def full(_self: Journal, _piece: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with JournaledMap(settings, tmp_path / JOURNAL_NAME) as voxels:
        with monkeypatch.context() as disk:
            disk.setattr(Journal, "append", full)
            taken = []
            for n, frame in enumerate(corridor(60)):
                taken.append(not voxels.is_full)
                if taken[-1]:
                    voxels.integrate(frame)
                voxels.turn(float(n))
            assert taken[0]
            assert not any(taken[-10:])
            assert voxels.problem.startswith("disk full")
            assert voxels.memory_bytes < 3 * 4 * BYTES_PER_MB
        assert voxels.keep() == ""
        assert not voxels.is_full, "room again"
        assert voxels.kept_frames == sum(taken)


def test_the_disk_s_error_says_what_to_do() -> None:
    """Protects the pilot, who sees 50 letters of it, from an errno."""
    full, broken = OSError(errno.ENOSPC, "No space left on device"), OSError(errno.EIO, "bad")
    assert disk_problem(full) == "disk full, in memory only: make room (No space left on device)"
    assert disk_problem(broken) == "disk fails, in memory only: check it (bad)"
