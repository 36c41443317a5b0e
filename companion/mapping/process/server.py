"""The process of the map: takes images and scans, keeps them on the disk, looks for frontiers, and reports."""

from __future__ import annotations

import logging
import math
import os
import signal
import tempfile
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path
from statistics import median

import numpy as np

from companion.config.mapping import MapSettings
from companion.control.left_out import LeftOut
from companion.errors import CompanionError
from companion.gate.runtime.processes import end_with_parent
from companion.mapping.frontiers.frontier import Reach, Survey
from companion.mapping.frontiers.surveyor import Surveyor
from companion.mapping.process.journaled_map import JournaledMap
from companion.mapping.process.messages import (
    Failed,
    FromMap,
    Keep,
    Kept,
    MapStatus,
    Offered,
    OfferedFrame,
    OfferedScan,
    Preparing,
    Ready,
    SlotRing,
    Stop,
    Taken,
    ToMap,
)
from companion.mapping.process.supervisor import MAP_NICENESS, ignore_the_terminal
from companion.model import Camera, DepthFrame, PlanarScan, Pose

REPORT_PERIOD_S = 0.5
SURVEY_PERIOD_S = 1.0

LOOK_PERIOD_S = 0.1
"""With nothing to do, it is looked this often whether something has to be kept or reported."""

SURVEY_SHARE = 0.25
"""Frontiers are looked for during this share of the time at most, however large the mine has grown."""

MOST_PLACES = 10_000
"""Places flown through since the last look for frontiers: of more than these the oldest are left out."""

LEAST_SPEED_MPS = 0.1
"""Slower ones are not remembered as flown: on the ground and in the climb of the take-off the vehicle is not at flight
height."""

TIMED_FRAMES = 51
"""Of so many images the median time is reported."""

_log = logging.getLogger(__name__)


def serve(
    pipe: Connection[FromMap, ToMap],
    rings: Sequence[SlotRing],
    settings: MapSettings,
    cameras: Sequence[Camera],
    reach: Reach,
    journal: Path | None,
) -> None:
    """Be the map until `Stop`, or until the other end of the pipe is gone."""
    ignore_the_terminal()
    os.nice(MAP_NICENESS)
    try:
        voxels = JournaledMap(settings, journal)
    except CompanionError as error:
        pipe.send(Failed(str(error)))
        return
    # When the application is gone the map is still kept.
    with voxels, suppress(EOFError, BrokenPipeError, ConnectionResetError):
        try:
            # What compiles looks at no pipe, for a minute; from then on the pipe says that the application is gone, and
            # the last second is still kept.
            end_with_parent(signal.SIGTERM)
            compile_ahead(settings, cameras, reach, lambda what: pipe.send(Preparing(what)))
        except (OSError, CompanionError) as error:
            # A full disk must not keep the map from being started again in flight.
            _log.warning("nothing of the map is compiled ahead, the first images may be late: %s", error)
        end_with_parent(None)
        server = MapServer(pipe, rings, voxels, reach)
        pipe.send(Ready(voxels.chunks))
        while server.turn():
            pass


def compile_ahead(
    settings: MapSettings, cameras: Sequence[Camera], reach: Reach, on_stage: Callable[[str], None] = lambda _: None
) -> None:
    """Put an image of each camera, and a scan, into a map that is thrown away: the first one would take seconds.

    Args:
        settings: of the map.
        cameras: that will take the images.
        reach: what the vehicle can do.
        on_stage: is given what comes next.
    """
    pose = Pose(0.0, 0.0, 0.0, reach.height_m, 0.0)
    with tempfile.TemporaryDirectory() as folder:
        with JournaledMap(settings, Path(folder) / "map") as scratch:
            on_stage("compiling what puts images into the map")
            for camera in cameras:
                depth_m = np.full((camera.height_px, camera.width_px), camera.max_range_m / 2.0, np.float32)
                scratch.integrate(DepthFrame(0.0, depth_m, camera, pose))
            on_stage("compiling what puts scans into the map")
            bearings_rad = np.linspace(-math.pi, math.pi, 90, endpoint=False)
            scratch.integrate_scan(PlanarScan(0.0, bearings_rad, np.full(90, 2.0), 4.0, pose))
        # From the journal, as after a restart.
        with JournaledMap(settings, Path(folder) / "map") as scratch:
            on_stage("compiling what looks for frontiers")
            surveyor = _surveyor(scratch, reach)
            surveyor.update(scratch.snapshot())
            surveyor.flew(np.array([[0.0, 0.0, reach.height_m]]))
            # Twice: leaving a place that was only surveyed from is compiled too.
            for x_m in (0.0, 1.0):
                found = surveyor.survey((x_m, 0.0, reach.height_m))
            surveyor.left_out(found)


def _surveyor(voxels: JournaledMap, reach: Reach) -> Surveyor:
    """A surveyor who knows what the journal held."""
    surveyor = Surveyor(voxels.voxel_m, reach)
    for piece in voxels.pieces():
        surveyor.put(piece, voxels.threshold)
    return surveyor


class Waiting:
    """Offers that have not been put into the map. Each sensor has few slots, so there are never many.

    When there is not time for all, the map still follows the vehicle, and with all its eyes: a sensor that was just
    served comes last, however fast it is.

    Args:
        sources: how many sensors there are.
    """

    def __init__(self, sources: int) -> None:
        self._stacks: list[list[Offered]] = [[] for _ in range(sources)]
        self._turns = deque(range(sources))

    def __len__(self) -> int:
        return sum(map(len, self._stacks))

    def add(self, offered: Offered) -> None:
        """A new one."""
        self._stacks[offered.source].append(offered)

    def pop(self) -> Offered:
        """The next one to be put into the map.

        Raises:
            IndexError: nothing waits.
        """
        for source in self._turns:
            if self._stacks[source]:
                self._turns.remove(source)
                self._turns.append(source)
                return self._stacks[source].pop()
        raise IndexError("nothing waits")


