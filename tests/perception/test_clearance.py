"""The free way ahead, as the safety gate is told of it: an obstacle, seen free, or not known."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.model import CLEAR, HIT, UNKNOWN, Scan
from companion.perception.extract import ahead_m
from companion.perception.look import bin_bearings

HALF_WIDTH_M = 0.45
BINS = 360
BEARINGS = bin_bearings(BINS)


def scan(*seen: tuple[float, np.uint8, float], bins: int = BINS) -> Scan:
    """Nothing known but the bins that hold these bearings (in degrees), each with its state and range."""
    made = Scan(bin_bearings(bins), np.zeros(bins), np.full(bins, UNKNOWN, np.uint8), np.zeros(bins, np.bool_))
    for bearing_deg, state, range_m in seen:
        b = int((math.radians(bearing_deg) + math.pi) / (2.0 * math.pi) * bins) % bins
        made.state[b], made.ranges_m[b] = state, range_m
    return made


def wall(x_m: float) -> Scan:
    """A wall across the way."""
    made = scan()
    ahead = np.abs(BEARINGS) < math.radians(80.0)
    made.state[ahead], made.ranges_m[ahead] = HIT, x_m / np.cos(BEARINGS[ahead])
    return made


@pytest.mark.parametrize("x_m", [0.0, 0.3, 3.0, 9.0])
def test_a_wall_across_the_way_is_its_distance(x_m: float) -> None:
    """Protects the gate's last line: this is the number that it compares with its hard limit."""
    assert ahead_m(wall(x_m), HALF_WIDTH_M) == pytest.approx(x_m)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_only_what_is_within_the_width_is_in_the_way(side: float) -> None:
    """Protects flight along a wall: 0.5 m beside it nothing is in the way, 0.4 m beside it the wall is."""
    for y_m, in_the_way in ((0.40, True), (0.50, False)):
        bearing_deg = side * math.degrees(math.atan2(y_m, 2.0))
        found = ahead_m(scan((0.5, CLEAR, 10.0), (bearing_deg, HIT, math.hypot(2.0, y_m))), HALF_WIDTH_M)
        # A bin of 1° is half a bin off at 2 m.
        assert found == (pytest.approx(2.0, abs=0.02) if in_the_way else math.inf)


@pytest.mark.parametrize("bearing_deg", [90.5, 120.0, 179.0, -179.0, -90.5])
def test_what_is_behind_is_not_ahead(bearing_deg: float) -> None:
    """Protects flying away from a wall."""
    assert math.isnan(ahead_m(scan((bearing_deg, HIT, 0.2)), HALF_WIDTH_M))


def test_one_obstacle_counts_among_all_that_is_clear_whichever_comes_first() -> None:
    """Protects from "free" winning over an obstacle: neither order of the bearings nor a nearer CLEAR may."""
    for bearing_deg in (-2.5, -0.5, 0.5, 2.5):
        made = scan(*((b, CLEAR, 10.0) for b in (-2.5, -1.5, -0.5, 0.5, 1.5, 2.5)))
        b = int((math.radians(bearing_deg) + math.pi) / (2.0 * math.pi) * BINS)
        made.state[b], made.ranges_m[b] = HIT, 4.0
        assert ahead_m(made, HALF_WIDTH_M) == pytest.approx(4.0, abs=0.02)


@pytest.mark.parametrize("limit_m", [1.0, 8.0, 200.0])
@pytest.mark.parametrize("bins", [90, 360, 1440])
def test_seen_free_is_infinite_whatever_the_sensor_and_the_bins(limit_m: float, bins: int) -> None:
    """Protects known free ground from being "not known": the corridor is narrower than a bin at 200 m."""
    assert ahead_m(scan((0.1, CLEAR, limit_m), bins=bins), HALF_WIDTH_M) == math.inf


@pytest.mark.parametrize(
    "seen",
    [
        pytest.param((), id="nothing at all"),
        pytest.param(((45.0, CLEAR, 10.0), (-45.0, CLEAR, 10.0)), id="free, but not where it flies"),
        pytest.param(((30.0, HIT, 3.0), (-30.0, HIT, 3.0)), id="walls beside, and darkness ahead"),
    ],
)
def test_what_nobody_saw_is_not_free(seen: tuple[tuple[float, np.uint8, float], ...]) -> None:
    """Unknown is not free: it has a value of its own, which compares false with everything."""
    assert math.isnan(ahead_m(scan(*seen), HALF_WIDTH_M))


@settings(deadline=None)
@given(
    ranges_m=st.lists(st.floats(), min_size=90, max_size=90),
    states=st.lists(st.sampled_from([UNKNOWN, CLEAR, HIT]), min_size=90, max_size=90),
)
def test_no_scan_makes_a_distance_below_zero(ranges_m: list[float], states: list[np.uint8]) -> None:
    """The gate refuses a beat with a negative distance as no beat at all: none may be made of any scan."""
    made = Scan(bin_bearings(90), np.array(ranges_m), np.array(states, np.uint8), np.ones(90, np.bool_))
    found = ahead_m(made, HALF_WIDTH_M)
    assert math.isnan(found) or found >= 0.0
