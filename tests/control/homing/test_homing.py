"""The way home, flown by the whole navigator in worlds of polygons."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from companion.control.homing.homing import GONE_M, NOTICED_M, SETTLING_S
from companion.control.navigator import Navigator
from companion.model import Measurement, Mode, Pose
from tests.control.scene import CAMERA_RAD, Scene, Track, box, fly, law_parameters

START = Pose(0.0, 0.0, 0.0, 1.5, 0.0)

#: A drift 4 m wide that goes east for 24 m and then north, with a chamber at the corner.
BEND_OUTLINE = [
    (-4.0, -2.0), (20.0, -2.0), (20.0, -4.0), (27.0, -4.0), (27.0, 4.0), (25.0, 4.0), (25.0, 24.0), (21.0, 24.0),
     (21.0, 4.0), (20.0, 4.0), (20.0, 2.0), (9.0, 2.0), (8.5, 2.6), (8.0, 2.0), (-4.0, 2.0),
]  # fmt: skip
BEND = Scene(BEND_OUTLINE)

#: A ring of drifts 4 m wide about a pillar of rock: two ways home from its far side.
RING = Scene(box(-4.0, -2.0, 22.0, 18.0), box(2.0, 2.0, 18.0, 14.0))

Disturb = Callable[[Measurement, Pose], tuple[Measurement, Pose]]


def explored(scene: Scene, seconds: float, disturb: Disturb | None = None, seed: int = 1) -> tuple[Navigator, Pose]:
    """A navigator that has explored for so long, and where it truly is."""
    navigator = Navigator(law_parameters(period_s=0.1, speed_mps=1.0), np.random.default_rng(seed))
    track = fly(navigator, scene, START, seconds, view_rad=CAMERA_RAD, disturb=disturb)
    return navigator, track.poses[-1]


def flown_home(
    navigator: Navigator, scene: Scene, start: Pose, disturb: Disturb | None = None, most_s: float = 200.0
) -> Track:
    assert navigator.go_home(start.t_s)
    whole = Track()
    while not navigator.is_home and start.t_s < most_s + 300.0 and len(whole.poses) < 10.0 * most_s:
        track = fly(navigator, scene, start, 1.0, view_rad=CAMERA_RAD, disturb=disturb)
        for name in ("poses", "seen", "setpoints", "modes"):
            getattr(whole, name).extend(getattr(track, name))
        last, setpoint = track.poses[-1], track.setpoints[-1]
        start = replace(last, t_s=last.t_s + navigator.parameters.period_s)
        assert math.isfinite(setpoint.speed_mps)
    return whole


def length_m(track: Track) -> float:
    return float(
        sum(math.dist((a.x_m, a.y_m), (b.x_m, b.y_m)) for a, b in zip(track.poses, track.poses[1:], strict=False))
    )


def test_it_comes_home_by_a_way_as_short_as_it_said() -> None:
    """The point of it all: it stands where it started, has flown what it said, and never came near a wall."""
    navigator, there = explored(BEND, 70.0)
    assert there.y_m > 6.0, "it has gone round the corner"
    way = navigator.way_home(BEND.measure(there, CAMERA_RAD, there.z_m), there)
    assert way is not None
    track = flown_home(navigator, BEND, there)
    assert navigator.is_home
    end = track.poses[-1]
    assert math.hypot(end.x_m, end.y_m) < 0.3
    assert length_m(track) == pytest.approx(way.length_m, rel=0.15)
    assert track.distances_m().min() >= navigator.parameters.critical_margin_m
    assert way.time_s == pytest.approx(track.poses[-1].t_s - there.t_s, rel=0.5)


def test_a_position_that_has_drifted_does_not_keep_it_from_home() -> None:
    """The walls judge: the autopilot's position is metres off by then, and it stands where it truly started."""

    def drifted(seen: Measurement, pose: Pose) -> tuple[Measurement, Pose]:
        return seen, replace(pose, x_m=pose.x_m + 0.008 * pose.t_s, y_m=pose.y_m - 0.006 * pose.t_s)

    navigator, there = explored(BEND, 70.0, drifted)
    track = flown_home(navigator, BEND, there, drifted)
    end = track.poses[-1]
    assert navigator.is_home
    assert math.hypot(0.008 * end.t_s, 0.006 * end.t_s) > 1.0, "without the walls it would land so far off"
    assert math.hypot(end.x_m, end.y_m) < 0.5
    assert track.distances_m().min() >= navigator.parameters.critical_margin_m


