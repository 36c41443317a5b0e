"""The application's end of the map in a process of its own, so that it never holds up the control tick.

Readings go over through shared memory, everything else through a pipe that is read when there is something in it: no
call here waits for the map. When the map is slower than the sensors, readings are dropped and counted.
"""

from __future__ import annotations

import asyncio
import logging
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np

from companion.clock import Clock, MonotonicClock
from companion.config.control import ControlSettings
from companion.config.mapping import MapSettings
from companion.control.left_out import LeftOut
from companion.errors import InputError
from companion.mapping.frontiers.frontier import Reach
from companion.mapping.journal import JOURNAL_NAME
from companion.mapping.process.export import SAVE_TIMEOUT_S, write_files
from companion.mapping.process.messages import (
    FromMap,
    Keep,
    Kept,
    MapError,
    MapStatus,
    Offered,
    OfferedFrame,
    OfferedScan,
    Ready,
    SlotRing,
    Taken,
)
from companion.mapping.process.supervisor import MapSupervisor
from companion.model import MOST_RAYS, Camera, DepthFrame, PlanarScan

STALE_S = 5.0
"""A process that has been silent for this long says nothing any more of whether the mission is done."""

MOST_CAMERAS = 8

Kind = Literal["frames", "scans"]

_log = logging.getLogger(__name__)


class Tally:
    """Counts over all processes of one map: each offer ends as in the map, dropped, refused or lost.

    Attributes:
        dropped: there was no room, or the process that had it died before it looked at it.
        refused: cannot be used.
        lost: were in the map of a process that died before they were on the disk.
    """

    def __init__(self) -> None:
        self.dropped = self.refused = self.lost = 0
        self._safe: Counter[Kind] = Counter()  # of processes that are gone
        self._used: Counter[Kind] = Counter()  # of this process
        self._kept: Counter[Kind] = Counter()  # of these, on the disk

    def used(self, kind: Kind) -> None:
        """One more is in the map."""
        self._used[kind] += 1

    def kept(self, frames: int, scans: int) -> None:
        """So many of what this process took are on the disk."""
        self._kept = Counter[Kind]({"frames": frames, "scans": scans})

    def died(self, waiting: int) -> int:
        """The process is gone with what was not on the disk, and with ``waiting`` that it had not looked at.

        Returns:
            How many are lost with it.
        """
        lost = self._used.total() - self._kept.total()
        self.lost += lost
        self.dropped += waiting
        self._safe += self._kept
        self._used.clear()
        self._kept.clear()
        return lost

    def in_map(self, kind: Kind) -> int:
        """How many are in the map."""
        return self._safe[kind] + self._used[kind]


