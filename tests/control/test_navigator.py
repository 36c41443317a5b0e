"""The navigation algorithm A1 to A4: each rule by itself, and every mode against every event."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.control import edges
from companion.control.decisions import Choice
from companion.control.navigator import FORGET_TANGENT_S, Navigator
from companion.control.target import TargetKind
from companion.model import CLEAR, HIT, UNKNOWN, Input, Measurement, Mode, Pose, Scan, wrap_rad
from tests.control.scene import BEARINGS_RAD, Scene, box, fly, law_parameters, measurement, scan_of
from tests.control.stages import (
    ALWAYS,
    DT_S,
    IN_MODE,
    NEVER,
    OPEN,
    ORIGIN,
    QUARTER,
    Fixed,
    beside,
    compiled,
    edge_scan,
    edge_to_the_unknown,
    in_boundary,
    in_tangent,
    mode_of,
    navigator_with,
    random_scan,
    two_walls,
    wall_ahead,
)

# A1: the initial circle.


@pytest.mark.parametrize("seed", range(6))
def test_the_flight_begins_turning_on_the_spot(seed: int) -> None:
    """A1 with (12): R1, no speed, the largest yaw rate to either side, and no change of that side on the way."""
    navigator = navigator_with(seed)
    setpoints = [navigator.step(OPEN, ORIGIN, i * DT_S) for i in range(10)]
    assert mode_of(navigator) is Mode.CIRCLE
    assert {setpoint.speed_mps for setpoint in setpoints} == {0.0}
    assert {abs(setpoint.yaw_rate_radps) for setpoint in setpoints} == {navigator.parameters.max_yaw_rate_radps}
    assert len({setpoint.yaw_rate_radps for setpoint in setpoints}) == 1


def test_the_side_of_the_initial_circle_is_drawn() -> None:
    """A1: both circles are possible; 20 equal draws have a probability of 2·2^-20."""
    rates = {navigator_with(seed).step(OPEN, ORIGIN, 0.0).yaw_rate_radps for seed in range(20)}
    assert len(rates) == 2


# A2: R1 -> R2.


@pytest.mark.parametrize("gamma", [-1, 1])
@pytest.mark.parametrize("far_m", [pytest.param(9.0, id="HIT"), pytest.param(math.inf, id="CLEAR")])
def test_a_jump_to_what_was_seen_starts_a_tangent(far_m: float, gamma: int) -> None:
    """R1 -> R2: Γ names the side of the near wall, T_m is d_s beside its end."""
    navigator = navigator_with()
    scan = two_walls(4.0, far_m) if gamma < 0 else two_walls(far_m, 4.0)
    setpoint = navigator.step(measurement(scan), ORIGIN, 0.0)
    status = navigator.status
    assert (status.mode, status.gamma) == (Mode.TANGENT, gamma)
    assert status.target is not None
    assert status.target.kind is TargetKind.TANGENT
    # Rounding of polar coordinates and back.
    assert (status.target.x_m, status.target.y_m) == pytest.approx((4.0, -float(gamma)), abs=1e-12)
    assert setpoint.speed_mps == navigator.parameters.speed_mps
    # The target is on the right of the heading for Γ = 1: (7) R2 turns right, and left for -1.
    assert setpoint.yaw_rate_radps * gamma < 0.0


@pytest.mark.parametrize("gamma", [-1, 1])
def test_a_jump_to_the_unknown_starts_nothing(gamma: int) -> None:
    """R1 -> R2 never on a jump to UNKNOWN: the border of the camera's view would be an edge everywhere."""
    navigator = navigator_with()
    navigator.step(measurement(edge_to_the_unknown(gamma)), ORIGIN, 0.0)
    assert mode_of(navigator) is Mode.CIRCLE


@pytest.mark.parametrize(("state", "range_m"), [(UNKNOWN, 0.0), (HIT, 2.0)])
def test_a_tangent_whose_corridor_is_not_known_free_is_not_taken(state: np.uint8, range_m: float) -> None:
    """Definition 3.4: an obstacle, or a gap in what was seen, between the vehicle and T_m forbids the tangent."""
    scan = two_walls(9.0, 4.0)
    target_rad = -math.atan2(1.0, 4.0)
    inside = int(np.argmin(np.abs(BEARINGS_RAD - target_rad)))
    scan.state[inside], scan.ranges_m[inside] = state, range_m
    assert len(edges.find_edges(scan, law_parameters())) == 1
    navigator = navigator_with()
    navigator.step(measurement(scan), ORIGIN, 0.0)
    assert mode_of(navigator) is Mode.CIRCLE


