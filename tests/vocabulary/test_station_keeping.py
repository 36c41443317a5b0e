"""Staying where one is: slowly, always towards the place, on axes of either hand, never by a number that is none."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.station_keeping import GAIN_PER_S, MOST_MPS, PATIENCE_S, STANDS_MPS, StationKeeper, Vector

FAR_M = 1e6
STILL: Vector = (0.0, 0.0, 0.0)
PLACES = st.tuples(*(st.floats(-FAR_M, FAR_M),) * 3)
NEAR = st.tuples(*(st.floats(-0.1, 0.1),) * 3)
HEADINGS = st.floats(-7.0, 7.0)


def kept(place_m: Vector) -> StationKeeper:
    """It has come to stand there."""
    keeper = StationKeeper()
    assert keeper.velocity(place_m, STILL, 0.0, 64.0) == STILL
    assert keeper.place_m == place_m
    return keeper


def plane(asked: Vector, heading_rad: float) -> tuple[float, float]:
    """Along the two axes of the plane, by the definition of the heading and nothing else.

    One step along the heading is (cos, sin); one step a right angle further is the same of heading + 90°.
    """
    along, across = asked[:2]
    further = heading_rad + math.pi / 2.0
    return (
        along * math.cos(heading_rad) + across * math.cos(further),
        along * math.sin(heading_rad) + across * math.sin(further),
    )


@given(PLACES, PLACES, HEADINGS)
def test_it_is_never_fast(place_m: Vector, at_m: Vector, heading_rad: float) -> None:
    """Protects a vehicle that is meant to stand from a position that leaps: it follows at a crawl at most."""
    asked = kept(place_m).velocity(at_m, STILL, heading_rad, 65.0)
    assert math.hypot(*asked[:2]) <= MOST_MPS + 1e-12
    assert abs(asked[2]) <= MOST_MPS


@given(PLACES, PLACES, HEADINGS)
def test_it_leads_straight_to_the_place(place_m: Vector, at_m: Vector, heading_rad: float) -> None:
    """Protects from being led away: the velocity points from where it is to where it shall be, up and down too."""
    asked = kept(place_m).velocity(at_m, STILL, heading_rad, 65.0)
    way_m = [there - here for there, here in zip(place_m, at_m, strict=True)]
    first, second = plane(asked, heading_rad)
    length_m = math.hypot(*way_m[:2])
    speed = min(MOST_MPS, GAIN_PER_S * length_m)
    assert (first * way_m[0] + second * way_m[1]) == pytest.approx(speed * length_m, rel=1e-6, abs=1e-9)
    assert first * way_m[1] - second * way_m[0] == pytest.approx(0.0, abs=1e-9 * max(1.0, length_m))
    assert asked[2] == pytest.approx(max(-MOST_MPS, min(MOST_MPS, GAIN_PER_S * way_m[2])))


@given(NEAR, HEADINGS)
def test_it_arrives(offset_m: Vector, heading_rad: float) -> None:
    """Protects from swinging and from creeping on: what obeys is back within a few seconds, whatever it creeps with."""
    keeper, at_m = kept(STILL), offset_m
    for tick in range(400):
        asked = keeper.velocity(at_m, STILL, heading_rad, 64.0 + 0.05 * tick)
        moves = (*plane(asked, heading_rad), asked[2])
        at_m = (at_m[0] + 0.05 * moves[0], at_m[1] + 0.05 * moves[1], at_m[2] + 0.05 * moves[2])
    assert math.hypot(*at_m) < 1e-3


@pytest.mark.parametrize("creep_mps", [0.02, 0.06])
def test_a_creep_ends_within_the_way_that_the_budget_counts(creep_mps: float) -> None:
    """Protects `safety.creep_m`: PX4 creeps at 0.06 m/s on zero; led back it stops after 0.06 / 0.5 = 0.12 m."""
    keeper, north_m = kept(STILL), 0.0
    for tick in range(2400):
        asked = keeper.velocity((north_m, 0.0, 0.0), STILL, 0.0, 64.0 + 0.05 * tick)
        north_m += 0.05 * (creep_mps + asked[0])
    assert north_m == pytest.approx(creep_mps / GAIN_PER_S, abs=1e-3)
    assert north_m <= 0.12 + 1e-3


@pytest.mark.parametrize(
    ("axes", "heading_rad", "asked"),
    [
        pytest.param("north, east, clockwise", math.pi / 2.0, (0.0, -0.05), id="looks east: north is to the left"),
        pytest.param("east, north, counter-clockwise", 0.0, (0.0, 0.05), id="looks east: north is to the left, too"),
    ],
)
def test_either_hand(axes: str, heading_rad: float, asked: tuple[float, float]) -> None:
    """Protects gate and law, whose axes differ: it stands 0.1 m south of its place and looks east.

    The gate's second number is to the right of the heading, the law's to the left of it.
    """
    north_first = axes.startswith("north")
    keeper = kept((0.1, 0.0, 0.0) if north_first else (0.0, 0.1, 0.0))
    assert keeper.velocity(STILL, STILL, heading_rad, 65.0)[:2] == pytest.approx(asked)


def test_until_it_stands_it_is_asked_to_stand() -> None:
    """Protects the stop: the place is where it came to stand, not where the stop began; going back would be a lurch."""
    keeper = StationKeeper()
    for tick, speed in enumerate((0.5, 0.3, STANDS_MPS + 1e-6)):
        assert keeper.velocity((0.1 * tick, 0.0, 0.0), (0.0, speed, 0.0), 0.0, 64.0 + 0.5 * tick) == STILL
        assert keeper.place_m is None
    keeper.velocity((0.3, 0.0, 0.0), (0.0, STANDS_MPS, 0.0), 0.0, 65.5)
    assert keeper.place_m == (0.3, 0.0, 0.0)
    keeper.velocity((0.5, 0.0, 0.0), (0.5, 0.0, 0.0), 0.0, 66.0)
    assert keeper.place_m == (0.3, 0.0, 0.0), "a push does not move it"


def test_who_never_seems_to_stand_is_kept_all_the_same() -> None:
    """Protects a vehicle whose velocity estimate is noisy: after two seconds its place is taken as it is."""
    keeper = StationKeeper()
    for now_s in (64.0, 64.0 + PATIENCE_S - 2.0**-10):
        assert keeper.velocity(STILL, (0.2, 0.0, 0.0), 0.0, now_s) == STILL
        assert keeper.place_m is None
    keeper.velocity((1.0, 0.0, 0.0), (0.2, 0.0, 0.0), 0.0, 64.0 + PATIENCE_S)
    assert keeper.place_m == (1.0, 0.0, 0.0)


@given(st.integers(0, 6), st.sampled_from([math.nan, math.inf, -math.inf]))
def test_what_is_no_number_begins_anew(which: int, value: float) -> None:
    """Protects the wire from NaN, and the place from an estimator that lost it: what comes after is another place."""
    keeper = kept((5.0, 0.0, 0.0))
    numbers = [0.0] * 7
    numbers[which] = value
    bad = (numbers[0], numbers[1], numbers[2]), (numbers[3], numbers[4], numbers[5]), numbers[6]
    assert keeper.velocity(*bad, 65.0) == STILL
    assert keeper.place_m is None
    assert keeper.velocity((9.0, 0.0, 0.0), (0.5, 0.0, 0.0), 0.0, 64.0 + 2.0 * PATIENCE_S) == STILL
    assert keeper.place_m is None, "its patience begins anew as well"


def test_who_may_move_again_has_no_place() -> None:
    """Protects the next stop from being led back to the last one."""
    keeper = kept((5.0, 0.0, 0.0))
    keeper.release()
    assert keeper.velocity(STILL, STILL, 0.0, 65.0) == STILL
    assert keeper.place_m == STILL
