"""Up and down: between the ground and the roof of the way ahead, and not into rock beside the way."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from companion.control.climbing import climb_mps
from companion.model import Measurement
from tests.control.scene import law_parameters, measurement
from tests.control.stages import ORIGIN

LAW = law_parameters(law="smooth", vertical_margin_m=0.6)
H_M = LAW.height_m


def climbs(told: Measurement, height_m: float = H_M) -> float:
    return climb_mps(height_m, told, ORIGIN, False, LAW)


@pytest.mark.parametrize(("rise_m", "rests_at_m"), [(0.0, 1.5), (0.9, 1.5), (1.2, 1.8)])
def test_it_rises_for_the_highest_ground_on_its_way(rise_m: float, rests_at_m: float) -> None:
    """Protects from a step in the floor: the beam sees it only when the vehicle is above it."""
    for off_m in (-0.1, 0.0, 0.1):
        found = climbs(replace(measurement(None, h_m=rests_at_m + off_m), rise_m=rise_m))
        assert found == pytest.approx(-LAW.height_gain_per_s * off_m, abs=1e-12)


def test_between_a_rise_and_a_roof_it_flies_in_the_middle() -> None:
    """Protects the body where both margins do not fit: 1 m of room above a rise of 1 m."""
    told = replace(measurement(None, h_m=1.5), rise_m=1.0, roof_m=0.5)
    assert climbs(told) == pytest.approx(0.0, abs=1e-12)
    assert climbs(replace(told, h_m=1.6, roof_m=0.4)) < 0.0
    assert climbs(replace(told, h_m=1.4, roof_m=0.6)) > 0.0


def test_whoever_asks_for_less_than_the_margin_gets_it() -> None:
    """Protects a low height over level ground: the margin is for what rises."""
    assert climbs(measurement(None, h_m=0.4), height_m=0.4) == 0.0


@pytest.mark.parametrize("h_m", [1.0, 2.5])
def test_nearer_than_the_critical_margin_it_neither_climbs_nor_sinks(h_m: float) -> None:
    """Protects from sinking beside a bulge: d counts what lies at the heights that the vehicle gets to."""
    near = measurement(None, h_m=h_m, d_m=LAW.critical_margin_m - 0.01)
    assert climbs(near) == 0.0
    assert climbs(replace(near, d_m=LAW.critical_margin_m)) != 0.0
    assert climbs(replace(near, d_m=math.nan)) != 0.0, "what is no number stops the flight, not the height"


def test_over_a_shaft_it_still_keeps_off_the_roof() -> None:
    """Protects from a height that wanders while it goes back: with no ground to hold it by it rose into the roof."""
    lost = replace(measurement(None, h_m=None), roof_m=0.4)
    assert climbs(lost) == 0.0, "a beam that is silent says nothing of the room below"
    assert climbs(replace(lost, over_shaft=True)) == pytest.approx(-0.2 * LAW.height_gain_per_s)
    assert climbs(replace(lost, over_shaft=True, roof_m=0.7)) == 0.0
    assert climbs(replace(lost, over_shaft=True, roof_m=-math.inf)) == -LAW.max_climb_mps


def test_rock_above_or_below_moves_it_all_the_same() -> None:
    """Protects the body in a tight place: of two too near the one that is above or below cannot be flown away from."""
    near = measurement(None, h_m=0.3, d_m=0.5)
    assert climbs(near) > 0.0
    assert climbs(replace(near, h_m=2.5, roof_m=0.4)) < 0.0
