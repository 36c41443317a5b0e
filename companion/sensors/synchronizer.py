"""The observation of one tick: the newest of every stream, each depth image paired with the pose at its exposure."""

from __future__ import annotations

import logging
import math
from collections import deque
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from companion.model import Beam, DepthFrame, Observation, PlanarScan, Pose, RangeReading
from companion.pose_buffer import PoseBuffer
from companion.sensors.sink import DEPTH, FROZEN, PLANAR, RawDepth, RawPlanar, SensorSink
from companion.sensors.stuck import FrozenBeam, FrozenImages

POSE_WAIT_S = 0.3
"""A reading still without a pose is dropped then: poses come 20 to 50 ms late, and a gap in them does not close."""

WAITING = 8
"""Images that may wait for their poses: at 20 ticks a second more than `POSE_WAIT_S` of them."""

LOG_AGAIN_S = 10.0
"""Between two log lines about the same sensor."""

_log = logging.getLogger(__name__)

Raw = TypeVar("Raw", RawDepth, RawPlanar)


class _Waiting(Generic[Raw]):
    """Readings that wait for the pose of their time."""

    def __init__(self) -> None:
        self.dropped = 0
        self._queue: deque[Raw] = deque(maxlen=WAITING)

    def add(self, raw: Raw) -> None:
        self.dropped += len(self._queue) == WAITING
        self._queue.append(raw)

    def newest_placed(self, poses: PoseBuffer, now_s: float) -> tuple[Raw, Pose] | None:
        """The newest that can be placed, with its pose; older ones have been overtaken by it and are dropped."""
        while self._queue and now_s - self._queue[0].t_s > POSE_WAIT_S:
            self._queue.popleft()
            self.dropped += 1
        for i, raw in reversed(list(enumerate(self._queue))):
            if (pose := poses.at(raw.t_s)) is not None:
                for _ in range(i + 1):
                    self._queue.popleft()
                self.dropped += i
                return raw, pose
        return None


class Synchronizer:
    """Makes an `Observation` of what drivers and telemetry have brought.

    An image may arrive before the pose sample that follows its exposure: it waits for that, so that a frame taken in a
    turn is placed where it was taken. An image or a reading that is frozen while the vehicle moves is left out and
    counted in the statistics of the sink: its stream becomes stale, and the vehicle stops.
    """

    def __init__(self, sink: SensorSink, poses: PoseBuffer) -> None:
        self._sink = sink
        self._poses = poses
        self._depth: _Waiting[RawDepth] = _Waiting()
        self._planar: _Waiting[RawPlanar] = _Waiting()
        self._images = {DEPTH: FrozenImages(), PLANAR: FrozenImages()}
        self._beams = {beam: FrozenBeam() for beam in Beam}
        self._logged_s: dict[str, float] = {}

    @property
    def unpaired(self) -> int:
        """Images and scans that were dropped: no pose of their time came, or a newer one overtook them."""
        return self._depth.dropped + self._planar.dropped

    def observe(self, now_s: float) -> Observation | None:
        """Everything that is new at ``now_s``; None while no pose is known at all."""
        taken = self._sink.take()
        if taken.depth is not None:
            self._depth.add(taken.depth)
        if taken.planar is not None:
            self._planar.add(taken.planar)
        pose = self._poses.newest()
        if pose is None:
            return None
        return Observation(
            now_s,
            pose,
            self._newest_frame(now_s),
            tuple(reading for reading in taken.ranges if not self._is_frozen_beam(reading, pose, now_s)),
            self._newest_scan(now_s),
        )

    def _newest_frame(self, now_s: float) -> DepthFrame | None:
        placed = self._depth.newest_placed(self._poses, now_s)
        if placed is None or self._is_frozen_image(DEPTH, placed[0].depth_m, placed[1], now_s):
            return None
        raw, pose = placed
        return DepthFrame(raw.t_s, raw.depth_m, raw.camera, pose)

    def _newest_scan(self, now_s: float) -> PlanarScan | None:
        placed = self._planar.newest_placed(self._poses, now_s)
        if placed is None or self._is_frozen_image(PLANAR, placed[0].ranges_m, placed[1], now_s):
            return None
        raw, pose = placed
        return PlanarScan(raw.t_s, raw.bearings_rad, raw.ranges_m, raw.max_range_m, pose)

    def _is_frozen_image(self, stream: str, values: NDArray[np.floating], pose: Pose, now_s: float) -> bool:
        return self._images[stream].repeats(values, pose) and self._refuse(stream, now_s)

    def _is_frozen_beam(self, reading: RangeReading, pose: Pose, now_s: float) -> bool:
        return self._beams[reading.beam].repeats(reading, pose) and self._refuse(reading.beam.value, now_s)

    def _refuse(self, stream: str, now_s: float) -> bool:
        """Always true: counts the frozen reading, and logs it now and then."""
        self._sink.drop(stream, FROZEN)
        if now_s - self._logged_s.get(stream, -math.inf) > LOG_AGAIN_S:
            self._logged_s[stream] = now_s
            _log.warning("%s is frozen while the vehicle moves: ignored until it changes", stream)
        return True
