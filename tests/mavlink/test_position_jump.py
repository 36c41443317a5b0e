"""Jumps of the position: what flying explains is none."""

from __future__ import annotations

import pytest

from companion.mavlink.position_jump import LONGEST_GAP_S, position_jump_m

STANDING = (1.0, 2.0, -3.0, 0.0, 0.0, 0.0)


def test_what_the_velocities_explain_is_no_jump() -> None:
    """The mean of both velocities: a constant acceleration is explained as well."""
    after = (1.0 + 0.5 * 0.8 * 0.5, 2.0, -3.0, 0.8, 0.0, 0.0)
    assert position_jump_m(STANDING, after, 0.5) == pytest.approx(0.0)


@pytest.mark.parametrize("axis", range(3))
def test_the_rest_is_measured_along_every_axis(axis: int) -> None:
    after = tuple(value + (0.7 if i == axis else 0.0) for i, value in enumerate(STANDING))
    assert position_jump_m(STANDING, after, 0.1) == pytest.approx(0.7)  # type: ignore[arg-type]  # of six again


@pytest.mark.parametrize("dt_s", [0.0, -0.1, LONGEST_GAP_S])
def test_over_no_time_or_too_long_a_gap_nobody_can_say(dt_s: float) -> None:
    assert position_jump_m(STANDING, (9.0, 9.0, 9.0, 0.0, 0.0, 0.0), dt_s) == 0.0
