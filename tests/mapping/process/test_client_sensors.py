"""Several cameras and a planar scanner in front of one map."""

from __future__ import annotations

import math
import os
import signal

import numpy as np

from companion.config.mapping import MapSettings
from companion.mapping import VoxelMap
from companion.mapping.process.client import MapClient
from companion.model import MOST_RAYS, DepthFrame, PlanarScan
from tests.mapping.process.workers import CAMERA, HIGH_M, LOW_M, child_of, give, images, mapper
from tests.mapping.voxels import scenes
from tests.shared.beside import until

BACK = scenes.camera(40, 30, mount_yaw_rad=math.pi)
AT = scenes.pose(0.0, 0.0, 1.5)


def behind() -> DepthFrame:
    """What a smaller camera sees that looks back."""
    return scenes.frame(BACK, AT, scenes.room_depth(BACK, AT, LOW_M, HIGH_M))


def scan(rays: int = 90, **changes: float) -> PlanarScan:
    """One turn in the middle of the room, in which the nearest wall is 3 m away."""
    bearings_rad = np.linspace(-math.pi, math.pi, rays, endpoint=False)
    return PlanarScan(0.0, bearings_rad, np.full(rays, changes.get("range_m", 2.5)), 8.0, AT)


async def test_two_cameras_and_a_scanner_make_one_map() -> None:
    """Protects from a map that knows one size of image, and the slow sensors from a fast one."""
    frames = images(4)
    here = VoxelMap(MapSettings())
    for frame in (*frames, behind()):
        here.integrate(frame)
    here.integrate_scan(scan())

    async def fly() -> None:
        async with mapper(cameras=(CAMERA, BACK)) as maps:
            await give(maps, frames)
            assert maps.offer(behind(), source=1)
            await until(lambda: maps.status.frames == 5, "the other camera's")
            assert maps.offer_scan(scan())
            await until(lambda: maps.status.scans == 1, "the scan")
            await until(lambda: maps.status.occupied == here.counts().occupied, "as many voxels as here")
            assert not maps.offer(frames[0], source=1), "not the size of that camera"
            assert not maps.offer_scan(scan(rays=MOST_RAYS + 1))
            assert maps.offer_scan(PlanarScan(0.0, scan().bearings_rad, scan().ranges_m, 8.0, scenes.pose(math.nan)))
            await until(lambda: maps.status.refused == 3, "refused")
            assert (maps.status.frames, maps.status.scans) == (5, 1)
            assert 0.0 < maps.status.frame_ms < 1000.0
            assert maps.status.memory_bytes > 100_000
            await flood(maps, frames[0])

    async def flood(maps: MapClient, frame: DepthFrame) -> None:
        """One camera's images only, as fast as can be: the others keep their room, and drops are counted."""
        before = maps.status.dropped
        os.kill(child_of(maps), signal.SIGSTOP)
        try:
            for _ in range(50):
                maps.offer(frame)
            assert maps.status.dropped == before + 47
            assert maps.offer(behind(), source=1)
            assert [maps.offer_scan(scan()) for _ in range(5)] == [True] * 3 + [False] * 2
            assert maps.status.dropped == before + 49
        finally:
            os.kill(child_of(maps), signal.SIGCONT)
        await until(lambda: (maps.status.frames, maps.status.scans) == (9, 4), "those that were taken")

    await fly()


def test_a_camera_s_word_for_nothing_frees_nothing() -> None:
    """Protects from a wall that is flown through: 65.535 m of a 16-bit camera is no look into the distance."""
    free, said_nothing = VoxelMap(MapSettings()), VoxelMap(MapSettings(saturated_m=65.535))
    for voxels in (free, said_nothing):
        voxels.integrate(scenes.frame(CAMERA, AT, 65.535))
        voxels.integrate_scan(scan(range_m=65.535))
    assert len(free.snapshot().free()) > 1000
    assert len(said_nothing.snapshot().free()) == 0
    said_nothing.integrate(scenes.frame(CAMERA, AT, 65.53))
    assert len(said_nothing.snapshot().free()) > 1000, "only what is at the limit says nothing"
