"""What is remembered of the way."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from companion.control.homing import keyframes as module
from companion.control.homing.keyframes import SEEN_M, STEP_M, Keyframe, Keyframes, walls_m
from companion.control.known_ground import Place
from companion.model import Pose
from tests.control.scene import Scene, box, measurement

DRIFT = Scene(box(-30.0, -1.5, 300.0, 1.5))


def flown(frames: Keyframes, metres: float, step_m: float = 0.1) -> None:
    for k in range(round(metres / step_m) + 1):
        pose = Pose(0.1 * k, k * step_m, 0.0, 1.5, 0.0)
        frames.fly(pose)
        frames.see(DRIFT.measure(pose), pose)


def all_of(frames: Keyframes) -> list[Keyframe]:
    return frames.near(Place(0.0, 0.0, 0.0), 1e6)


def test_a_look_every_metre_oldest_first() -> None:
    """Enough to know each place again, and not one a tick."""
    frames = Keyframes(0.8)
    flown(frames, 20.0)
    assert frames.way_m == pytest.approx(20.0)
    near = frames.near(Place(10.0, 0.0, 0.0), 3.0)
    ways = [frame.way_m for frame in near]
    assert ways == sorted(ways)
    assert np.diff(ways) == pytest.approx(STEP_M, abs=0.11)
    assert all(abs(frame.place.x_m - 10.0) <= 3.0 for frame in near)
    assert all_of(frames)[0].way_m == 0.0


def test_a_turn_on_the_spot_is_looked_at_all_round() -> None:
    """At the start the camera sees a quarter of what is about; who comes back comes from elsewhere."""
    frames = Keyframes(0.8)
    for k in range(36):
        pose = Pose(0.1 * k, 0.0, 0.0, 1.5, math.radians(10.0 * k - 180.0))
        frames.fly(pose)
        frames.see(DRIFT.measure(pose), pose)
    assert 8 <= len(frames.near(Place(0.0, 0.0, 0.0), 1.0)) <= 10


def test_another_level_is_another_place() -> None:
    """A drift above is not recognised in the one below."""
    frames = Keyframes(0.8)
    flown(frames, 5.0)
    assert frames.near(Place(2.0, 0.0, 0.5), 3.0)
    assert not frames.near(Place(2.0, 0.0, 4.0), 3.0)


def test_walls_are_where_they_are_seen_and_no_further_than_they_can_be_trusted() -> None:
    """The plan of what stood about the vehicle."""
    walls = walls_m(DRIFT.measure(Pose(0.0, 5.0, 0.5, 1.5, 1.0)), Pose(0.0, 5.0, 0.5, 1.5, 1.0))
    assert np.abs(np.abs(walls[:, 1]) - 1.5).max() < 1e-9
    assert np.hypot(walls[:, 0] - 5.0, walls[:, 1] - 0.5).max() < SEEN_M
    assert walls_m(measurement(None), Pose(0.0, 0.0, 0.0, 1.5, 0.0)).shape == (0, 2)


def test_nothing_is_kept_of_what_nobody_saw() -> None:
    """Without a scan or a height there is no place to keep."""
    frames = Keyframes(0.8)
    pose = Pose(0.0, 0.0, 0.0, 1.5, 0.0)
    frames.fly(pose)
    frames.see(measurement(None), pose)
    frames.see(replace(DRIFT.measure(pose), h_m=None), pose)
    assert not all_of(frames)


def test_it_lands_where_it_is_level_and_wide() -> None:
    """A place beside a wall or on a ramp is one to fly over."""
    places = []
    for y_m, slope in ((0.0, 0.0), (0.9, 0.0), (0.0, 0.2), (0.0, None)):
        frames = Keyframes(0.8)
        pose = Pose(0.0, 5.0, y_m, 1.5, 0.0)
        frames.fly(pose)
        frames.see(replace(DRIFT.measure(pose), ground_slope=slope), pose)
        (look,) = all_of(frames)
        places.append(look.lands)
    assert places == [True, False, False, False]


def test_the_memory_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """A day of flying keeps as much as an hour, half as often."""
    monkeypatch.setattr(module, "MOST", 16)
    frames = Keyframes(0.8)
    flown(frames, 100.0, step_m=0.5)
    kept = frames.near(Place(50.0, 0.0, 0.0), 100.0)
    assert len(kept) <= 16
    assert kept[0].way_m == 0.0
    assert kept[-1].way_m > 80.0
