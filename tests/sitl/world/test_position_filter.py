"""Positions on a grid: the error bound that the rendered depth relies on, and that nothing jumps."""

from __future__ import annotations

import itertools
import math
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sitl.world.truth_messages import GAP_S, TAU_S, PositionFilter

STEP_M = 0.0111
DT_S = 0.02


def cut(value_m: float, step_m: float = STEP_M) -> float:
    """As an integer cast does."""
    return math.trunc(value_m / step_m) * step_m


def flown(speed_mps: float, told_mps: float, seconds: float) -> list[tuple[float, float]]:
    """Smooth and true x along a straight way."""
    smoother = PositionFilter((STEP_M, STEP_M, STEP_M))
    out = []
    for i in range(round(seconds / DT_S)):
        true_m = speed_mps * i * DT_S
        out.append((smoother.update(i * DT_S, (cut(true_m), 0.0, 0.0), (told_mps, 0.0, 0.0))[0], true_m))
    return out


@given(speed_mps=st.floats(-3.0, 3.0), told_mps=st.floats(-10.0, 10.0))
def test_the_error_is_two_steps_at_most_whatever_the_velocity_says(speed_mps: float, told_mps: float) -> None:
    """The bound of the docstring: cut off by one step, and held within one step of that."""
    assert max(abs(smooth - true) for smooth, true in flown(speed_mps, told_mps, 2.0)) <= 2.0 * STEP_M + 1e-9


def test_with_the_velocity_cut_off_at_1_cm_per_s_it_keeps_within_one_and_a_half_steps() -> None:
    """Half a second of at most 1 cm/s, and the step that the grid itself takes off."""
    for speed_mps in (0.013, 0.199, 0.4242, -0.4242, 0.777):
        errors = [abs(smooth - true) for smooth, true in flown(speed_mps, cut(speed_mps, 0.01), 20.0)]
        assert max(errors) <= STEP_M + TAU_S * 0.01 + 1e-9


def test_it_moves_as_the_vehicle_does_and_not_in_steps() -> None:
    """Between two messages the raw position stands still or jumps 1.1 cm; the smooth one never jumps."""
    places = [smooth for smooth, _ in flown(0.4, 0.4, 10.0)]
    moved = [after - before for before, after in itertools.pairwise(places)]
    # v·dt, give or take the share dt/TAU of one step.
    slack_m = DT_S / TAU_S * STEP_M
    assert max(abs(way - 0.4 * DT_S) for way in moved) <= slack_m + 1e-9


def test_a_vehicle_at_rest_stands_still() -> None:
    """Hovering on the edge of a cell: the grid flickers, the walls must not."""
    smoother = PositionFilter((STEP_M, STEP_M, STEP_M))
    draw = random.Random(1)  # noqa: S311 - not a secret
    places = [smoother.update(i * DT_S, (draw.choice((0.0, STEP_M)), 0.0, 0.0), (0.0, 0.0, 0.0))[0] for i in range(500)]
    jumps = [abs(after - before) for before, after in itertools.pairwise(places)]
    assert max(jumps) <= DT_S / TAU_S * STEP_M + 1e-9


@pytest.mark.parametrize("dt_s", [GAP_S + 0.01, -1.0])
def test_after_a_gap_it_believes_the_position(dt_s: float) -> None:
    """Nothing is known of the velocity in between."""
    smoother = PositionFilter((STEP_M, STEP_M, STEP_M))
    smoother.update(10.0, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0))
    assert smoother.update(10.0 + dt_s, (5.0, 6.0, 7.0), (1.0, 0.0, 0.0)) == (5.0, 6.0, 7.0)