@pytest.mark.parametrize("heading_rad", [0.0, 1.0, -2.0, 3.1])
def test_the_target_stands_still_in_the_world(heading_rad: float) -> None:
    """T_m is transformed into world coordinates once; flying on does not drag it along."""
    navigator = navigator_with()
    pose = Pose(0.0, 10.0, -20.0, 1.5, heading_rad)
    navigator.step(measurement(edge_scan(1)), pose, 0.0)
    target = navigator.status.target
    assert target is not None
    towards_rad = heading_rad - math.atan2(1.0, 4.0)
    expected = (
        10.0 + math.hypot(4.0, 1.0) * math.cos(towards_rad),
        -20.0 + math.hypot(4.0, 1.0) * math.sin(towards_rad),
    )
    assert (target.x_m, target.y_m) == pytest.approx(expected, abs=1e-12)
    navigator.step(measurement(edge_scan(-1)), replace(pose, x_m=11.0, yaw_rad=0.5), 0.05)
    assert navigator.status.target == target


# A3: R2 -> R3, and R2 -> R1.


@pytest.mark.parametrize(
    ("x_m", "y_m", "mode"),
    [
        pytest.param(3.5, -1.0, Mode.TANGENT, id="half a metre before"),
        pytest.param(3.79, -0.95, Mode.TANGENT, id="just outside of the radius"),
        pytest.param(3.83, -0.95, Mode.BOUNDARY, id="just inside"),
        pytest.param(4.0, -1.0, Mode.BOUNDARY, id="there"),
        pytest.param(4.3, -0.5, Mode.BOUNDARY, id="passed half a metre beside it"),
        pytest.param(3.7, -1.5, Mode.TANGENT, id="beside the way, not yet abeam"),
        pytest.param(5.0, 2.0, Mode.BOUNDARY, id="passed far beside it"),
    ],
)
def test_a_tangent_ends_at_its_target_or_beyond(x_m: float, y_m: float, mode: Mode) -> None:
    """R2 -> R3: |T_m - p| < ē, or T_m has been passed, because a vehicle may orbit a point for ever."""
    navigator = in_tangent(1, target_radius_m=0.2)
    navigator.step(OPEN, replace(ORIGIN, x_m=x_m, y_m=y_m), 1.0)
    assert mode_of(navigator) is mode
    assert navigator.status.gamma == 1


@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize(
    ("d_m", "bearing_rad", "mode"),
    [
        pytest.param(0.99, 0.0, Mode.BOUNDARY, id="ahead at d_s"),
        pytest.param(0.99, 0.9, Mode.BOUNDARY, id="ahead to the side"),
        pytest.param(1.2, 0.0, Mode.TANGENT, id="ahead, further than d_s"),
        pytest.param(0.99, QUARTER, Mode.TANGENT, id="passed by abeam"),
        pytest.param(0.99, 3.0, Mode.TANGENT, id="behind"),
        pytest.param(0.75, 1.4, Mode.BOUNDARY, id="well inside of d_s, just before abeam"),
        pytest.param(0.75, 1.8, Mode.TANGENT, id="well inside of d_s, but past it"),
    ],
)
def test_a_tangent_ends_where_a_boundary_comes_first(side: int, d_m: float, bearing_rad: float, mode: Mode) -> None:
    """R2 -> R3 at a wall that was not seen from the start: it is followed on the side where it is."""
    bearing_rad = side * (bearing_rad or 1e-3)
    navigator = in_tangent(-side)
    navigator.step(wall_ahead(d_m, bearing_rad), replace(ORIGIN, x_m=2.0), 1.0)
    assert mode_of(navigator) is mode
    assert navigator.status.gamma == (side if mode is Mode.BOUNDARY else -side)