class MapClient:
    """A map in another process; an asynchronous context manager.

    With a folder, the map is kept in ``map.journal`` there. When the process dies (killed, out of memory) it is started
    again, `supervisor.RESTARTS` times at most, **and goes on with what the journal holds**: all but the last second,
    which `MapStatus.lost` counts. Without a folder it begins anew, empty. A process that hangs is not replaced: the age
    of its status grows. It ignores Ctrl-C and ends when the application does, however that ends.

    Args:
        settings: of the map.
        cameras: that take the images; the first one looks ahead and says what can be seen of a frontier.
        control: height and margins, which say what the vehicle can reach.
        folder: where the journal is and `save` writes; None: nowhere.
        resume: go on with the journal that the folder holds; without it, a folder that holds one is refused.
        half_slab_m: what is this much above or below the centre of the vehicle is in its way.
        max_slope: steepest ground that it follows, rise over run.
        clock: for the age of the status.
    """

    def __init__(
        self,
        settings: MapSettings,
        cameras: Sequence[Camera],
        control: ControlSettings,
        folder: Path | None,
        *,
        resume: bool = False,
        half_slab_m: float = 0.4,
        max_slope: float = 0.7,
        clock: Clock | None = None,
    ) -> None:
        if not 1 <= len(cameras) <= MOST_CAMERAS:
            raise ValueError(f"a map takes 1 to {MOST_CAMERAS} cameras, not {len(cameras)}")
        self._settings = settings
        self._cameras = tuple(cameras)
        self._reach = Reach.of(settings, cameras[0], control, half_slab_m, max_slope)
        self._folder = folder
        self._resume = resume
        self._clock = clock or MonotonicClock()
        self._context = get_context("spawn")
        rings = [SlotRing(self._context, (camera.height_px, camera.width_px), np.float32) for camera in cameras]
        self._rings = (*rings, SlotRing(self._context, (2, MOST_RAYS), np.float64))
        journal = None if folder is None else folder / JOURNAL_NAME
        arguments = (self._rings, settings, self._cameras, self._reach, journal)
        self._supervisor = MapSupervisor(self._context, _serve, arguments, self._on_message, self._on_death)
        self._saving = asyncio.Lock()
        self.left_out: tuple[LeftOut, ...] = ()
        """What the map had seen the beginning of and the vehicle had not looked into, at the last `save`."""
        self._keeps = 0
        self._kept: asyncio.Future[Kept] | None = None
        self._reported = MapStatus()
        self._tally = Tally()
        self._last_message_s = -math.inf
        self._resumed_chunks = 0

    async def __aenter__(self) -> Self:
        """Start the process and wait until it has loaded and compiled everything, and read the journal.

        Raises:
            MapError: it ended at once, or does not get ready, or cannot use the journal.
            InputError: `check_folder`.
        """
        check_folder(self._folder, self._resume)
        await self._supervisor.begin()
        return self

    async def __aexit__(self, *_: object) -> None:
        """End the process. What it knows is in the journal then."""
        await self._supervisor.close()

    @property
    def status(self) -> MapStatus:
        """How the map stands, as it last said. Costs nothing."""
        reported, tally = self._reported, self._tally
        age_s = self._clock.now_s() - self._last_message_s
        alive = self._supervisor.is_ready
        return replace(
            reported,
            frames=tally.in_map("frames"),
            scans=tally.in_map("scans"),
            dropped=tally.dropped,
            refused=tally.refused,
            lost=tally.lost,
            age_s=age_s,
            alive=alive,
            restarts=self._supervisor.restarts,
            resumed_chunks=self._resumed_chunks,
            word=reported.word if alive and age_s <= STALE_S else None,
            problem=reported.problem if alive else self._supervisor.why or "the process of the map does not run",
        )

    def offer(self, frame: DepthFrame, source: int = 0) -> bool:
        """Give an image to the map: copied at once, put in later.

        Args:
            frame: the image.
            source: the number of its camera among ``cameras``.

        Returns:
            Whether it was taken; when not, it is counted as dropped or refused.
        """
        # A camera's own calibration is never quite what the settings say; only its size has to be.
        if frame.depth_m.shape != self._rings[:-1][source].shape:
            self._tally.refused += 1
            return False
        slot = self._slot(source)
        if slot is None:
            return False
        self._rings[source].array(slot)[...] = frame.depth_m
        return self._offer(OfferedFrame(source, slot, frame.t_s, frame.pose, frame.camera))

    def offer_scan(self, scan: PlanarScan) -> bool:
        """Give one turn of the planar scanner to the map: copied at once, put in later.

        Returns:
            Whether it was taken; when not, it is counted as dropped or refused.
        """
        source, rays = len(self._cameras), len(scan.ranges_m)
        if not 0 < rays == len(scan.bearings_rad) <= MOST_RAYS:
            self._tally.refused += 1
            return False
        slot = self._slot(source)
        if slot is None:
            return False
        room = self._rings[source].array(slot)
        room[0, :rays], room[1, :rays] = scan.bearings_rad, scan.ranges_m
        return self._offer(OfferedScan(source, slot, scan.t_s, scan.pose, rays, scan.max_range_m))

    async def save(self) -> list[Path]:
        """Write the files of the map, each whole or not at all; where they are.

        The map puts what it has into its journal and goes on; another process makes the files of it. So this works
        too when the map's process has died for good. Without a folder nothing is written.

        Raises:
            MapError: a file cannot be written, or there is no map. The map goes on in any case, and its journal stays.
        """
        if self._folder is None:
            return []
        async with self._saving:
            await self._keep()
            return await write_files(self._context, self._folder)

    async def _keep(self) -> None:
        """Have everything put on the disk. Without a process there is nothing more than what is there."""
        self._keeps += 1
        self._kept = asyncio.get_running_loop().create_future()
        try:
            if not self._supervisor.is_ready or not self._supervisor.send(Keep(self._keeps)):
                _log.error("the process of the map does not run: what it kept before is written")
                return
            kept = await asyncio.wait_for(self._kept, SAVE_TIMEOUT_S)
        except TimeoutError:
            raise MapError(f"the map was not kept in {self._folder} in {SAVE_TIMEOUT_S:g} s") from None
        finally:
            self._kept = None
        self.left_out = kept.left_out
        if kept.problem:
            raise MapError(f"cannot write the map to {self._folder}: {kept.problem}")

    def _slot(self, source: int) -> int | None:
        """Room for a reading, or None, which is counted."""
        slot = self._rings[source].take() if self._supervisor.is_ready else None
        self._tally.dropped += slot is None
        return slot

    def _offer(self, offered: Offered) -> bool:
        sent = self._supervisor.send(offered)
        if not sent:
            self._tally.dropped += 1
            self._rings[offered.source].give_back(offered.slot)
        return sent

    def _on_message(self, message: FromMap) -> None:
        self._last_message_s = self._clock.now_s()
        match message:
            case Taken(source, slot, used):
                self._rings[source].give_back(slot)
                if used:
                    self._tally.used("frames" if source < len(self._cameras) else "scans")
                else:
                    self._tally.refused += 1
            case MapStatus():
                self._on_status(message)
            case Kept():
                if self._kept is not None and not self._kept.done() and message.number == self._keeps:
                    self._kept.set_result(message)
            case Ready(resumed_chunks):
                self._resumed_chunks = resumed_chunks

    def _on_status(self, status: MapStatus) -> None:
        if status.problem != self._reported.problem:
            if status.problem:
                _log.error("the map: %s; the flight goes on", status.problem)
            else:
                _log.warning("the map: it is kept on the disk again")
        self._reported = status
        self._tally.kept(status.kept_frames, status.kept_scans)

    def _on_death(self) -> int:
        """Forget what only the process had; how many readings are lost with it."""
        lost = self._tally.died(sum(ring.in_use for ring in self._rings))
        for ring in self._rings:
            ring.give_back_all()
        self._reported = MapStatus(problem=self._reported.problem)
        if self._kept is not None and not self._kept.done():
            self._kept.set_exception(MapError("the process of the map died before the map was kept"))
        return lost


def check_folder(folder: Path | None, resume: bool) -> None:
    """Two missions must never be mixed by accident: after a reboot of the autopilot its origin is another one.

    Raises:
        InputError: a map is to be resumed and there is none, or there is one that is not to be resumed.
    """
    if folder is None:
        return
    journal = folder / JOURNAL_NAME
    if resume and not journal.is_dir():
        raise InputError(f"no map can be resumed in {folder}: it holds no {JOURNAL_NAME}; give the folder of a flight")
    if not resume and journal.exists():
        raise InputError(f"{folder} holds the map of another flight: resume it (--resume-map) or give another folder")


def _serve(*arguments: Any) -> None:
    # Loaded there and not here: the application needs nothing of it.
    from companion.mapping.process.server import serve

    serve(*arguments)


__all__ = ["MapClient", "MapError", "MapStatus", "check_folder"]