def test_a_way_that_is_closed_is_flown_around() -> None:
    """The live scan judges, not the memory: a door that has closed is found out, and the other way round is taken."""
    navigator, there = explored(RING, 60.0)
    way = navigator.way_home(RING.measure(there, CAMERA_RAD, there.z_m), there)
    assert way is not None
    # The door stands across that side of the ring by which it would go.
    closed = Scene(box(-4.0, -2.0, 22.0, 18.0), box(2.0, 2.0, 18.0, 14.0), door(navigator, there))
    track = flown_home(navigator, closed, there, most_s=400.0)
    assert navigator.is_home
    assert math.hypot(track.poses[-1].x_m, track.poses[-1].y_m) < 0.5
    assert track.distances_m().min() > 0.6


def level(seen: Measurement, pose: Pose) -> tuple[Measurement, Pose]:
    """On ground that can be landed on."""
    return replace(seen, ground_slope=0.0), pose


def test_where_the_way_home_is_closed_it_lands_as_near_to_home_as_it_gets() -> None:
    """Nobody can fetch it from the far end of a mine: it stands before the door, and does not wander until it is empty.

    What stands in the way may go again: it has come back to look twice.
    """
    navigator, there = explored(BEND, 70.0, level)
    assert there.x_m > 12.0
    closed = Scene(BEND_OUTLINE, box(9.0, -2.0, 9.3, 2.0))
    track = flown_home(navigator, closed, there, level, most_s=300.0)
    end = track.poses[-1]
    assert navigator.is_home
    assert navigator.homing.is_closed
    assert 9.3 < end.x_m < 14.0
    assert abs(end.y_m) < 2.0
    assert navigator.homing.off_home_m(end) == pytest.approx(math.hypot(end.x_m, end.y_m), abs=0.3)
    assert track.distances_m().min() > 0.6


def test_beside_a_shaft_nothing_is_landed_on() -> None:
    """The vehicle landed 0.5 m from an edge: when the look was made there, nobody knew yet of the shaft beside it."""
    navigator, there = explored(BEND, 70.0, level)
    edge = [(x_m, y_m) for x_m in np.arange(9.6, 11.9, 0.3) for y_m in np.arange(-2.0, 2.1, 0.3)]
    for x_m, y_m in edge:
        navigator.homing.lose_ground(Pose(there.t_s, x_m, y_m, 1.5, 0.0))
    closed = Scene(BEND_OUTLINE, box(9.0, -2.0, 9.3, 2.0))
    end = flown_home(navigator, closed, there, level, most_s=300.0).poses[-1]
    assert navigator.is_home
    assert navigator.homing.is_closed
    apart_m = min(math.dist((end.x_m, end.y_m), place) for place in edge)
    assert navigator.parameters.critical_margin_m + NOTICED_M - GONE_M / 2.0 < apart_m < 3.0


@pytest.mark.parametrize(("width_m", "seed"), [(2.2, 2), (1.8, 3), (1.9, 1)])
def test_a_gap_that_it_flew_out_through_is_flown_home_through(width_m: float, seed: int) -> None:
    """A gap is hardly wider than what the scan has to confirm: the first two were blocked for good, and it landed."""
    posts = (box(9.0, -2.0, 9.2, -width_m / 2.0), box(9.0, width_m / 2.0, 9.2, 2.6))
    scene = Scene(BEND_OUTLINE, *posts)
    navigator, there = explored(scene, 80.0, level, seed=seed)
    assert there.x_m > 10.0, "it has flown through"
    track = flown_home(navigator, scene, there, level, most_s=250.0)
    assert navigator.is_home
    assert not navigator.homing.is_closed
    assert math.hypot(track.poses[-1].x_m, track.poses[-1].y_m) < 0.5
    assert track.distances_m().min() > 0.8