@pytest.mark.parametrize("side", [-1, 1])
def test_the_governor_turns_towards_the_target_before_it_flies(side: int) -> None:
    """R2 with the governor: at the set speed when the target is ahead, slower the more it is abeam, never away."""
    speeds = []
    for degrees in (0.0, 40.0, 80.0, 120.0, 170.0):
        navigator = in_tangent(1, speed_law="governor")
        yaw_rad = wrap_rad(-math.atan2(1.0, 4.0) - side * math.radians(degrees))
        setpoint = navigator.step(OPEN, replace(ORIGIN, yaw_rad=yaw_rad), DT_S)
        speeds.append(setpoint.speed_mps)
        assert setpoint.yaw_rate_radps * side >= 0.0
    assert speeds[0] == navigator.parameters.speed_mps
    assert speeds == sorted(speeds, reverse=True)
    assert len(set(speeds)) == 4
    assert speeds[-1] == 0.0


def test_a_target_that_comes_no_nearer_is_given_up() -> None:
    """R2 -> R1 after the set number of half turns without progress: that long a turn on the spot never takes."""
    navigator = in_tangent(1, target_timeout_factor=2.5)
    patience_s = 2.5 * math.pi / navigator.parameters.max_yaw_rate_radps
    navigator.step(OPEN, ORIGIN, DT_S)
    navigator.step(OPEN, ORIGIN, patience_s)
    assert mode_of(navigator) is Mode.TANGENT
    setpoint = navigator.step(OPEN, replace(ORIGIN, x_m=0.05), patience_s + 2.0 * DT_S)
    assert mode_of(navigator) is Mode.CIRCLE
    assert navigator.status.target is None
    assert setpoint.speed_mps == 0.0


def test_a_target_that_is_crept_towards_is_kept() -> None:
    """Protects narrow drifts, flown slowly: by the clock every target there was given up, and it turned back."""
    navigator = in_tangent(1)
    for i in range(60):
        navigator.step(OPEN, replace(ORIGIN, x_m=0.05 * i), 2.0 * i)
        assert mode_of(navigator) is Mode.TANGENT


# A4: R3 -> R2.


def test_one_tangent_gets_one_draw() -> None:
    """A tangent seen in twenty successive samples is one tangent, also when no pause hides the second sample."""
    navigator = in_boundary(1, tangent_probability=NEVER, pause_s=0.0)
    for i in range(20):
        navigator.step(beside(1, edge_scan(-1)), replace(ORIGIN, x_m=0.025 * i), i * DT_S)
    assert (navigator.status.draws, navigator.status.accepted) == (1, 0)
    assert mode_of(navigator) is Mode.BOUNDARY


@pytest.mark.parametrize("gamma", [-1, 1])
def test_an_accepted_tangent_is_flown(gamma: int) -> None:
    """A4: with probability p off along the tangent, with the new Γ and the new target."""
    navigator = in_boundary(gamma, tangent_probability=ALWAYS)
    navigator.step(beside(gamma, edge_scan(-gamma)), ORIGIN, 0.0)
    status = navigator.status
    assert (status.mode, status.gamma, status.draws, status.accepted) == (Mode.TANGENT, -gamma, 1, 1)


def test_after_a_declined_draw_there_is_a_pause() -> None:
    """The paper: a tangent point close after a declined one is ignored, a later one is not."""
    navigator = in_boundary(1, tangent_probability=NEVER, pause_s=4.0)
    look = beside(1, edge_scan(-1))
    navigator.step(look, ORIGIN, 0.0)
    # 3 m on it is another edge: further away than d_s from the first.
    elsewhere = replace(ORIGIN, x_m=3.0)
    navigator.step(look, elsewhere, 3.95)
    assert navigator.status.draws == 1
    navigator.step(look, elsewhere, 4.05)
    assert navigator.status.draws == 2


def test_a_tangent_that_comes_back_gets_a_new_draw() -> None:
    """Coming round a second time is a second chance, or a way declined once would be closed for ever."""
    navigator = in_boundary(1, tangent_probability=NEVER, pause_s=0.0)
    edge, without = beside(1, edge_scan(-1)), beside(1)
    navigator.step(edge, ORIGIN, 0.0)
    navigator.step(without, ORIGIN, 1.0)
    navigator.step(edge, ORIGIN, FORGET_TANGENT_S - 0.1)
    assert navigator.status.draws == 1
    navigator.step(without, ORIGIN, FORGET_TANGENT_S + 1.0)
    navigator.step(edge, ORIGIN, 2.0 * FORGET_TANGENT_S)
    assert navigator.status.draws == 2


