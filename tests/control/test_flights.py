"""Small flights of the whole navigator in worlds of polygons: signs, mirrors, seeds, a convex room, chatter."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.config.sim import NoiseSettings
from companion.control.governor import ROOM_M
from companion.control.navigator import Navigator
from companion.model import FloatArray, Measurement, Mode, Pose, wrap_rad
from tests.control.scene import Scene, Track, box, fly, law_parameters, measurement, mirrored_measurement, mirrored_pose
from tests.control.stages import DT_S, NEVER, ORIGIN, compiled, in_boundary, in_tangent, navigator_with, random_scan

# Flights.

PERIOD_S = 0.1
"""Sampling period of the paper's experiment (Table II), twice that of its simulation: half the time for a test."""


def picture(track: Track, blocks: list[tuple[float, float, float, float]]) -> str:
    """The flight from above, north up, one character for half a metre: # rock, . R2, o R3, > where it began."""
    x_min, x_max, y_min, y_max = -1.0, 13.0, -6.0, 6.0
    rows = [[" "] * round(2.0 * (x_max - x_min) + 1.0) for _ in range(round(2.0 * (y_max - y_min) + 1.0))]
    marks = [((x, y), "#") for a, b, c, d in blocks for x in np.arange(a, c, 0.5) for y in np.arange(b, d, 0.5)]
    signs = {Mode.CIRCLE: ">", Mode.TANGENT: ".", Mode.BOUNDARY: "o", Mode.HOLD: "!"}
    marks += [((pose.x_m, pose.y_m), signs[mode]) for pose, mode in zip(track.poses, track.modes, strict=True)]
    for (x, y), sign in [*marks, ((0.0, 0.0), ">")]:
        row, column = round(2.0 * (y_max - y)), round(2.0 * (x - x_min))
        if 0 <= row < len(rows) and 0 <= column < len(rows[0]):
            rows[row][column] = sign
    return "\n".join("".join(row).rstrip() for row in rows)


#    Γ = 1                                  Γ = -1
#            +-----+                            ..o ooo
#    >.      |     |                           .  +-----+
#      ..    |     |                          .   |     | o
#        ..  +-----+                         .    |     | o
#          .. o o o                         >     +-----+
#    T right of the block, then round it    T left of the block, then round it clockwise:
#    counter-clockwise: rock on the left    rock on the right
@pytest.mark.parametrize("law", ["paper", "smooth"])
@pytest.mark.parametrize("gamma", [1, -1])
def test_the_picture_of_both_signs(gamma: int, law: str) -> None:
    """(10), Γ and (7) R2 and R3 together: past the block on its open side, then round it with the rock on Γ's hand."""
    low, high = sorted((-gamma * 0.5, gamma * 3.5))
    block = (5.0, low, 8.0, high)
    scene = Scene(box(-40.0, -40.0, 40.0, 40.0), box(*block))
    navigator = navigator_with(period_s=PERIOD_S, law=law, tangent_probability=NEVER)
    track = fly(navigator, scene, ORIGIN, 60.0)
    sys.stdout.write(f"\nΓ = {gamma}, {law} law\n{picture(track, [block])}\n")
    modes = [mode for mode, before in zip(track.modes, [None, *track.modes[:-1]], strict=True) if mode != before]
    assert modes == [Mode.TANGENT, Mode.BOUNDARY]
    assert navigator.status.gamma == gamma
    # T_m is d_s beside the corner, on the side away from the block.
    arrived = track.poses[track.modes.index(Mode.BOUNDARY)]
    assert math.dist((arrived.x_m, arrived.y_m), (5.0, -gamma * 0.5)) == pytest.approx(1.0, abs=0.3)
    assert (arrived.y_m + gamma * 0.5) * gamma < 0.0
    # The block is a tour of 2·(3 + 4) + 2π = 20 m, 41 s: once round it since arriving, the right way round.
    since = track.poses[track.modes.index(Mode.BOUNDARY) :]
    middle_y_m = (low + high) / 2.0
    ways = np.unwrap([math.atan2(pose.y_m - middle_y_m, pose.x_m - 6.5) for pose in since])
    assert gamma * (ways[-1] - ways[0]) > 2.0 * math.pi
    # And the rock was on Γ's hand, not only at the end: abeam give or take the turn at a corner.
    hands = [m.d_bearing_rad for m, mode in zip(track.seen, track.modes, strict=True) if mode is Mode.BOUNDARY]
    assert all(hand is not None and hand * gamma > 0.0 for hand in hands)


MINE = Scene(
    box(-6.0, -9.0, 16.0, 9.0),
    box(3.0, -5.5, 6.5, -1.5),
    box(3.0, 2.0, 6.5, 5.5),
    box(10.0, -4.0, 12.5, 4.0),
)
"""A hall with three pillars, each passage of it wider than 2·d_s."""


