"""The map in a process of its own, so that it never holds up the control tick.

Images go over through shared memory, everything else through a pipe that is read when there is something in it: no call
here waits for the map. When the map is slower than the camera, images are dropped and counted.
"""

from __future__ import annotations

import asyncio
import logging
import math
import signal
from multiprocessing import get_context
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from pathlib import Path
from types import TracebackType
from typing import Self

from companion.clock import Clock, MonotonicClock
from companion.config.control import ControlSettings
from companion.config.mapping import MapSettings
from companion.mapping.frontier import Reach
from companion.mapping.map_status import MapError, MapStatus
from companion.mapping.messages import FromMap, Offered, Ready, Report, Save, Saved, Stop, Taken, ToMap
from companion.mapping.shared_frames import FrameRing
from companion.model import Camera, DepthFrame

START_TIMEOUT_S = 180.0
"""The first start on a computer compiles everything, which takes a small one minutes."""

RESTARTS = 3
"""A process that dies this often dies of something that another start does not mend."""

REST_S = 1.0
END_TIMEOUT_S = 2.0
SAVE_TIMEOUT_S = 180.0

STALE_S = 5.0
"""A process that has been silent for this long does not say any more that the map is complete."""

_log = logging.getLogger(__name__)


class MapWorker:
    """A map in another process; an asynchronous context manager.

    When the process dies (killed, out of memory) it is started again, `RESTARTS` times at most, and **the map begins
    anew, empty**: what was mapped before is lost, which `MapStatus.restarts` tells. A process that hangs is not
    replaced: the age of its status grows. It ignores Ctrl-C and ends when the application does, however that ends.

    Args:
        settings: of the map.
        camera: that takes every image.
        control: height and margins, which say what the vehicle can reach.
        folder: where `save` writes; None: nowhere.
        half_slab_m: what is this much above or below the centre of the vehicle is in its way.
        max_slope: steepest ground that it follows, rise over run.
        clock: for the age of the status.
    """

    def __init__(
        self,
        settings: MapSettings,
        camera: Camera,
        control: ControlSettings,
        folder: Path | None,
        *,
        half_slab_m: float = 0.4,
        max_slope: float = 0.7,
        clock: Clock | None = None,
    ) -> None:
        self._settings = settings
        self._camera = camera
        self._reach = Reach.of(settings, camera, control, half_slab_m, max_slope)
        self._folder = folder
        self._clock = clock or MonotonicClock()
        self._context = get_context("spawn")
        self._ring = FrameRing(self._context, camera.height_px, camera.width_px)
        self._process: SpawnProcess | None = None
        self._pipe: Connection[ToMap, FromMap] | None = None
        self._task: asyncio.Task[None] | None = None
        self._closing = asyncio.Event()
        self._ready = asyncio.Event()
        self._gone = asyncio.Event()
        self._saving = asyncio.Lock()
        self._saves = 0
        self._saved: asyncio.Future[Saved] | None = None
        self._report = Report()
        self._heard_s = -math.inf
        self._dropped = self._refused = self._restarts = 0

    async def __aenter__(self) -> Self:
        """Start the process and wait until it has loaded and compiled everything.

        Raises:
            MapError: it ended at once, or is not ready in `START_TIMEOUT_S`.
        """
        self._task = asyncio.create_task(self._keep_running())
        ready = asyncio.create_task(self._ready.wait())
        gone = asyncio.create_task(self._gone.wait())
        try:
            await asyncio.wait({self._task, ready, gone}, timeout=START_TIMEOUT_S, return_when=asyncio.FIRST_COMPLETED)
            if not self._ready.is_set():
                why = "ended at once" if self._gone.is_set() or self._task.done() else "does not get ready"
                raise MapError(f"the process of the map {why}; its own message, if it had one, stands above")
        except BaseException:
            await self._close()
            raise
        finally:
            ready.cancel()
            gone.cancel()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """End the process. The map is gone then: `save` first."""
        await self._close()

    @property
    def status(self) -> MapStatus:
        """How the map stands, as it last said. Costs nothing."""
        report = self._report
        age_s = self._clock.now_s() - self._heard_s
        return MapStatus(
            frames=report.frames,
            dropped=self._dropped,
            refused=self._refused + report.refused,
            occupied=report.occupied,
            completeness=report.completeness,
            complete=report.complete and self._ready.is_set() and age_s <= STALE_S,
            frontiers=report.frontiers,
            survey_s=report.survey_s,
            age_s=age_s,
            alive=self._ready.is_set(),
            restarts=self._restarts,
        )

    def offer(self, frame: DepthFrame) -> bool:
        """Give an image to the map: copied at once, put in later.

        Returns:
            Whether it was taken; when not, it is counted as dropped or refused.
        """
        # A camera's own calibration is never quite what the settings say; only its size has to be.
        if frame.depth_m.shape != self._ring.shape[1:]:
            self._refused += 1
            return False
        slot = self._ring.put(frame.depth_m) if self._ready.is_set() else None
        if slot is None or not self._tell(Offered(slot, frame.t_s, frame.pose, frame.camera)):
            self._dropped += 1
            return False
        return True

    async def save(self) -> list[Path]:
        """Write map.ply, map.pcd, map.las and map.bt, each whole or not at all; where they are.

        Images that come meanwhile are dropped when there is no room. Without a folder nothing is written.

        Raises:
            MapError: a file cannot be written, or there is no map. The process goes on in any case.
        """
        if self._folder is None:
            return []
        async with self._saving:
            self._saves += 1
            self._saved = asyncio.get_running_loop().create_future()
            try:
                if not self._ready.is_set() or not self._tell(Save(self._saves, self._folder)):
                    raise MapError("there is no map to write: its process does not run")
                saved = await asyncio.wait_for(self._saved, SAVE_TIMEOUT_S)
            except TimeoutError:
                raise MapError(f"the map was not written to {self._folder} in {SAVE_TIMEOUT_S:g} s") from None
            finally:
                self._saved = None
        if saved.error is not None:
            raise MapError(saved.error)
        return list(saved.paths)

    async def _keep_running(self) -> None:
        while True:
            try:
                await self._run_once()
            except OSError as error:
                _log.error("the process of the map cannot be started: %s", error.strerror)
            self._forget()
            if self._closing.is_set() or self._restarts == RESTARTS:
                return
            try:
                await asyncio.wait_for(self._closing.wait(), REST_S)
            except TimeoutError:
                self._restarts += 1
            else:
                return

    async def _run_once(self) -> None:
        """Start the process, hear it, and return when it is gone."""
        self._gone.clear()
        self._pipe, theirs = self._context.Pipe()
        arguments = (theirs, self._ring, self._settings, self._camera, self._reach)
        process = self._context.Process(target=_serve, args=arguments, name="map", daemon=True)
        try:
            # In a thread: starting takes tens of milliseconds.
            await asyncio.to_thread(_start, process)
        finally:
            theirs.close()
        self._process = process
        loop = asyncio.get_running_loop()
        loop.add_reader(self._pipe.fileno(), self._hear)
        try:
            if self._closing.is_set():
                process.kill()
            await self._gone.wait()
        finally:
            loop.remove_reader(self._pipe.fileno())
            self._pipe.close()
            self._pipe = None
            await asyncio.to_thread(process.join, END_TIMEOUT_S)
            process.kill()
            await asyncio.to_thread(process.join)
            if not self._closing.is_set():
                _log.error(
                    "the process of the map died (exit code %s) with %d images in it: they are lost",
                    process.exitcode,
                    self._report.frames,
                )
            self._process = None
            process.close()

    def _hear(self) -> None:
        """Take what the process said; called when there is something to read, or the process is gone."""
        pipe = self._pipe
        if pipe is None:
            return
        try:
            while pipe.poll():
                self._take(pipe.recv())
        except (EOFError, OSError):
            asyncio.get_running_loop().remove_reader(pipe.fileno())
            self._ready.clear()
            self._gone.set()

    def _take(self, message: FromMap) -> None:
        self._heard_s = self._clock.now_s()
        match message:
            case Taken(slot):
                self._ring.give_back(slot)
            case Report():
                self._report = message
            case Saved():
                if self._saved is not None and not self._saved.done() and message.number == self._saves:
                    self._saved.set_result(message)
            case Ready():
                self._ready.set()

    def _tell(self, message: ToMap) -> bool:
        """Send a message; false when the process is gone. There are never so many that the pipe could be full."""
        if self._pipe is None:
            return False
        try:
            self._pipe.send(message)
        except OSError:
            return False
        return True

    def _forget(self) -> None:
        self._ready.clear()
        self._ring.give_back_all()
        self._report = Report()
        if self._saved is not None and not self._saved.done():
            self._saved.set_exception(MapError("the process of the map died before the map was written"))

    async def _close(self) -> None:
        task = self._task
        if task is None:
            return
        self._closing.set()
        try:
            self._tell(Stop())
            await asyncio.wait({task}, timeout=END_TIMEOUT_S)
        finally:
            if not task.done() and self._process is not None:
                self._process.kill()
            await task


def _serve(
    pipe: Connection[FromMap, ToMap], ring: FrameRing, settings: MapSettings, camera: Camera, reach: Reach
) -> None:
    # Loaded there and not here: the file formats are of no use to the application.
    from companion.mapping.worker_process import serve

    serve(pipe, ring, settings, camera, reach)


def _start(process: SpawnProcess) -> None:
    """Start with SIGINT held back, or a Ctrl-C while the process is loading would end it."""
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        process.start()
    finally:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})


__all__ = ["MapError", "MapStatus", "MapWorker"]