def test_a_jump_to_the_unknown_gets_no_draw() -> None:
    """R3 -> R2 follows the same rule of edges as R1 -> R2: unknown is not free."""
    navigator = in_boundary(1, tangent_probability=ALWAYS)
    navigator.step(beside(1, edge_to_the_unknown(-1)), ORIGIN, 0.0)
    assert (navigator.status.mode, navigator.status.draws) == (Mode.BOUNDARY, 0)


@pytest.mark.parametrize(("state", "range_m"), [(UNKNOWN, 0.0), (HIT, 2.0)])
def test_a_tangent_without_a_free_corridor_gets_no_draw(state: np.uint8, range_m: float) -> None:
    """Definition 3.4 holds in R3 as in R1, and what cannot be flown is no decision."""
    scan = two_walls(4.0, 9.0)
    inside = int(np.argmin(np.abs(BEARINGS_RAD - math.atan2(1.0, 4.0))))
    scan.state[inside], scan.ranges_m[inside] = state, range_m
    navigator = in_boundary(1, tangent_probability=ALWAYS)
    navigator.step(beside(1, scan), ORIGIN, 0.0)
    assert (navigator.status.mode, navigator.status.draws) == (Mode.BOUNDARY, 0)


#          pillar
#          +----+                      followed on the right: wall A. Its own corner takes no draw, because following
#     >    +----+                      A flies past it anyway; the pillar's does: to leave A for it is a decision.
#  ====A====+
@pytest.mark.parametrize("side", [-1, 1])
def test_the_edge_of_the_followed_wall_gets_no_draw(side: int) -> None:
    """No coin is thrown for what is done either way, on either side."""
    low, high = sorted((-side * 1.0, -side * 4.0))
    corner = Scene(box(-30.0, -12.0, 30.0, 12.0), box(-20.0, low, 5.0, high))
    navigator = in_boundary(-side, tangent_probability=ALWAYS)
    track = fly(navigator, corner, ORIGIN, 8.0)
    # The corner was there to be seen, with a free way past it, until it was abeam.
    assert edges.find_edges(corner.scan(track.poses[0]), navigator.parameters) != []
    assert edges.find_edges(corner.scan(track.poses[100]), navigator.parameters) != []
    assert navigator.status.draws == 0
    assert set(track.modes) == {Mode.BOUNDARY}


@pytest.mark.parametrize("side", [-1, 1])
def test_the_edge_of_another_wall_gets_its_draw(side: int) -> None:
    """The same flight past a pillar on the other hand: one tangent, one draw, taken."""
    low, high = sorted((side * 1.5, side * 5.0))
    pillar = Scene(box(-30.0, -1.0 - 11.0 * (side < 0), 30.0, 1.0 + 11.0 * (side > 0)), box(5.0, low, 5.4, high))
    navigator = in_boundary(-side, tangent_probability=ALWAYS)
    track = fly(navigator, pillar, ORIGIN, 1.0)
    assert (navigator.status.draws, navigator.status.accepted) == (1, 1)
    assert track.modes[-1] is Mode.TANGENT
    assert navigator.status.gamma == side


#    ====B====+
#     >                     a drift just 2·d_s wide: T beside the end of B lies on the way along A, but to have B on
#    ====A================  the left from there on is another way round
@pytest.mark.parametrize("side", [-1, 1])
def test_the_end_of_the_opposite_wall_gets_its_draw(side: int) -> None:
    """A tangent along the boundary is a decision all the same when it changes the side (Γ)."""
    (a_low, a_high), (b_low, b_high) = sorted((-side * 1.0, -side * 4.0)), sorted((side * 1.0, side * 4.0))
    drift = Scene(box(-20.0, a_low, 40.0, a_high), box(-20.0, b_low, 5.0, b_high))
    navigator = in_boundary(-side, tangent_probability=ALWAYS)
    navigator.step(drift.measure(ORIGIN), ORIGIN, 0.0)
    assert (navigator.status.draws, navigator.status.gamma) == (1, side)


# The probability.


