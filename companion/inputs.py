"""What one tick sees: the newest of every stream, each depth image paired with the pose at its own exposure."""

from __future__ import annotations

from collections import deque
from typing import Generic, TypeVar

from companion.model import DepthFrame, Observation, PlanarScan, Pose
from companion.poses import PoseBuffer
from companion.sensors.sink import RawDepth, RawPlanar, SensorSink

POSE_WAIT_S = 0.3
"""What has no pose after this long is dropped: poses come 20 to 50 ms late, and a gap in them does not close."""

WAITING = 8
"""Images that may wait for their poses: at 20 ticks a second more than `POSE_WAIT_S` of them."""


Raw = TypeVar("Raw", RawDepth, RawPlanar)


class _Waiting(Generic[Raw]):
    """Readings that have arrived before the pose of their time was known for sure."""

    def __init__(self) -> None:
        self.dropped = 0
        self._queue: deque[Raw] = deque(maxlen=WAITING)

    def add(self, raw: Raw) -> None:
        self.dropped += len(self._queue) == WAITING
        self._queue.append(raw)

    def newest_placed(self, poses: PoseBuffer, now_s: float) -> tuple[Raw, Pose] | None:
        """The newest that can be placed; older ones have been overtaken by it and are gone."""
        while self._queue and now_s - self._queue[0].t_s > POSE_WAIT_S:
            self._queue.popleft()
            self.dropped += 1
        for i in range(len(self._queue) - 1, -1, -1):
            pose = poses.at(self._queue[i].t_s)
            if pose is not None:
                raw = self._queue[i]
                for _ in range(i + 1):
                    self._queue.popleft()
                self.dropped += i
                return raw, pose
        return None


class Inputs:
    """Takes what drivers and telemetry have brought, and makes an `Observation` of it.

    An image may arrive before the pose sample behind its exposure: it waits for it, so that a frame taken in a turn is
    placed where it was taken.

    Args:
        sink: the readings of the sensors.
        poses: the poses of the last seconds.
    """

    def __init__(self, sink: SensorSink, poses: PoseBuffer) -> None:
        self._sink = sink
        self._poses = poses
        self._depth: _Waiting[RawDepth] = _Waiting()
        self._planar: _Waiting[RawPlanar] = _Waiting()

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
        depth = self._depth.newest_placed(self._poses, now_s)
        planar = self._planar.newest_placed(self._poses, now_s)
        return Observation(
            now_s,
            pose,
            None if depth is None else DepthFrame(depth[0].t_s, depth[0].depth_m, depth[0].camera, depth[1]),
            taken.ranges,
            None
            if planar is None
            else PlanarScan(
                planar[0].t_s, planar[0].bearings_rad, planar[0].ranges_m, planar[0].max_range_m, planar[1]
            ),
        )
