"""One draw for one tangent: what makes two sightings the same tangent, and when it is a new one again."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.control.decisions import TangentLedger

SAME_M, FORGET_S = 1.0, 5.0


@pytest.fixture
def ledger() -> TangentLedger:
    return TangentLedger(SAME_M, FORGET_S)


def test_a_new_tangent_has_not_been_seen(ledger: TangentLedger) -> None:
    """Asking is no deciding: without a draw the same tangent stays new."""
    assert not ledger.seen_before(3.0, 0.0, 1, 0.0)
    assert not ledger.seen_before(3.0, 0.0, 1, 0.05)


def test_twenty_successive_samples_are_one_tangent(ledger: TangentLedger) -> None:
    """The edge wanders by centimetres from sample to sample, and a little further each time: still one."""
    ledger.decide(3.0, 0.0, 1, 0.0)
    # In 20 samples the edge moves by 1.9 m, more than what makes it the same from one sample to the next.
    assert all(ledger.seen_before(3.0 + 0.1 * i, 0.0, 1, 0.05 * i) for i in range(20))


def test_the_same_corner_with_the_other_gamma_is_another_tangent(ledger: TangentLedger) -> None:
    """Passing a pillar on its left and on its right are two decisions."""
    ledger.decide(3.0, 0.0, 1, 0.0)
    assert not ledger.seen_before(3.0, 0.0, -1, 0.05)


@given(
    x_m=st.floats(-500.0, 500.0), y_m=st.floats(-500.0, 500.0), away_m=st.floats(0.0, 3.0), way_rad=st.floats(-4.0, 4.0)
)
def test_edges_near_to_each_other_are_one(x_m: float, y_m: float, away_m: float, way_rad: float) -> None:
    """Within the set distance in any direction, and no further."""
    ledger = TangentLedger(SAME_M, FORGET_S)
    ledger.decide(x_m, y_m, -1, 0.0)
    # Not within rounding of the limit itself: 500 m times 2^-52 is 1e-13.
    if abs(away_m - SAME_M) > 1e-9:
        x_there_m, y_there_m = x_m + away_m * math.cos(way_rad), y_m + away_m * math.sin(way_rad)
        assert ledger.seen_before(x_there_m, y_there_m, -1, 0.05) == (away_m < SAME_M)


def test_two_tangents_are_remembered_apart(ledger: TangentLedger) -> None:
    """One kept in view does not keep the other one: each ages by itself."""
    ledger.decide(3.0, 0.0, 1, 0.0)
    ledger.decide(3.0, 8.0, 1, 0.0)
    for i in range(1, 11):
        assert ledger.seen_before(3.0, 8.0, 1, i * 0.6)
    assert not ledger.seen_before(3.0, 0.0, 1, 6.0)
    assert ledger.seen_before(3.0, 8.0, 1, 6.0)


@pytest.mark.parametrize(("gap_s", "same"), [(0.5, True), (4.99, True), (5.01, False), (600.0, False)])
def test_out_of_view_for_long_it_is_new_again(ledger: TangentLedger, gap_s: float, same: bool) -> None:
    """Coming round a second time, the paper draws again; a flicker of the scan is no second time."""
    ledger.decide(3.0, 0.0, 1, 100.0)
    assert ledger.seen_before(3.0, 0.0, 1, 101.0)
    assert ledger.seen_before(3.0, 0.0, 1, 101.0 + gap_s) == same


def test_staying_in_view_it_is_never_new(ledger: TangentLedger) -> None:
    """An edge that is looked at for ten minutes gets its one draw and no second one."""
    ledger.decide(3.0, 0.0, 1, 0.0)
    assert all(ledger.seen_before(3.0, 0.0, 1, t_s) for t_s in range(1, 600))
