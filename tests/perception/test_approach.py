"""What comes nearer is told by a sensor's own distances, and nothing else is taken for it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from companion.model import Beam, Pose
from companion.perception.approach import NEAR_M, STALE_S, Approach, nearest_of
from companion.sides import NOTHING_NEAR
from tests.perception.observations import DOWN, extractor, later, observed
from tests.perception.scenes import AT_START, FLOOR, ROOF, wall_ahead, wall_beside

CAMERA_S = 0.2
"""Between two frames of the slowest camera that the presets know."""


def approached(
    drift_mps: float, period_s: float = CAMERA_S, looks: int = 5, yaw_rate_radps: float = 0.0, flown_mps: float = 0.0
) -> Approach:
    """A wall to the left that is 1 m away at the last look, at 0 s; ``flown_mps`` of it is known to the vehicle."""
    approach = Approach(math.pi / 2.0)
    for i in range(1 - looks, 1):
        t_s = period_s * i
        approach.see(t_s, 1.0 - (drift_mps + flown_mps) * t_s, (9.0, flown_mps * t_s), yaw_rate_radps * t_s)
    return approach


def looked(approach: Approach, t_s: float, distance_m: float) -> Approach:
    """One more look from where it was."""
    approach.see(t_s, distance_m, (9.0, 0.0), 0.0)
    return approach


@pytest.mark.parametrize("closing_mps", [0.4, 0.0, -0.3])
@pytest.mark.parametrize("period_s", [0.2, 0.1, 0.03])
def test_a_wall_that_comes_nearer_is_seen_to(closing_mps: float, period_s: float) -> None:
    """Protects from a bad GPS: the autopilot says that it flies straight on, and is carried into the wall beside."""
    for flown_mps in (0.0, 0.3, -0.3):
        side = approached(closing_mps, period_s, looks=30, flown_mps=flown_mps).side(0.0, flown_mps)
        assert side == pytest.approx((1.0, flown_mps + max(0.0, closing_mps)))


def test_who_brakes_is_not_taken_to_go_on() -> None:
    """Protects every approach to a wall: by distances alone the speed is that of half a second ago."""
    approach = Approach(0.0)
    for i in range(9):
        t_s = 0.1 * i
        flown_m = 0.5 * t_s - 0.25 * t_s**2
        approach.see(t_s, 1.5 - flown_m, (flown_m, 0.0), 0.0)
    assert approach.side(0.8, 0.1) == pytest.approx((1.26, 0.1))


def test_it_goes_on_until_the_next_look() -> None:
    """Protects from half of a camera's period of blindness; what goes away is not counted to be further."""
    assert approached(0.4).side(0.1, 0.0).distance_m == pytest.approx(0.96)
    assert approached(-0.4).side(0.1, 0.0).distance_m == 1.0
    assert approached(0.4).side(STALE_S + 0.01, 0.0) == NOTHING_NEAR, "stale is not fresh"
    assert approached(0.4).side(-0.01, 0.0) == NOTHING_NEAR, "nor is the future"


def test_too_few_looks_tell_no_speed() -> None:
    """Protects from a stop for noise: two looks 3 cm apart are none."""
    assert approached(0.4, looks=3).side(0.0, 0.0) == (1.0, 0.0)
    assert approached(0.4, period_s=0.03, looks=9).side(0.0, 0.0) == (1.0, 0.0), "all within 0.24 s"


def test_an_edge_is_not_an_approach() -> None:
    """Protects from stopping at each corner: another wall came into view, the vehicle did not jump."""
    approach = approached(0.0)
    looked(approach, 0.2, 0.6)
    assert approach.side(0.2, 0.0) == (0.6, 0.0)


@pytest.mark.parametrize("closing_mps", [0.8, 2.0])
def test_what_comes_too_fast_is_another_surface(closing_mps: float) -> None:
    """Protects from stopping for a wall that a beam grazes: 1 m/s nearer without anybody having moved."""
    assert approached(closing_mps, period_s=0.1).side(0.0, 0.0) == (1.0, 0.0)


