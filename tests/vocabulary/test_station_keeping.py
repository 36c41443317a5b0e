"""Staying in place by velocities: back to where it came to stand, slowly, whichever way it looks."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from companion.station_keeping import MOST_MPS, PATIENCE_S, STANDS_MPS, StationKeeper, Vector

STILL: Vector = (0.0, 0.0, 0.0)
ROUNDING = 1e-12

anything = st.floats(allow_nan=True, allow_infinity=True)
numbers = st.floats(-1e6, 1e6)
vectors = st.tuples(numbers, numbers, numbers)


def standing(at_m: Vector = STILL) -> StationKeeper:
    """It has come to stand here."""
    keeper = StationKeeper()
    assert keeper.velocity(at_m, STILL, 0.0, 0.0) == STILL
    return keeper


def test_the_place_is_where_it_came_to_stand() -> None:
    """Protects from being led back to where braking began: that would be flying backward at each stop."""
    keeper = StationKeeper()
    for step in range(10):
        assert keeper.velocity((0.1 * step, 0.0, 0.0), (0.4, 0.0, 0.0), 0.0, 0.1 * step) == STILL
    assert keeper.place_m is None
    keeper.velocity((1.0, 0.0, 0.0), (0.9 * STANDS_MPS, 0.0, 0.0), 0.0, 1.0)
    assert keeper.place_m == (1.0, 0.0, 0.0)


def test_a_velocity_that_never_tells_that_it_stands_is_waited_for_no_longer_than_its_patience() -> None:
    """Protects from an estimate with a bias: it would creep for as long as it is asked to stand."""
    keeper = StationKeeper()
    moving = (2.0 * STANDS_MPS, 0.0, 0.0)
    keeper.velocity(STILL, moving, 0.0, 50.0)
    keeper.velocity((1.0, 0.0, 0.0), moving, 0.0, 50.0 + PATIENCE_S - 0.01)
    assert keeper.place_m is None
    keeper.velocity((2.0, 0.0, 0.0), moving, 0.0, 50.0 + PATIENCE_S)
    assert keeper.place_m == (2.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("away_m", "heading_rad", "back"),
    [
        ((0.1, 0.0, 0.0), 0.0, (-0.05, 0.0, 0.0)),
        ((0.0, 0.1, 0.0), 0.0, (0.0, -0.05, 0.0)),
        ((0.1, 0.0, 0.0), 0.5 * math.pi, (0.0, 0.05, 0.0)),
        ((0.0, 0.1, 0.0), 0.5 * math.pi, (-0.05, 0.0, 0.0)),
        ((0.1, 0.0, 0.0), math.pi, (0.05, 0.0, 0.0)),
        ((0.0, 0.0, 0.1), 0.5 * math.pi, (0.0, 0.0, -0.05)),
        ((3.0, 4.0, 9.0), 0.0, (-0.06, -0.08, -MOST_MPS)),
    ],
)
def test_what_has_crept_away_is_led_back_slowly(away_m: Vector, heading_rad: float, back: Vector) -> None:
    """Protects the direction, for each heading by hand: the other sign flies away ever faster."""
    keeper = standing()
    assert keeper.velocity(away_m, STILL, heading_rad, 1.0) == pytest.approx(back, abs=ROUNDING)
    assert keeper.place_m == STILL, "the place is kept, however far it has crept"


@given(place_m=vectors, at_m=vectors, heading_rad=st.floats(-10.0, 10.0))
@example(place_m=STILL, at_m=(5e-324, 0.0, 0.0), heading_rad=0.0)
def test_it_is_led_to_the_place_and_never_fast(place_m: Vector, at_m: Vector, heading_rad: float) -> None:
    """Protects what is only meant to stand: a position that leaps by kilometres moves it at a crawl."""
    forward, side, third = standing(place_m).velocity(at_m, STILL, heading_rad, 1.0)
    assert math.hypot(forward, side) <= MOST_MPS + ROUNDING
    assert abs(third) <= MOST_MPS
    cos, sin = math.cos(heading_rad), math.sin(heading_rad)
    first, second = forward * cos - side * sin, forward * sin + side * cos
    to_first, to_second = place_m[0] - at_m[0], place_m[1] - at_m[1]
    away_m = math.hypot(to_first, to_second)
    # Along the way back, by the rounding of its length.
    assert first * to_second - second * to_first == pytest.approx(0.0, abs=ROUNDING * max(away_m, 1.0))
    assert first * to_first + second * to_second >= -ROUNDING * max(away_m, 1.0)


def test_it_comes_back_without_swinging() -> None:
    """Protects the gain: with the lag of an autopilot's velocity loop, it hardly overshoots."""
    keeper = standing()
    place_m, speed_mps, dt_s, lag_s = 0.5, 0.0, 0.05, 1.0
    track = []
    for step in range(600):
        asked_mps = keeper.velocity((place_m, 0.0, 0.0), (speed_mps, 0.0, 0.0), 0.0, dt_s * step)[0]
        speed_mps += (asked_mps - speed_mps) * dt_s / lag_s
        place_m += speed_mps * dt_s
        track.append(place_m)
    assert min(track) > -0.05
    assert abs(track[-1]) < 0.01


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("which", range(7))
def test_what_is_not_finite_forgets_the_place(bad: float, which: int) -> None:
    """Protects the setpoints from NaN, and the vehicle from a place that was kept while nobody knew where it was."""
    keeper = standing()
    values = [0.0] * 7
    values[which] = bad
    assert (
        keeper.velocity((values[0], values[1], values[2]), (values[3], values[4], values[5]), values[6], 1.0) == STILL
    )
    assert keeper.place_m is None
    keeper.velocity((3.0, 0.0, 0.0), STILL, 0.0, 2.0)
    assert keeper.place_m == (3.0, 0.0, 0.0)


def test_what_is_released_begins_anew() -> None:
    """Protects a vehicle that has flown on from being led back to its last stop."""
    keeper = standing()
    keeper.release()
    assert keeper.velocity((5.0, 0.0, 0.0), (0.5, 0.0, 0.0), 0.0, 10.0) == STILL
    assert keeper.place_m is None, "its patience counts from here too"


@given(st.lists(st.tuples(anything, anything, anything, anything), min_size=2, max_size=6))
@example([(1.7e308, 0.0, 0.0, 0.0), (-1.7e308, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)])
def test_whatever_comes_it_answers_with_finite_slow_velocities(states: list[tuple[float, float, float, float]]) -> None:
    """Protects the setpoints from every number that a float can be."""
    keeper = StationKeeper()
    for now_s, ((x_m, y_m, z_m, heading_rad), (*_, vx_mps)) in enumerate(pairwise(states)):
        back = keeper.velocity((x_m, y_m, z_m), (vx_mps, 0.0, 0.0), heading_rad, float(now_s))
        assert all(math.isfinite(each) and abs(each) <= MOST_MPS + ROUNDING for each in back)