def test_behind_what_is_unseen_another_way_home_is_looked_for() -> None:
    """A door has closed behind it, and the other way round the ring has not been seen: it comes home by that."""
    navigator, there = explored(RING, 70.0)
    assert there.x_m > 8.0
    assert there.y_m > 14.0
    closed = Scene(box(-4.0, -2.0, 22.0, 18.0), box(2.0, 2.0, 18.0, 14.0), box(-4.0, 8.0, 2.0, 8.3))
    track = flown_home(navigator, closed, there, most_s=300.0)
    assert navigator.is_home
    assert not navigator.homing.is_closed
    assert math.hypot(track.poses[-1].x_m, track.poses[-1].y_m) < 0.5


def door(navigator: Navigator, there: Pose) -> list[tuple[float, float]]:
    """A wall across the drift, half way along the shorter side of the ring."""
    way = navigator.homing.way_home(RING.measure(there), there, there.t_s + 100.0)
    assert way is not None
    south_first = there.y_m <= 2.0 or (there.x_m >= 18.0 and there.y_m < 8.0)
    return box(9.0, -2.0, 9.3, 2.0) if south_first else box(-4.0, 8.0, 2.0, 8.3)


def test_before_anything_was_flown_nobody_knows_where_home_is() -> None:
    """No way home is not a way home of length 0."""
    navigator = Navigator(law_parameters(), np.random.default_rng(1))
    seen = BEND.measure(START)
    assert navigator.way_home(seen, START) is None
    assert not navigator.go_home(0.0)
    assert not navigator.is_home


def test_what_stands_at_home_now_is_not_flown_into() -> None:
    """A machine was parked where it started: it lands beside it, at a place that it has flown over, and says so."""
    navigator, there = explored(BEND, 40.0, lambda seen, pose: (replace(seen, ground_slope=0.0), pose))
    parked = Scene(BEND_OUTLINE, box(-1.0, -1.0, 1.0, 1.0))
    track = flown_home(navigator, parked, there)
    end = track.poses[-1]
    assert navigator.is_home
    assert navigator.homing.lands_elsewhere
    assert 1.0 < math.hypot(end.x_m, end.y_m) < 6.0
    assert track.distances_m().min() > 0.6


def test_at_home_it_stands() -> None:
    """Until somebody lands it: it does not wander on, and says that it is home."""
    navigator, there = explored(BEND, 20.0)
    track = flown_home(navigator, BEND, there)
    end = track.poses[-1]
    after = fly(navigator, BEND, end, 2.0 * SETTLING_S, view_rad=CAMERA_RAD)
    assert navigator.is_home
    assert max(math.hypot(pose.x_m, pose.y_m) for pose in after.poses) < GONE_M


def test_the_coin_finds_home_too() -> None:
    """With the paper's own choice nothing is known that decides the exploring; the way home is known all the same."""
    navigator = Navigator(law_parameters(period_s=0.1, speed_mps=1.0, choice="coin"), np.random.default_rng(1))
    track = fly(navigator, BEND, START, 40.0, view_rad=CAMERA_RAD)
    flown_home(navigator, BEND, track.poses[-1])
    assert navigator.is_home


def test_the_exploring_is_over_for_the_graph() -> None:
    """G is what was met while exploring: the way home adds no edge to it, and declines no exit."""
    navigator, there = explored(BEND, 40.0)
    navigator.go_home(there.t_s)
    before = navigator.graph.snapshot().counts()
    flown_home(navigator, BEND, there)
    assert navigator.graph.snapshot().counts() == before


def test_told_twice_it_goes_on() -> None:
    """Orders come twice over a bad link: the second one does not begin the way anew."""
    navigator, there = explored(BEND, 30.0)
    assert navigator.go_home(there.t_s)
    homeward = navigator.homing.homeward
    assert navigator.go_home(there.t_s + 1.0)
    assert navigator.homing.homeward is homeward
    assert navigator.status.mode is not Mode.HOLD