def columns(track: Track) -> FloatArray:
    """A flight as numbers, one row a sampling period."""
    return np.array(
        [
            (pose.x_m, pose.y_m, pose.yaw_rad, setpoint.speed_mps, setpoint.yaw_rate_radps)
            for pose, setpoint in zip(track.poses, track.setpoints, strict=True)
        ]
    )


@pytest.mark.parametrize("choice", ["coin", "frontier"])
def test_the_same_seed_flies_the_same_flight(choice: str) -> None:
    """Every decision comes from the generator that was handed in: a flight can be repeated from its seed alone."""

    def flight(seed: int) -> tuple[FloatArray, Any]:
        navigator = navigator_with(
            seed,
            period_s=PERIOD_S,
            choice=choice,
            speed_law="governor",
            pause_s=1.0,
            tangent_probability=0.5,
            least_probability=0.4,
        )
        return columns(fly(navigator, MINE, ORIGIN, 25.0)), navigator.status

    first, status = flight(3)
    again, status_again = flight(3)
    np.testing.assert_array_equal(first, again)
    assert status == status_again
    assert status.draws > 0
    assert not all(np.array_equal(first, flight(seed)[0]) for seed in range(4, 9))


@pytest.mark.parametrize("speed_law", ["paper", "governor"])
def test_the_mirrored_world_is_flown_the_mirrored_way(speed_law: str) -> None:
    """Left and right exchanged, and every yaw rate changes sign: one turn with a wrong sign, and the two part.

    The initial circle's side is drawn, not mirrored; an edge in view from the start lets R2 begin with the first tick.
    """
    start = Pose(0.0, 0.0, -4.0, 1.5, 0.0)
    tracks = []
    for scene, at in ((MINE, start), (MINE.mirrored(), mirrored_pose(start))):
        navigator = navigator_with(7, period_s=PERIOD_S, speed_law=speed_law, law="smooth", pause_s=1.0)
        tracks.append(fly(navigator, scene, at, 40.0))
    here, there = (columns(track) for track in tracks)
    assert tracks[0].modes == tracks[1].modes
    assert {Mode.TANGENT, Mode.BOUNDARY} <= set(tracks[0].modes)
    # The smooth law forgets rounding rather than amplifying it: 400 steps of 1e-16 stay far below this.
    np.testing.assert_allclose(there * [1.0, -1.0, -1.0, 1.0, -1.0], here, atol=1e-9)


@compiled
@given(
    seed=st.integers(0, 2**32 - 1),
    mode=st.sampled_from([Mode.TANGENT, Mode.BOUNDARY]),
    law=st.sampled_from(["paper", "smooth"]),
    d_m=st.floats(0.2, 5.0),
    bearing_rad=st.floats(0.01, 3.0).flatmap(lambda b: st.sampled_from([-b, b])),
    d_dot_mps=st.floats(-0.5, 0.5),
    yaw_rad=st.floats(-3.0, 3.0),
)
def test_one_mirrored_tick_gives_the_mirrored_setpoint(
    seed: int, mode: Mode, law: str, d_m: float, bearing_rad: float, d_dot_mps: float, yaw_rad: float
) -> None:
    """The same for any single tick, with scans that no real place would give. Dead ahead either side would do.

    Nothing is nearer than d_c in them: an escape draws its side, and of several that are as near one is moved from.
    """
    scan = random_scan(np.random.default_rng(seed))
    scan = scan._replace(ranges_m=np.maximum(scan.ranges_m, law_parameters().critical_margin_m + ROOM_M))
    told = measurement(scan, d_m=d_m, d_bearing_rad=bearing_rad, d_front_m=d_m, d_dot_mps=d_dot_mps)
    pose = replace(ORIGIN, x_m=0.5, y_m=0.2, yaw_rad=yaw_rad, vx_mps=0.3, vy_mps=-0.1)
    begin: Callable[..., Navigator] = in_tangent if mode is Mode.TANGENT else in_boundary
    here = begin(1, law=law, speed_law="governor")
    there = begin(-1, law=law, speed_law="governor")
    one = here.step(told, pose, 1.0)
    other = there.step(mirrored_measurement(told), mirrored_pose(pose), 1.0)
    assert here.status.mode is there.status.mode
    assert here.status.gamma == -there.status.gamma
    # Sines of mirrored angles differ in their last bit.
    assert (other.speed_mps, other.yaw_rate_radps) == pytest.approx((one.speed_mps, -one.yaw_rate_radps), abs=1e-9)


# Chatter.


WALL_M = 200.0