def test_rough_rock_is_not_an_approach() -> None:
    """Protects the flight along a wall that juts out: what drifts comes nearer steadily."""
    approach = Approach(math.pi / 2.0)
    for i, distance_m in enumerate((1.2, 1.2, 1.18, 1.19, 1.2, 1.0, 1.01, 1.0)):
        looked(approach, 0.1 * i, distance_m)
    assert approach.side(0.75, 0.0) == (1.0, 0.0)


def test_who_turns_is_told_nothing() -> None:
    """Protects every turn: a wall seen askew seems to come nearer at 0.4 m/s at 0.6 rad/s."""
    assert approached(0.4, yaw_rate_radps=0.6).side(0.0, 0.0).closing_mps == 0.0
    assert approached(0.4, yaw_rate_radps=0.05).side(0.0, 0.0).closing_mps == pytest.approx(0.4)


def test_noise_is_not_an_approach() -> None:
    """Protects the flight along a wall: 2 cm of noise must not look like 0.1 m/s more often than now and then."""
    rng = np.random.default_rng(1)
    told = []
    for _ in range(500):
        approach = Approach(math.pi / 2.0)
        for i in range(9):
            looked(approach, 0.1 * i, 1.0 + rng.normal(0.0, 0.02))
        told.append(abs(approach.side(0.8, 0.0).closing_mps))
    assert np.mean(np.array(told) > 0.1) < 0.01


@pytest.mark.parametrize("distance_m", [math.inf, math.nan, -1.0, NEAR_M + 0.01])
def test_what_is_not_near_is_nothing(distance_m: float) -> None:
    """Protects the law from numbers that are none."""
    approach = approached(0.4)
    looked(approach, 0.2, distance_m)
    assert approach.side(0.2, 0.0) == NOTHING_NEAR


def test_an_old_look_says_nothing() -> None:
    """Protects from the same frame at each tick: it would look like standing still."""
    approach = approached(0.4)
    looked(looked(approach, 0.0, 2.0), -0.1, 2.0)
    assert approach.side(0.0, 0.0) == pytest.approx((1.0, 0.4))


def test_the_nearest_and_the_fastest_count() -> None:
    """Protects from the sensor that sees less: a beam beside a pillar that the camera sees."""
    side = nearest_of([approached(0.1), approached(0.4), Approach(0.0)], 0.1, 0.0)
    assert side == pytest.approx((0.96, 0.4))


def test_the_measurement_has_all_four_sides() -> None:
    """Protects which beam is which side, and the camera's share: ahead."""
    extract = extractor()
    for i in range(9):
        ranges = {**DOWN, Beam.LEFT: 1.4 - 0.04 * i, Beam.BACK: 0.9, Beam.RIGHT: 0.76}
        pose: Pose = later(AT_START, 0.1 * i)
        sides = extract.measure(observed(pose, [FLOOR, ROOF, wall_ahead(2.0 - 0.03 * i)], ranges)).sides
    assert sides.front == pytest.approx((1.76, 0.3), abs=0.02)
    assert sides.left == pytest.approx((1.08, 0.4))
    assert sides.back == pytest.approx((0.9, 0.0))
    assert sides.right == pytest.approx((0.76, 0.0))


def test_a_wall_that_the_camera_saw_a_moment_ago_is_beside_now() -> None:
    """Protects from the corner behind a beam: 0.62 m away at 120°, while the beam at 90° saw 0.77 m."""
    extract = extractor()
    extract.measure(observed(AT_START, [FLOOR, ROOF, wall_beside(0.9)], DOWN))
    for after_s, near in ((0.5, True), (2.5, True), (3.5, False)):
        pose = later(AT_START, after_s, x_m=AT_START.x_m + 2.0, vy_mps=0.2)
        left = extract.measure(observed(pose, [FLOOR, ROOF], DOWN)).sides.left
        assert left == (pytest.approx((0.9, 0.2), abs=0.05) if near else NOTHING_NEAR), after_s
