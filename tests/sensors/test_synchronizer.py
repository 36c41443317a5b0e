"""What a tick sees: images placed where they were taken, however late their poses come."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from companion.config.sensors import CameraSettings
from companion.model import Beam, Observation, RangeReading
from companion.pose_buffer import PoseBuffer
from companion.sensors.sink import DEPTH, FROZEN, RawDepth, RawPlanar, SensorSink
from companion.sensors.synchronizer import POSE_WAIT_S, Synchronizer
from tests.shared.clocks import HandClock

CAMERA = replace(CameraSettings().model(), width_px=4, height_px=3)
YAW_RATE_RADPS = 0.6


class Scene:
    """A vehicle that turns on the spot, whose poses come when they are told to."""

    def __init__(self) -> None:
        self.clock = HandClock(100.0)
        self.sink = SensorSink(self.clock)
        self.poses = PoseBuffer()
        self.inputs = Synchronizer(self.sink, self.poses)

    def pose(self, t_s: float) -> None:
        self.poses.add_attitude(t_s, 0.0, 0.0, YAW_RATE_RADPS * (t_s - 100.0), YAW_RATE_RADPS)
        self.poses.add_position(t_s, 0.0, 0.0, 1.5, 0.0, 0.0, 0.0)

    def observe(self, now_s: float) -> Observation:
        self.clock.time_s = now_s
        seen = self.inputs.observe(now_s)
        assert seen is not None
        return seen

    def image(self, t_s: float) -> None:
        # What it sees changes with the heading.
        self.sink.depth(RawDepth(t_s, np.full((3, 4), t_s - 98.0, np.float32), CAMERA))


def test_without_any_pose_there_is_nothing_to_see() -> None:
    """A velocity needs to know which way the vehicle looks."""
    scene = Scene()
    scene.image(100.0)
    assert scene.inputs.observe(100.0) is None


def test_an_image_taken_in_a_turn_gets_the_pose_of_its_exposure() -> None:
    """At 0.6 rad/s 50 ms are 1.7°: at 6 m the wall would be drawn 18 cm aside."""
    scene = Scene()
    for i in range(5):
        scene.pose(100.0 + 0.02 * i)
    scene.image(100.03)
    seen = scene.observe(100.08)
    assert seen.frame is not None
    assert seen.frame.t_s == 100.03
    assert seen.frame.pose.yaw_rad == pytest.approx(YAW_RATE_RADPS * 0.03, abs=1e-9)
    assert seen.pose.yaw_rad == pytest.approx(YAW_RATE_RADPS * 0.08, abs=1e-9)


def test_an_image_waits_for_its_pose() -> None:
    scene = Scene()
    scene.pose(100.0)
    scene.clock.time_s = 100.1
    scene.image(100.1)
    first = scene.observe(100.1)
    assert first.frame is None
    scene.pose(100.09)
    scene.pose(100.11)
    second = scene.observe(100.15)
    assert second.frame is not None
    assert second.frame.pose.yaw_rad == pytest.approx(YAW_RATE_RADPS * 0.1, abs=1e-9)
    assert scene.inputs.unpaired == 0


def test_images_faster_than_their_poses_do_not_push_each_other_out() -> None:
    """A new image each tick, poses 120 ms late: without a queue none would ever be placed."""
    scene = Scene()
    placed = 0
    for i in range(40):
        now_s = 100.0 + 0.05 * i
        scene.clock.time_s = now_s
        scene.pose(now_s - 0.12)
        scene.image(now_s)
        seen = scene.inputs.observe(now_s)
        placed += seen is not None and seen.frame is not None
    assert placed >= 35


def test_an_image_whose_pose_never_comes_is_dropped_and_counted() -> None:
    scene = Scene()
    scene.pose(100.0)
    scene.clock.time_s = 100.1
    scene.image(100.1)
    for now_s in (100.1, 100.2, 100.1 + POSE_WAIT_S + 0.01):
        seen = scene.observe(now_s)
        assert seen.frame is None
    assert scene.inputs.unpaired == 1
    scene.pose(100.3)
    late = scene.observe(100.45)
    assert late.frame is None


def test_a_frozen_image_is_left_out_counted_and_logged_now_and_then(caplog: pytest.LogCaptureFixture) -> None:
    """Protects map and law from old pictures under new poses, and the log from a line for each of them."""
    scene = Scene()
    frames = 0
    for i in range(240):
        now_s = 100.0 + 0.05 * i
        scene.clock.time_s = now_s
        scene.pose(now_s)
        scene.sink.depth(RawDepth(now_s, np.full((3, 4), 2.0, np.float32), CAMERA))
        seen = scene.observe(now_s)
        frames += seen.frame is not None
    # 2° at 0.6 rad/s: the first picture, and one more 0.05 s later.
    assert frames == 2
    assert scene.sink.statistics(112.0)[DEPTH].reasons == {FROZEN: 238}
    assert [record.getMessage() for record in caplog.records] == [
        "depth is frozen while the vehicle moves: ignored until it changes"
    ] * 2
    assert scene.inputs.unpaired == 0


def test_scans_are_placed_too_and_ranges_need_not_be() -> None:
    scene = Scene()
    scene.pose(100.0)
    scene.pose(100.04)
    scene.clock.time_s = 100.05
    bearings_rad = np.linspace(-math.pi, math.pi, 36, endpoint=False)
    scene.sink.planar(RawPlanar(100.02, bearings_rad, np.full(36, 3.0), 10.0))
    down = RangeReading(Beam.DOWN, 100.03, 1.5, 8.0)
    scene.sink.ranges([down])
    seen = scene.observe(100.05)
    assert seen.planar is not None
    assert seen.planar.pose.yaw_rad == pytest.approx(YAW_RATE_RADPS * 0.02, abs=1e-9)
    assert seen.ranges == (down,)
