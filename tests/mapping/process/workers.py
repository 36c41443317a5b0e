"""Maps in processes of their own, for the tests that need one."""

from __future__ import annotations

import dataclasses
import math
import os
from pathlib import Path
from typing import Any

import numpy as np

from companion.config.control import ControlSettings
from companion.config.mapping import MapSettings
from companion.mapping.process.client import MapClient
from companion.model import DepthFrame
from tests.mapping.voxels import scenes
from tests.shared.beside import until

CAMERA = scenes.camera(80, 60)
LOW_M, HIGH_M = np.array([-4.0, -3.0, 0.0]), np.array([4.0, 3.0, 3.0])


def images(count: int = 12) -> list[DepthFrame]:
    """One turn on the spot in a closed room."""
    frames = []
    for n in range(count):
        at = scenes.pose(0.0, 0.0, 1.5, yaw=2.0 * math.pi * n / count)
        image = scenes.frame(CAMERA, at, scenes.room_depth(CAMERA, at, LOW_M, HIGH_M))
        frames.append(dataclasses.replace(image, t_s=0.2 * n))
    return frames


def mapper(folder: Path | None = None, **options: Any) -> MapClient:
    settings = options.pop("settings", MapSettings())
    return MapClient(settings, options.pop("cameras", (CAMERA,)), ControlSettings(), folder, **options)


async def give(maps: MapClient, frames: list[DepthFrame]) -> None:
    """Offer each frame until it is taken."""
    before = maps.status.frames
    for frame in frames:
        await until(lambda frame=frame: maps.offer(frame), "taken")  # type: ignore[misc]
    await until(lambda: maps.status.frames >= before + len(frames), "integrated")


def child_of(maps: MapClient) -> int:
    pid = maps._supervisor.pid
    assert pid is not None
    return pid


def gone(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    return Path(f"/proc/{pid}/stat").read_text(encoding="ascii").split()[2] == "Z"