def share_taken(p: float, flights: int, seed: int) -> float:
    """How often a tangent is taken, over flights that share one generator."""
    rng = np.random.default_rng(seed)
    taken = 0
    for _ in range(flights):
        navigator = in_boundary(1, rng=rng, tangent_probability=p)
        navigator.step(beside(1, edge_scan(-1)), ORIGIN, 0.0)
        assert navigator.status.draws == 1
        taken += navigator.status.accepted
    return taken / flights


@pytest.mark.parametrize("p", [0.3, 0.7])
def test_the_coin_falls_with_its_probability(p: float) -> None:
    """A4 with choice: coin. A right coin fails this bound once in a million generators (4.9 standard deviations)."""
    flights = 1000
    share = share_taken(p, flights, seed=1)
    assert abs(share - p) <= 4.9 * math.sqrt(p * (1.0 - p) / flights)


def taken_at(draw: float, ways_m: list[float], monkeypatch: pytest.MonkeyPatch) -> bool:
    """Whether a draw of that number takes the tangent when the ways (by tangent, by boundary) are so long."""
    monkeypatch.setattr(Choice, "_ways_m", lambda *_: tuple(ways_m))
    navigator = in_boundary(1, rng=Fixed(draw), choice="frontier", least_probability=0.1, tangent_probability=0.3)
    navigator.step(beside(1, edge_scan(-1)), ORIGIN, 0.0)
    assert navigator.status.draws == 1
    return navigator.status.accepted == 1


