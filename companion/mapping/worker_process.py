"""The process of the map: takes images, looks for frontiers, writes files, and reports."""

from __future__ import annotations

import math
import os
import signal
import time
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from companion.config.mapping import MapSettings
from companion.errors import CompanionError
from companion.mapping.files import write_map
from companion.mapping.frontier import CELL_M, Judge, Reach, Survey, survey
from companion.mapping.messages import FromMap, Offered, Ready, Report, Save, Saved, Stop, Taken, ToMap
from companion.mapping.shared_frames import FrameRing
from companion.mapping.voxel_map import VoxelMap
from companion.model import Camera, DepthFrame, Pose

REPORT_PERIOD_S = 0.5
SURVEY_PERIOD_S = 1.0

SURVEY_SHARE = 0.25
"""Frontiers are looked for during this share of the time at most, however large the mine has grown."""

NICENESS = 5
"""The map yields to the control tick."""

MOST_PLACES = 100_000
"""Cells flown through that are remembered: 1000 m² of them. Then the oldest is forgotten."""

LEAST_SPEED_MPS = 0.1
"""Slower ones are not remembered as flown: on the ground and in the climb of the take-off the vehicle is not at flight
height."""


def serve(
    pipe: Connection[FromMap, ToMap], ring: FrameRing, settings: MapSettings, camera: Camera, reach: Reach
) -> None:
    """Be the map until told to stop, or until the other end of the pipe is gone."""
    # A Ctrl-C in the terminal reaches every process: the application ends this one when it has its files.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    os.nice(NICENESS)
    worker = _Worker(pipe, ring, settings, camera, reach)
    try:
        worker.compile()
        pipe.send(Ready())
        while worker.turn():
            pass
    except (EOFError, BrokenPipeError, ConnectionResetError):
        return


class _Worker:
    def __init__(
        self, pipe: Connection[FromMap, ToMap], ring: FrameRing, settings: MapSettings, camera: Camera, reach: Reach
    ) -> None:
        self._pipe = pipe
        self._ring = ring
        self._camera = camera
        self._reach = reach
        self._map = VoxelMap(settings)
        self._judge = Judge(reach)
        self._waiting: list[Offered] = []
        self._flown: dict[tuple[int, int, int], tuple[float, float, float]] = {}
        self._newest: Offered | None = None
        self._frames = self._refused = self._surveyed_frames = 0
        self._survey: Survey | None = None
        self._complete = False
        self._survey_s = 0.0
        self._next_survey_s = self._next_report_s = -math.inf

    def compile(self) -> None:
        """Put an image into a map that is thrown away: the first one would take seconds."""
        scratch = VoxelMap(self._map.settings)
        pose = Pose(0.0, 0.0, 0.0, self._reach.height_m, 0.0)
        depth_m = np.full((self._camera.height_px, self._camera.width_px), self._camera.max_range_m / 2.0, np.float32)
        scratch.integrate(DepthFrame(0.0, depth_m, self._camera, pose))
        survey(scratch.snapshot(), np.array([[0.0, 0.0, self._reach.height_m]]), self._reach)

    def turn(self) -> bool:
        """Hear what there is to hear, then do one thing; false when it is time to end."""
        now_s = time.monotonic()
        wait_s = 0.0 if self._waiting else max(min(self._next_report_s - now_s, REPORT_PERIOD_S), 0.0)
        while self._pipe.poll(wait_s):
            message = self._pipe.recv()
            wait_s = 0.0
            if isinstance(message, Stop):
                return False
            if isinstance(message, Save):
                while self._waiting:
                    self._integrate(self._waiting.pop())
                self._pipe.send(self._saved(message))
            else:
                self._waiting.append(message)
        if self._waiting:
            # Newest first: when there is not time for all, the map still follows the vehicle.
            self._integrate(self._waiting.pop())
        now_s = time.monotonic()
        if self._frames > self._surveyed_frames and now_s >= self._next_survey_s:
            self._look_for_frontiers()
        if now_s >= self._next_report_s:
            self._next_report_s = now_s + REPORT_PERIOD_S
            self._pipe.send(self._report())
        return True

    def _integrate(self, offered: Offered) -> None:
        pose = offered.pose
        try:
            self._map.integrate(DepthFrame(offered.t_s, self._ring.image(offered.slot), offered.camera, pose))
        except ValueError:
            # A pose that is no number, or outside the grid.
            self._refused += 1
        else:
            self._frames += 1
            if self._newest is None or offered.t_s >= self._newest.t_s:
                self._newest = offered
            if math.hypot(pose.vx_mps, pose.vy_mps) >= LEAST_SPEED_MPS:
                self._remember(pose)
        self._pipe.send(Taken(offered.slot))

    def _remember(self, pose: Pose) -> None:
        level_m = self._reach.height_m / 2.0
        cell = math.floor(pose.x_m / CELL_M), math.floor(pose.y_m / CELL_M), math.floor(pose.z_m / level_m)
        self._flown.setdefault(cell, (pose.x_m, pose.y_m, pose.z_m))
        if len(self._flown) > MOST_PLACES:
            del self._flown[next(iter(self._flown))]

    def _look_for_frontiers(self) -> None:
        began_s = time.monotonic()
        newest = self._newest
        assert newest is not None  # noqa: S101 - there are frames
        flown = [*self._flown.values(), (newest.pose.x_m, newest.pose.y_m, newest.pose.z_m)]
        self._survey = survey(self._map.snapshot(), np.array(flown), self._reach)
        self._complete = self._judge.complete(self._survey, newest.t_s)
        self._surveyed_frames = self._frames
        ended_s = time.monotonic()
        self._survey_s = ended_s - began_s
        self._next_survey_s = ended_s + max(SURVEY_PERIOD_S, self._survey_s / SURVEY_SHARE) - self._survey_s

    def _report(self) -> Report:
        found = self._survey
        if found is None:
            return Report(frames=self._frames, refused=self._refused)
        return Report(
            frames=self._frames,
            refused=self._refused,
            occupied=found.occupied,
            completeness=found.completeness,
            complete=self._complete,
            frontiers=len(found.frontiers_m),
            survey_s=self._survey_s,
        )

    def _saved(self, order: Save) -> Saved:
        try:
            return Saved(order.number, tuple(write_map(self._map, order.folder).values()))
        except CompanionError as error:
            return Saved(order.number, _written(order.folder), str(error))
        except OSError as error:
            text = f"cannot write the map to {order.folder}: {error.strerror}; make room or give another folder"
            return Saved(order.number, _written(order.folder), text)


def _written(folder: Path) -> tuple[Path, ...]:
    return tuple(sorted(folder.glob("map.*"))) if folder.is_dir() else ()
