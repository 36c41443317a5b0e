"""Room is made on all four sides, by what is seen."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.sides import NOTHING_AROUND, NOTHING_NEAR, Side, Sides, away_mps

KEEP_M, MOST_MPS = 0.75, 0.5
AWAY = {"front": (-1.0, 0.0), "left": (0.0, -1.0), "back": (1.0, 0.0), "right": (0.0, 1.0)}


def near(distance_m: float, closing_mps: float = 0.0, where: str = "left") -> Sides:
    return NOTHING_AROUND._replace(**{where: Side(distance_m, closing_mps)})


@pytest.mark.parametrize(("where", "towards"), list(AWAY.items()))
def test_it_moves_away_from_each_side(where: str, towards: tuple[float, float]) -> None:
    """Protects the signs: a wall on the right is left behind to the left."""
    forward_mps, left_mps = away_mps(near(0.625, where=where), KEEP_M, MOST_MPS)
    assert (forward_mps, left_mps) == (0.25 * towards[0], 0.25 * towards[1])


@pytest.mark.parametrize(
    ("distance_m", "closing_mps", "away"),
    [
        (0.75, 0.0, 0.0),
        (0.875, 0.25, 0.0),
        (0.8125, 0.25, 0.125),
        (0.75, 0.25, 0.25),
        (0.75, -0.25, 0.0),
        (0.1, 0.0, 0.5),
    ],
)
def test_what_comes_nearer_is_met_before_it_is_too_near(distance_m: float, closing_mps: float, away: float) -> None:
    """Protects from a drift that the autopilot does not know: by distance alone the answer comes too late."""
    assert away_mps(near(distance_m, closing_mps), KEEP_M, MOST_MPS) == (0.0, -away)


def test_between_two_walls_it_leads_to_the_middle() -> None:
    """Protects narrow drifts: away from one wall is no reason to touch the other."""
    both = Sides(left=Side(0.5, 0.0), right=Side(0.625, 0.0))
    assert away_mps(both, KEEP_M, MOST_MPS) == (0.0, -0.25)
    assert away_mps(both._replace(right=both.left), KEEP_M, MOST_MPS) == (0.0, 0.0)


SIDES = st.builds(Side, st.floats(0.0, math.inf), st.floats(-5.0, 5.0)) | st.just(NOTHING_NEAR)


@given(st.builds(Sides, SIDES, SIDES, SIDES, SIDES))
def test_it_is_never_faster_than_it_may_be(sides: Sides) -> None:
    """Protects the gate's limit of the speed."""
    assert math.hypot(*away_mps(sides, KEEP_M, MOST_MPS)) <= MOST_MPS + 1e-9