@pytest.mark.parametrize(
    ("ways_m", "p"),
    [
        pytest.param([5.0, 50.0], 0.9, id="the tangent leads to unseen ground sooner"),
        pytest.param([50.0, 5.0], 0.1, id="the boundary does"),
        pytest.param([5.0, math.inf], 0.9, id="only the tangent does"),
        pytest.param([math.inf, 5.0], 0.1, id="only the boundary does"),
        pytest.param([20.0, 20.0], 0.3, id="both alike"),
        pytest.param([20.0, 20.4], 0.3, id="a cell of difference does not decide"),
        pytest.param([math.inf, math.inf], 0.3, id="neither does"),
    ],
)
def test_the_frontier_choice_prefers_unseen_ground(
    ways_m: list[float], p: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """choice: frontier draws with 1 - p_min, p_min or p, as the shorter way to unseen ground says."""
    assert taken_at(p - 1e-9, ways_m, monkeypatch)
    assert not taken_at(p + 1e-9, ways_m, monkeypatch)


@compiled
@given(seed=st.integers(0, 2**32 - 1), least=st.floats(0.01, 0.49), p=st.floats(0.01, 0.99))
def test_both_outcomes_stay_possible_whatever_has_been_seen(seed: int, least: float, p: float) -> None:
    """Theorem 1 needs 0 < p < 1: with any ground seen, a draw below p_min takes the tangent, one above 1 - p_min not.

    A fixed p outside of [p_min, 1 - p_min] is the user's own, and stays what he set.
    """
    rng = np.random.default_rng(seed)
    bounds = {"choice": "frontier", "least_probability": least, "tangent_probability": p}
    seen = [random_scan(rng) for _ in range(3)]
    places = rng.uniform(-20.0, 20.0, (3, 2))
    for draw, taken in ((min(least, p) - 1e-9, 1), (max(1.0 - least, p) + 1e-9, 0)):
        navigator = in_boundary(1, rng=Fixed(draw), **bounds)
        ground = navigator.known_ground
        for scan, (x_m, y_m) in zip(seen, places, strict=True):
            ground.see(measurement(scan), replace(ORIGIN, x_m=float(x_m), y_m=float(y_m)))
        navigator.step(beside(1, edge_scan(-1)), ORIGIN, 0.0)
        assert (navigator.status.draws, navigator.status.accepted) == (1, taken)


# Extensions: what the paper leaves open.


def follow(navigator: Navigator, poses: Iterable[Pose]) -> list[Mode]:
    """Modes along a way that is given, half a second a pose, with the wall on the left all the time."""
    modes = []
    for i, pose in enumerate(poses, start=1):
        navigator.step(beside(1), pose, 0.5 * i)
        modes.append(mode_of(navigator))
    return modes


def circle(laps: float) -> list[Pose]:
    """From ORIGIN round a circle of 12.6 m to the right, a quarter of a metre a pose."""
    angles = np.arange(1, round(laps * 50.0) + 1) * (2.0 * math.pi / 50.0)
    return [
        replace(ORIGIN, x_m=2.0 * math.sin(a), y_m=2.0 * (math.cos(a) - 1.0), yaw_rad=wrap_rad(-float(a)))
        for a in angles
    ]


@pytest.mark.parametrize(("choice", "p"), [("coin", 0.3), ("frontier", 0.9)])
def test_a_lap_round_a_boundary_is_a_decision(choice: str, p: float) -> None:
    """A pillar without a tangent would be flown round for ever: after a lap, one draw, within [p_min, 1 - p_min]."""
    law = {"choice": choice, "tangent_probability": 0.3, "least_probability": 0.1}
    # A lap begins 2 m into R3 and is closed within a metre of its beginning: after 13.6 m at the earliest and 14.6 m at
    # the latest, which is 1.08 and 1.16 times round.
    stays = in_boundary(1, rng=Fixed(p + 1e-9), **law)
    leaves = in_boundary(1, rng=Fixed(p - 1e-9), **law)
    assert set(follow(stays, circle(1.2))) == {Mode.BOUNDARY}
    modes = follow(leaves, circle(1.2))
    assert set(modes[: round(0.9 * 50)]) == {Mode.BOUNDARY}
    assert modes[-1] is Mode.TANGENT
    assert leaves.status.target is not None
    assert leaves.status.target.kind is TargetKind.OPEN
    assert (leaves.status.extensions, leaves.status.draws) == (1, 0)


def test_a_lap_gets_one_draw() -> None:
    """Three laps are three draws, not one for every sample near the place where they began."""
    rng = Fixed(0.99)
    navigator = in_boundary(1, rng=rng)
    before = rng.draws
    follow(navigator, circle(3.1))
    assert rng.draws - before == 3


def test_coming_back_along_the_other_wall_is_no_lap() -> None:
    """Out along a drift and back is not round: the vehicle passes where it began, but the other way."""
    rng = Fixed(0.99)
    navigator = in_boundary(1, rng=rng)
    before = rng.draws
    out = [replace(ORIGIN, x_m=0.25 * i) for i in range(40)]
    follow(navigator, [*out, *[replace(pose, yaw_rad=-math.pi) for pose in reversed(out)]])
    assert rng.draws == before


def test_turning_on_the_spot_for_long_is_left_for_open_ground() -> None:
    """Where S has no room, narrower than 2·d_s, R3 turns for ever: after some turns off along the longest corridor."""
    navigator = in_boundary(1)
    modes = follow(navigator, [replace(ORIGIN, yaw_rad=wrap_rad(0.5 * i)) for i in range(45)])
    # Two turns are 25 steps of half a radian: not before one turn, and before the three and a half that are flown here.
    assert set(modes[:13]) == {Mode.BOUNDARY}
    assert Mode.TANGENT in modes
    assert navigator.status.extensions == 1


@pytest.mark.parametrize("speed_law", ["paper", "governor"])
def test_where_no_heading_lets_it_fly_it_looks_round_and_leaves(speed_law: str) -> None:
    """Half d_c before a wall (12) allows no heading at all: waiting for turns of R3 it would only drift into the wall.

    It stands, or backs away, while it turns once round, and leaves along what it saw then; the wall that it leaves does
    not count as one that comes first.
    """
    scene = Scene(box(0.35, -30.0, 40.0, 30.0))
    navigator = in_boundary(1, speed_law=speed_law)
    for i in range(24):
        pose = replace(ORIGIN, yaw_rad=wrap_rad(0.3 * i))
        asked = navigator.step(scene.measure(pose), pose, 0.1 + 0.5 * i)
        assert (mode_of(navigator) is Mode.CIRCLE) == (i < 21), "it looks round first"
        if i < 21:
            to_wall_mps = asked.speed_mps * math.cos(pose.yaw_rad) - asked.lateral_mps * math.sin(pose.yaw_rad)
            assert to_wall_mps <= 1e-9
    assert mode_of(navigator) is Mode.TANGENT
    assert navigator.status.extensions == 1
    target = navigator.status.target
    assert target is not None
    assert target.kind is TargetKind.OPEN
    assert target.x_m < -1.0
    away = replace(ORIGIN, yaw_rad=math.atan2(target.y_m, target.x_m))
    assert navigator.step(scene.measure(away), away, 13.0).speed_mps > 0.3
    assert mode_of(navigator) is Mode.TANGENT


def test_it_leaves_along_what_it_saw_while_it_turned() -> None:
    """Protects from a niche: its mouth was behind the camera when the turn ended, and so it was unknown, not free."""
    navigator = in_boundary(1)

    def looked(pose: Pose) -> Measurement:
        # A niche with rock within d_c on the one side and its mouth to the west; a camera sees a quarter of it.
        scan = scan_of(lambda b: math.inf if abs(wrap_rad(b + pose.yaw_rad - math.pi)) < 1.6 else 0.75)
        unseen = np.abs(scan.bearings_rad) > math.radians(43.0)
        return measurement(
            Scan(
                scan.bearings_rad,
                np.where(unseen & (scan.state == CLEAR), 0.0, scan.ranges_m),
                np.where(unseen & (scan.state == CLEAR), UNKNOWN, scan.state).astype(np.uint8),
                ~unseen,
            ),
            d_m=0.75,
            d_bearing_rad=wrap_rad(-pose.yaw_rad),
            d_front_m=0.75,
            d_dot_mps=0.0,
        )

    for i in range(25):
        pose = replace(ORIGIN, yaw_rad=wrap_rad(0.3 * i))
        navigator.step(looked(pose), pose, 0.1 + 0.5 * i)
        if mode_of(navigator) is Mode.TANGENT:
            break
    assert navigator.status.target is not None
    assert navigator.status.target.kind is TargetKind.OPEN
    assert abs(wrap_rad(navigator.status.target.bearing_rad(ORIGIN) - math.pi)) < 0.6
    assert abs(pose.yaw_rad) < 1.0, "the mouth was behind it then"


# Every mode against every event. R1 and R2 begin at ORIGIN with T_m at (4, -1); R3 follows a wall on its left there.


@dataclasses.dataclass(frozen=True)
class Event:
    """What one tick brings."""

    told: Measurement
    pose: Pose = ORIGIN
    t_s: float = 1.0


EVENTS = {
    "nothing in view": Event(OPEN),
    "nothing in view for long": Event(OPEN, t_s=1000.0),
    "wall beside": Event(beside(1)),
    "wall beside for long": Event(beside(1), t_s=1000.0),
    "an edge": Event(beside(1, edge_scan(-1))),
    "an edge to the unknown": Event(beside(1, edge_to_the_unknown(-1))),
    "wall ahead at d_s": Event(wall_ahead(0.95)),
    "wall ahead within d_c": Event(wall_ahead(0.6)),
    "at the target": Event(beside(1), pose=replace(ORIGIN, x_m=4.0, y_m=-1.0)),
    "sensor lost": Event(replace(beside(1), missing=(Input.DEPTH,))),
    "no scan": Event(replace(beside(1), scan=None)),
    "d not finite": Event(replace(beside(1), d_m=math.nan)),
    "pose not finite": Event(beside(1), pose=replace(ORIGIN, x_m=math.nan)),
}

C, T, B, H = Mode.CIRCLE, Mode.TANGENT, Mode.BOUNDARY, Mode.HOLD
STANDS, FLIES = 0.0, 1.0

AFTER: dict[str, dict[Mode, tuple[Mode, float]]] = {
    #                            R1              R2              R3
    "nothing in view":          {C: (C, STANDS), T: (T, FLIES), B: (B, FLIES)},
    "nothing in view for long": {C: (C, STANDS), T: (C, STANDS), B: (C, STANDS)},
    "wall beside":              {C: (C, STANDS), T: (T, FLIES), B: (B, FLIES)},
    "wall beside for long":     {C: (C, STANDS), T: (C, STANDS), B: (B, FLIES)},
    "an edge":                  {C: (T, FLIES), T: (T, FLIES), B: (T, FLIES)},
    "an edge to the unknown":   {C: (C, STANDS), T: (T, FLIES), B: (B, FLIES)},
    "wall ahead at d_s":        {C: (C, STANDS), T: (B, FLIES), B: (B, FLIES)},
    "wall ahead within d_c":    {C: (C, STANDS), T: (B, STANDS), B: (B, STANDS)},
    "at the target":            {C: (C, STANDS), T: (B, FLIES), B: (B, FLIES)},
    "sensor lost":              {C: (H, STANDS), T: (H, STANDS), B: (H, STANDS)},
    "no scan":                  {C: (H, STANDS), T: (H, STANDS), B: (H, STANDS)},
    "d not finite":             {C: (H, STANDS), T: (H, STANDS), B: (H, STANDS)},
    "pose not finite":          {C: (H, STANDS), T: (H, STANDS), B: (H, STANDS)},
}  # fmt: skip


@pytest.mark.parametrize("event", EVENTS)
@pytest.mark.parametrize("mode", IN_MODE)
def test_every_mode_answers_every_event(mode: Mode, event: str) -> None:
    """The state machine as a table: the mode after the tick, and whether (12) lets the vehicle move."""
    navigator = IN_MODE[mode](tangent_probability=ALWAYS)
    tick = EVENTS[event]
    setpoint = navigator.step(tick.told, tick.pose, tick.t_s)
    expected, share = AFTER[event][mode]
    assert mode_of(navigator) is expected
    if event == "wall ahead within d_c":
        assert setpoint.speed_mps < 0.0, "what should stand there has come too near"
    else:
        assert setpoint.speed_mps == share * navigator.parameters.speed_mps


# The height.


def test_the_height_law_sees_roof_slope_and_layer() -> None:
    """(6) is fed with what it can use: a low roof, the ground's slope times the speed flown, H(t) of (11)."""
    pose = Pose(0.0, 0.0, 0.0, 1.5, QUARTER, vy_mps=0.5)

    def climb(height_m: float = 1.5, **changes: Any) -> float:
        navigator = navigator_with(height_m=1.5)
        navigator.height_m = height_m
        return navigator.step(replace(OPEN, **changes), pose, 0.0).climb_mps

    assert climb() == 0.0
    assert climb(roof_m=0.3) < 0.0
    assert climb(roof_m=5.0) == 0.0
    # 0.5 m/s up a slope of 0.2, and down it; rounding of cos and sin.
    assert climb(ground_slope=0.2) == pytest.approx(0.1, abs=1e-12)
    assert climb(ground_slope=-0.2) == pytest.approx(-0.1, abs=1e-12)
    assert climb(height_m=1.6) == pytest.approx(0.1, abs=1e-12)
    assert climb(height_m=1.4) == pytest.approx(-0.1, abs=1e-12)


# Speed in R3.


@pytest.mark.parametrize("gamma", [-1, 1])
def test_what_it_turns_to_along_a_wall_is_braked_for_before_it_points_there(gamma: int) -> None:
    """Protects d_c in R3: it turned away from its wall at 1.2 m/s, past nothing, to another one, and came to 0.78 m."""

    def speed_mps(other_m: float, closing_mps: float) -> float:
        """With the followed wall at d_s, to which it comes so fast, and another one 57° off on the other side."""

        def ranges_m(bearing_rad: float) -> float:
            own = gamma * bearing_rad
            if 1.2 < own < 1.9:
                return 1.0 / math.sin(own)
            return other_m if abs(own + 1.0) < 0.15 else math.inf

        navigator = in_boundary(
            gamma, speed_law="governor", speed_mps=1.5, max_yaw_rate_radps=1.0, governor={"reaction_s": 1.0}
        )
        seen = measurement(
            scan_of(ranges_m), d_m=1.0, d_bearing_rad=gamma * QUARTER, d_front_m=1.0, d_dot_mps=-closing_mps
        )
        setpoint = navigator.step(seen, replace(ORIGIN, vx_mps=1.2, vy_mps=gamma * closing_mps), 0.0)
        assert setpoint.yaw_rate_radps == pytest.approx(-gamma * min(1.0, closing_mps / 0.12), abs=0.01)
        return setpoint.speed_mps

    assert speed_mps(2.0, 0.3) < 0.7 * speed_mps(9.0, 0.3)
    assert speed_mps(2.0, 0.0) == pytest.approx(speed_mps(9.0, 0.0)), "where it does not turn it is passed beside"