def noisy_wall_flight(law: str, seed: int) -> FloatArray:
    """Yaw rates of 40 s beside a straight wall, with the noise that the simulation gives its sensors."""
    noise, rng = NoiseSettings(), np.random.default_rng(seed)
    sideways, forward = noise.range_noise_m, noise.velocity_noise_mps

    def disturb(seen: Measurement, pose: Pose) -> tuple[Measurement, Pose]:
        assert seen.d_m is not None
        assert seen.d_bearing_rad is not None
        told = replace(
            pose,
            vx_mps=pose.vx_mps + rng.normal(0.0, forward),
            vy_mps=pose.vy_mps + rng.normal(0.0, forward),
            yaw_rad=pose.yaw_rad + rng.normal(0.0, noise.pose_noise_rad),
        )
        towards_rad = told.yaw_rad + seen.d_bearing_rad
        closing_mps = told.vx_mps * math.cos(towards_rad) + told.vy_mps * math.sin(towards_rad)
        return replace(seen, d_m=seen.d_m + rng.normal(0.0, sideways), d_dot_mps=-closing_mps), told

    navigator = in_boundary(-1, law=law)
    track = fly(navigator, Scene(box(-WALL_M, -1.0, WALL_M, WALL_M)), ORIGIN, 40.0, disturb=disturb)
    assert set(track.modes) == {Mode.BOUNDARY}
    return track.yaw_rates_radps()


def sign_changes_per_s(rates_radps: FloatArray) -> float:
    """How often the commanded turn changes its side."""
    turns = np.sign(rates_radps[rates_radps != 0.0])
    return float(np.count_nonzero(np.diff(turns)) / (rates_radps.size * DT_S))


def swing_radps2(rates_radps: FloatArray) -> float:
    """How much the commanded yaw rate moves, in rad/s per s: what the airframe feels of it."""
    return float(np.sum(np.abs(np.diff(rates_radps))) / (rates_radps.size * DT_S))


def test_the_smooth_law_chatters_less() -> None:
    """The reason for the boundary layer: fewer changes of side, and far smaller ones, with the same noise."""
    paper, smooth = (noisy_wall_flight(law, seed=5) for law in ("paper", "smooth"))
    for name, rates in (("paper", paper), ("smooth", smooth)):
        changes, swing = sign_changes_per_s(rates), swing_radps2(rates)
        sys.stdout.write(f"\n{name} law: {changes:.2f} sign changes/s, yaw rate moves by {swing:.2f} rad/s per s")
    assert sign_changes_per_s(smooth) < sign_changes_per_s(paper)
    assert swing_radps2(smooth) < swing_radps2(paper)


# Extensions: what the paper leaves open.


@pytest.mark.parametrize("seed", [0, 2])
def test_a_convex_room_is_left_to_the_wall_after_a_full_turn(seed: int) -> None:
    """R1 finds no tangent in a convex room: after one full turn and not before, off to the wall, and counted."""
    room = Scene(box(-3.0, -2.5, 3.0, 2.5))
    navigator = navigator_with(seed, period_s=PERIOD_S, speed_law="governor", tangent_probability=NEVER)
    turn_s = 2.0 * math.pi / navigator.parameters.max_yaw_rate_radps
    # The last sample of the turn comes with the period after it; two periods cover the rounding of the sum.
    before = fly(navigator, room, ORIGIN, turn_s - 2.0 * PERIOD_S)
    assert set(before.modes) == {Mode.CIRCLE}
    assert navigator.status.extensions == 0
    after = fly(navigator, room, before.poses[-1], 90.0)
    assert navigator.status.extensions == 1
    assert [mode for mode in Mode if mode in after.modes] == [Mode.CIRCLE, Mode.TANGENT, Mode.BOUNDARY]
    assert after.modes[-1] is Mode.BOUNDARY
    assert float(np.min(after.distances_m())) >= navigator.parameters.critical_margin_m
    # It follows the wall all round, 14 m in the 80 s left: with the wall on the left (Γ = 1) clockwise about (0, 0).
    ways = np.unwrap([math.atan2(pose.y_m, pose.x_m) for pose in after.poses if math.hypot(pose.x_m, pose.y_m) > 1.0])
    assert -navigator.status.gamma * (ways[-1] - ways[0]) > 2.0 * math.pi


def test_the_side_of_the_wall_is_drawn_in_the_extension() -> None:
    """Both ways round a convex room are possible; 20 equal draws have a probability of 2·2^-20."""
    sides = set()
    for seed in range(20):
        navigator = navigator_with(seed)
        for i in range(7):
            pose = replace(ORIGIN, yaw_rad=wrap_rad(navigator.parameters.max_yaw_rate_radps * 2.0 * i))
            navigator.step(Scene(box(-4.0, -3.0, 4.0, 3.0)).measure(pose), pose, 2.0 * i)
        assert navigator.status.extensions == 1
        sides.add(navigator.status.gamma)
    assert sides == {-1, 1}
