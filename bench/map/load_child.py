"""The application of `bench.map.load`: the one that flies, with one map or another in the place of its own."""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import json
import os
import signal
import sys
import time
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Self

import numpy as np

from companion.flight import __main__ as application
from companion.flight import mission
from companion.flight.tasks import background
from companion.gate.runtime.processes import end_with_parent
from companion.mapping.process.client import MapClient
from companion.mapping.process.messages import MapStatus
from companion.mapping.process.supervisor import MAP_NICENESS, ignore_the_terminal
from companion.model import DepthFrame

FEED_PERIOD_S, FEED_TURN_RAD = 0.005, 0.3
OFFERS, MAP = "BENCH_MAP_LOAD_OFFERS", "BENCH_MAP_LOAD_MAP"
"""In the environment of the application."""


class OfferedMap(MapClient):
    """The map of the application as it is, with a stopwatch on `offer`."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.took_s: list[float] = []

    def offer(self, frame: DepthFrame, source: int = 0) -> bool:
        """As of the base, timed where the image was taken."""
        began_s = time.perf_counter()
        taken = super().offer(frame, source)
        if taken:
            self.took_s.append(time.perf_counter() - began_s)
        return taken

    async def __aexit__(self, *how: object) -> None:
        """As of the base; then the times go to the file that the environment names."""
        await super().__aexit__(*how)
        self._write()

    def _write(self) -> None:
        Path(os.environ[OFFERS]).write_text(json.dumps(self.took_s), encoding="ascii")


class NoMap(OfferedMap):
    """In its place: takes nothing, and is always well."""

    async def __aenter__(self) -> Self:
        """Nothing is started."""
        return self

    @property
    def status(self) -> MapStatus:
        """Of an empty map that has just been heard."""
        return dataclasses.replace(super().status, age_s=0.0, alive=True, problem="")

    def offer(self, frame: DepthFrame, source: int = 0) -> bool:  # noqa: ARG002 - as the map has it
        """No."""
        return False

    async def save(self) -> list[Path]:
        """There is nothing."""
        return []


class BusyMap(NoMap):
    """In its place: a process of the same priority that only computes, and more than any map does."""

    async def __aenter__(self) -> Self:
        """Start it."""
        self._stranger = get_context("spawn").Process(target=burn, daemon=True)
        self._stranger.start()
        return await super().__aenter__()

    async def __aexit__(self, *how: object) -> None:
        """End it."""
        await super().__aexit__(*how)
        self._stranger.kill()
        self._stranger.join()


def burn() -> None:
    """Use all of a processor that nobody else wants."""
    ignore_the_terminal()
    end_with_parent(signal.SIGKILL)
    os.nice(MAP_NICENESS)
    while True:
        pass


class FullMap(OfferedMap):
    """In its place: the same with more images than any camera gives."""

    _newest: DepthFrame | None = None
    _feeding: contextlib.AsyncExitStack

    async def __aenter__(self) -> Self:
        """Start the map, then feed it."""
        await super().__aenter__()
        self._feeding = contextlib.AsyncExitStack()
        await self._feeding.enter_async_context(background(self._feed()))
        return self

    async def __aexit__(self, *how: object) -> None:
        """Stop feeding first."""
        await self._feeding.aclose()
        await super().__aexit__(*how)

    def offer(self, frame: DepthFrame, source: int = 0) -> bool:
        """And remember it."""
        self._newest = frame
        return super().offer(frame, source)

    async def save(self) -> list[Path]:
        """The images that follow would only be in the way."""
        self._newest = None
        await self._feeding.aclose()
        return await super().save()

    async def _feed(self) -> None:
        rng = np.random.default_rng(1)
        while True:
            await asyncio.sleep(FEED_PERIOD_S)
            newest, taken = self._newest, True
            while newest is not None and taken:
                turn_rad = float(rng.uniform(-FEED_TURN_RAD, FEED_TURN_RAD))
                pose = dataclasses.replace(newest.pose, yaw_rad=newest.pose.yaw_rad + turn_rad)
                taken = super().offer(dataclasses.replace(newest, pose=pose))


MAPS = {"off": NoMap, "busy": BusyMap, "camera": OfferedMap, "full": FullMap}


def fly() -> int:
    """Be the application, with the map that the environment names."""
    setattr(mission, "MapClient", MAPS[os.environ[MAP]])  # noqa: B010 - a plain assignment is none that types allow
    return application.main(sys.argv[1:])


if __name__ == "__main__":
    raise SystemExit(fly())
