"""Where no ground was below is an obstacle, and no look over its edge forgets it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from companion.config.sensors import BeamSettings, SensorSettings
from companion.model import HIT, Beam, Input
from companion.perception.ground_below import KEPT_S
from companion.perception.shafts import APART_M, MOST, Shafts
from tests.perception.observations import BEAM_LIMIT_M, BEAM_STALE_S, DOWN, SMALL, extractor, later, observed, scan_of
from tests.perception.scenes import AT_START, FLOOR, ROOF

OPEN = [FLOOR, ROOF]
NO_GROUND = {Beam.DOWN: BEAM_LIMIT_M}


def test_a_place_without_ground_is_an_obstacle_from_then_on() -> None:
    """Protects from flying over the same shaft again: the camera looks over its edge, and sees free space."""
    extract = extractor(SensorSettings(camera=SMALL, beams=BeamSettings(directions=(Beam.DOWN,))))
    extract.measure(observed(AT_START, OPEN, DOWN))
    over = extract.measure(observed(later(AT_START, 0.5, x_m=0.5), OPEN, NO_GROUND))
    assert (over.missing, over.over_shaft) == ((Input.HEIGHT,), True)
    assert over.ranges_age_s == 0.0, "the beam works"
    for i in range(1, 8):
        back = extract.measure(observed(later(AT_START, 0.5 + 0.2 * i, x_m=0.5 - 0.2 * i), OPEN, DOWN))
        assert (back.missing, back.over_shaft) == ((), False)
        assert (back.d_m, back.d_bearing_rad) == pytest.approx((0.2 * i, 0.0), abs=0.02)
        assert not scan_of(back).fresh[scan_of(back).state == HIT].any()


@pytest.mark.parametrize("fallen_m", [1.2, 5.0])
def test_a_step_down_that_it_could_not_come_up_again_is_one_too(fallen_m: float) -> None:
    """Protects the way home: over a step of 5 m in a mine's floor it flew on, sank, and never came back."""
    extract = extractor(SensorSettings(camera=SMALL, beams=BeamSettings(directions=(Beam.DOWN,))))
    extract.measure(observed(AT_START, OPEN, DOWN))
    for i in range(1, 4):
        below = {Beam.DOWN: DOWN[Beam.DOWN] + fallen_m}
        over = extract.measure(observed(later(AT_START, 0.2 * i, x_m=0.2 * i), OPEN, below))
        assert (over.h_m, over.missing, over.over_shaft) == (None, (Input.HEIGHT,), True)
    back = extract.measure(observed(later(AT_START, 1.0, x_m=-0.2), OPEN, DOWN))
    assert (back.missing, back.over_shaft) == ((), False)
    assert (back.d_m, back.d_bearing_rad) == pytest.approx((0.4, 0.0), abs=0.02)


@pytest.mark.parametrize("fallen_m", [0.4, 0.9])
def test_a_step_that_it_comes_up_again_is_ground(fallen_m: float) -> None:
    """Protects the ways over rubble and low steps, which are flown both up and down."""
    extract = extractor()
    extract.measure(observed(AT_START, OPEN, DOWN))
    lower = {Beam.DOWN: DOWN[Beam.DOWN] + fallen_m}
    found = extract.measure(observed(later(AT_START, 0.2, x_m=0.2), OPEN, lower))
    assert found.h_m == pytest.approx(DOWN[Beam.DOWN] + fallen_m)
    assert not found.over_shaft


def test_dust_in_the_beam_makes_no_shaft_of_the_floor() -> None:
    """Protects from one short reading: taken for ground, the floor below was a fall from it, and the flight ended."""
    extract = extractor()
    extract.measure(observed(AT_START, OPEN, DOWN))
    dusty = extract.measure(observed(later(AT_START, 0.1), OPEN, {Beam.DOWN: 0.35}))
    assert dusty.h_m == pytest.approx(0.35), "it is kept off all the same"
    for after_s in (0.2, 0.3):
        found = extract.measure(observed(later(AT_START, after_s), OPEN, DOWN))
        assert found.h_m == pytest.approx(DOWN[Beam.DOWN])
        assert not found.over_shaft


def test_a_rise_that_stays_is_ground() -> None:
    """Protects what is flown over in earnest: behind a bench of 1.15 m the floor is a fall again."""
    extract = extractor()
    extract.measure(observed(AT_START, OPEN, DOWN))
    for after_s in (0.1, 0.2, 0.3, 0.4):
        bench = extract.measure(observed(later(AT_START, after_s), OPEN, {Beam.DOWN: 0.35}))
        assert bench.h_m == pytest.approx(0.35)
    behind = extract.measure(observed(later(AT_START, 0.5), OPEN, DOWN))
    assert (behind.h_m, behind.over_shaft) == (None, True)


def test_a_leap_of_the_position_is_no_step() -> None:
    """Protects the flight: the ground is as far below as it was, whatever the estimate says of the height."""
    extract = extractor()
    extract.measure(observed(AT_START, OPEN, DOWN))
    found = extract.measure(observed(later(AT_START, 0.2, z_m=AT_START.z_m - 3.0), OPEN, DOWN))
    assert found.h_m == pytest.approx(DOWN[Beam.DOWN])
    assert not found.over_shaft


def test_at_the_edge_it_still_sees_ahead() -> None:
    """Protects the way back: without a height no image would be read, and depth would be missing as well."""
    extract = extractor()
    extract.measure(observed(AT_START, OPEN, DOWN))
    for after_s in (0.5, 5.0, KEPT_S):
        found = extract.measure(observed(later(AT_START, after_s), OPEN, NO_GROUND))
        assert found.missing == (Input.HEIGHT,), after_s
    gone = extract.measure(observed(later(AT_START, KEPT_S + 1.0), OPEN, NO_GROUND))
    assert gone.missing == (Input.DEPTH, Input.HEIGHT)


@pytest.mark.parametrize("range_m", [None, 0.0, math.nan, -1.0])
def test_a_beam_that_says_nothing_marks_nothing(range_m: float | None) -> None:
    """Protects from a dead beam: it is no shaft, and the gate is told that it is silent."""
    extract = extractor()
    extract.measure(observed(AT_START, OPEN, DOWN))
    extract.measure(observed(later(AT_START, 2.0), OPEN, {Beam.DOWN: range_m}))
    found = extract.measure(observed(later(AT_START, 2.5), OPEN, {Beam.DOWN: range_m}))
    assert (found.d_m, found.over_shaft) == (None, False)
    assert found.ranges_age_s > BEAM_STALE_S


def test_before_any_ground_was_seen_nothing_is_marked() -> None:
    """Protects the start: a beam that does not see the floor it stands on is broken."""
    found = extractor().measure(observed(AT_START, OPEN, NO_GROUND))
    assert found.missing == (Input.DEPTH, Input.HEIGHT)


def test_it_stays_bounded() -> None:
    """Protects an hour over rough ground."""
    shafts = Shafts(5.0)
    for i in range(2 * MOST):
        for _ in range(2):
            shafts.mark(later(AT_START, 0.0, x_m=1.1 * APART_M * i))
    shafts.mark(later(AT_START, 0.0, x_m=math.nan))
    assert len(shafts._places_m) == MOST
    assert np.isfinite(shafts._places_m).all()
