"""From one turn of a planar scanner to HIT, CLEAR and UNKNOWN."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import ArrayLike

from companion.model import CLEAR, HIT, UNKNOWN, PlanarScan
from companion.perception.look import Look, bin_bearings, planar_look
from tests.perception.scenes import AT_START

LIMIT_M = 10.0
NAN, INF = float("nan"), float("inf")


def turn(bearings_rad: ArrayLike, ranges_m: ArrayLike) -> PlanarScan:
    return PlanarScan(0.0, np.array(bearings_rad, np.float64), np.array(ranges_m, np.float64), LIMIT_M, AT_START)


def look(ranges_m: ArrayLike, bins: int) -> Look:
    """Of evenly spaced rays over a full turn."""
    ranges = np.atleast_1d(np.array(ranges_m, np.float64))
    return planar_look(turn(bin_bearings(ranges.size), ranges), bins)


@pytest.mark.parametrize("rays", [360, 720, 1000])
def test_a_round_room_off_the_middle(rays: int) -> None:
    """Protects bearings and ranges: right is negative, behind is ± π, and each bin has the nearest of its rays."""
    bearings = bin_bearings(rays)
    # A round room of 3 m, 1 m to the right of its middle.
    room = np.sin(bearings) + np.sqrt(np.sin(bearings) ** 2 + 8.0)
    seen = planar_look(turn(bearings, room), 360)
    middles = bin_bearings(360)
    expected = np.sin(middles) + np.sqrt(np.sin(middles) ** 2 + 8.0)
    assert (seen.state == HIT).all()
    # The range changes by cos b (1 + sin b / √(sin² b + 8)) < 1.1 m per rad, and a ray is at most half a bin off.
    np.testing.assert_allclose(seen.ranges_m, expected, atol=1.1 * math.pi / 360)
    assert seen.ranges_m[270] > 3.9  # to the left
    assert seen.ranges_m[90] < 2.1  # to the right


def test_what_a_ray_says() -> None:
    """Protects the three states: NaN is unknown, at or beyond the limit and infinity are clear, the rest are hits."""
    seen = look([NAN, INF, 10.0, 12.0, 9.99, 0.3, -INF, 5.0], 8)
    np.testing.assert_array_equal(seen.state, [UNKNOWN, CLEAR, CLEAR, CLEAR, HIT, HIT, UNKNOWN, HIT])
    np.testing.assert_array_equal(seen.ranges_m, [0.0, 10.0, 10.0, 10.0, 9.99, 0.3, 0.0, 5.0])
    np.testing.assert_array_equal(seen.covered, seen.state != UNKNOWN)


def test_a_turn_without_any_measurement_is_unknown() -> None:
    """Protects from a scanner that spins in dust."""
    seen = look(np.full(360, NAN), 360)
    assert (seen.state == UNKNOWN).all()
    assert (seen.ranges_m == 0.0).all()
    assert not seen.covered.any()


def test_no_rays_at_all_are_unknown() -> None:
    """Protects from an empty message."""
    assert (planar_look(turn([], []), 360).state == UNKNOWN).all()


def test_bins_between_the_rays_are_unknown() -> None:
    """Protects coarse scanners: 36 rays say nothing of the bearings between them."""
    seen = look(np.full(36, 2.0), 360)
    assert np.count_nonzero(seen.state == HIT) == 36
    assert np.count_nonzero(seen.state == UNKNOWN) == 324
    assert np.count_nonzero(seen.covered) == 36


@pytest.mark.parametrize(
    ("rays", "state", "range_m"),
    [
        ([3.0, 2.0, 4.0], HIT, 2.0),
        ([NAN, 2.0, INF], HIT, 2.0),
        ([NAN, INF, 11.0], CLEAR, LIMIT_M),
        ([NAN, NAN, NAN], UNKNOWN, 0.0),
    ],
)
def test_several_rays_in_one_bin(rays: list[float], state: np.uint8, range_m: float) -> None:
    """Protects thin obstacles in fine scans: the nearest counts, and NaN neither hides nor clears anything."""
    seen = planar_look(turn(bin_bearings(360)[100] + np.array([-0.005, 0.0, 0.005]), rays), 360)
    assert (seen.state[100], seen.ranges_m[100]) == (state, range_m)
    assert np.count_nonzero(seen.covered) == (state != UNKNOWN)


@pytest.mark.parametrize("range_m", [0.0, -1.0])
def test_a_range_that_cannot_be_is_no_measurement(range_m: float) -> None:
    """Protects the vehicle from stopping before nothing: no surface is at 0 m or behind the ray's beginning."""
    assert look([range_m], 1).state[0] == UNKNOWN


@given(
    st.lists(
        st.tuples(
            st.floats(-math.pi, math.pi, exclude_max=True),
            st.one_of(st.floats(0.01, 30.0), st.sampled_from([NAN, INF, -INF])),
        ),
        max_size=200,
    )
)
def test_nothing_is_invented(rays: list[tuple[float, float]]) -> None:
    """Protects all three states at once: each bin against its own rays, one by one."""
    bins = 90
    seen = planar_look(turn([bearing for bearing, _ in rays], [r for _, r in rays]), bins)
    width = 2.0 * math.pi / bins
    for b in range(bins):
        own = [r for bearing, r in rays if int((bearing + math.pi) / width) % bins == b]
        measured = [r for r in own if r > 0.0]  # false for NaN
        nearest = min(measured, default=NAN)
        if not measured:
            assert (seen.state[b], seen.ranges_m[b]) == (UNKNOWN, 0.0)
        elif nearest >= LIMIT_M:
            assert (seen.state[b], seen.ranges_m[b]) == (CLEAR, LIMIT_M)
        else:
            assert (seen.state[b], seen.ranges_m[b]) == (HIT, nearest)