class MapServer:
    """The map, at the other end of the pipe from `MapClient`.

    Args:
        pipe: to the application.
        rings: slots of the cameras, and of the scanner at last.
        voxels: the map.
        reach: what the vehicle can do.
    """

    def __init__(
        self, pipe: Connection[FromMap, ToMap], rings: Sequence[SlotRing], voxels: JournaledMap, reach: Reach
    ) -> None:
        self._pipe = pipe
        self._rings = rings
        self._map = voxels
        self._reach = reach
        self._surveyor = _surveyor(voxels, reach)
        self._waiting = Waiting(len(rings))
        self._flown: deque[tuple[float, float, float]] = deque(maxlen=MOST_PLACES)
        self._newest: Offered | None = None
        self._took_s: deque[float] = deque(maxlen=TIMED_FRAMES)
        self._surveyed_revision = voxels.revision
        self._survey: Survey | None = None
        self._survey_s = 0.0
        self._next_survey_s = self._next_report_s = -math.inf

    def turn(self) -> bool:
        """Drain the pipe, then do one thing; false when it is time to end."""
        wait_s = 0.0 if self._waiting else LOOK_PERIOD_S
        while self._pipe.poll(wait_s):
            message = self._pipe.recv()
            wait_s = 0.0
            if isinstance(message, Stop):
                self._keep()
                return False
            if isinstance(message, Keep):
                self._pipe.send(Kept(message.number, self._keep(), self._left_out()))
            else:
                self._waiting.add(message)
        if self._waiting:
            self._put(self._waiting.pop())
        now_s = time.monotonic()
        news = self._map.turn(now_s)
        if self._map.revision > self._surveyed_revision and now_s >= self._next_survey_s:
            self._look_for_frontiers()
            now_s = time.monotonic()
        if news or now_s >= self._next_report_s:
            self._report(now_s)
        return True

    def _keep(self) -> str:
        """Put everything that waits into the map, and that on the disk; what is wrong with it."""
        while self._waiting:
            self._put(self._waiting.pop())
        problem = self._map.keep()
        self._report(time.monotonic())
        return problem

    def _left_out(self) -> tuple[LeftOut, ...]:
        """What was seen and not looked into, from everything that is in the map."""
        if self._map.revision > self._surveyed_revision:
            self._look_for_frontiers()
        return () if self._survey is None else self._surveyor.left_out(self._survey)

    def _put(self, offered: Offered) -> None:
        began_s = time.monotonic()
        used = not self._map.is_full
        if used:
            try:
                self._integrate(offered)
            except ValueError:
                # A pose that is no number, or outside the grid.
                used = False
        if used:
            if isinstance(offered, OfferedFrame):
                self._took_s.append(time.monotonic() - began_s)
            if self._newest is None or offered.t_s >= self._newest.t_s:
                self._newest = offered
            pose = offered.pose
            if math.hypot(pose.vx_mps, pose.vy_mps) >= LEAST_SPEED_MPS:
                self._flown.append((pose.x_m, pose.y_m, pose.z_m))
        self._pipe.send(Taken(offered.source, offered.slot, used))

    def _integrate(self, offered: Offered) -> None:
        room = self._rings[offered.source].array(offered.slot)
        match offered:
            case OfferedFrame():
                self._map.integrate(DepthFrame(offered.t_s, room, offered.camera, offered.pose))
            case OfferedScan():
                bearings_rad, ranges_m = room[:, : offered.rays]
                scan = PlanarScan(offered.t_s, bearings_rad, ranges_m, offered.max_range_m, offered.pose)
                self._map.integrate_scan(scan)

    def _look_for_frontiers(self) -> None:
        newest = self._newest
        if newest is None:
            return  # nothing but what the journal held
        began_s = time.monotonic()
        snapshot = self._map.snapshot(self._surveyed_revision)
        self._surveyed_revision = snapshot.revision
        self._surveyor.update(snapshot)
        if self._flown:
            self._surveyor.flew(np.array(self._flown))
            self._flown.clear()
        self._survey = self._surveyor.survey((newest.pose.x_m, newest.pose.y_m, newest.pose.z_m))
        ended_s = time.monotonic()
        self._survey_s = ended_s - began_s
        self._next_survey_s = ended_s + max(SURVEY_PERIOD_S, self._survey_s / SURVEY_SHARE) - self._survey_s

    def _report(self, now_s: float) -> None:
        self._next_report_s = now_s + REPORT_PERIOD_S
        found, voxels = self._survey, self._map
        self._pipe.send(
            MapStatus(
                kept_frames=voxels.kept_frames,
                kept_scans=voxels.kept_scans,
                occupied=0 if found is None else found.occupied,
                completeness=0.0 if found is None else found.completeness,
                word=None if found is None else found.word(self._reach),
                frontiers=0 if found is None else len(found.frontiers_m),
                frontiers_m=() if found is None else _places(found),
                survey_s=self._survey_s,
                frame_ms=1000.0 * median(self._took_s) if self._took_s else 0.0,
                chunks=voxels.chunks,
                memory_bytes=voxels.memory_bytes + self._surveyor.known.memory_bytes,
                journal_bytes=voxels.journal_bytes,
                problem=voxels.problem,
            )
        )


def _places(found: Survey) -> tuple[tuple[float, float, float], ...]:
    """A place on each frontier that counts."""
    return tuple((one.x_m, one.y_m, one.z_m) for one in found.frontiers[: len(found.frontiers_m)])
