"""Whether something still tells the autopilot where it is: noticed from what falls silent, long before it says so."""

from __future__ import annotations

import math

import pytest

from companion.gate.aiding import FIGURES, Aiding
from companion.mavlink.firmware import AutopilotKind
from tests.gate.built import KINDS

BOTH = pytest.mark.parametrize("kind", KINDS)


def figures(kind: AutopilotKind, velocity: float, position: float) -> dict[str, float]:
    return dict(zip(FIGURES[kind], (velocity, position), strict=True))


@BOTH
def test_figures_that_stand_still_are_those_of_an_estimator_without_news(kind: AutopilotKind) -> None:
    """Protects the 7 s in which ArduCopter says that all is well, and drifts."""
    aiding = Aiding()
    assert aiding.figures_stand_for_s() == 0.0
    aiding.on_estimator(kind, figures(kind, 0.1, 0.2), 64.0)
    assert aiding.figures_stand_for_s() == 0.0
    aiding.on_estimator(kind, figures(kind, 0.1, 0.2), 64.25)
    assert aiding.figures_stand_for_s() == 0.25
    aiding.on_estimator(kind, figures(kind, 0.1, 0.25), 64.5)
    assert aiding.figures_stand_for_s() == 0.0, "one of them is enough: VISION_POSITION_ESTIMATE has no velocity"
    aiding.on_estimator(kind, figures(kind, 0.125, 0.25), 64.75)
    assert aiding.figures_stand_for_s() == 0.0


@BOTH
@pytest.mark.parametrize("velocity", [math.nan, 0.1])
def test_a_figure_that_is_no_number_is_no_news(kind: AutopilotKind, velocity: float) -> None:
    """Protects from PX4's way to say that nothing is measured: a NaN is never equal to the one before."""
    aiding = Aiding()
    aiding.on_estimator(kind, figures(kind, 0.1, 0.2), 63.75)
    for quarter in range(5):
        # Made anew each time, as a message is: the same object would be equal to itself.
        aiding.on_estimator(kind, figures(kind, float(str(velocity)), float("nan")), 64.0 + 0.25 * quarter)
    assert aiding.figures_stand_for_s() == 1.0


@pytest.mark.parametrize(("fix", "counts"), [(0, False), (1, False), (2, False), (3, True), (4, True), (6, True)])
def test_a_position_fix_has_three_dimensions(fix: int, counts: bool) -> None:
    """Protects from a receiver that goes on speaking when it sees nothing: only a position is one."""
    aiding = Aiding()
    assert aiding.gps_s == -math.inf
    aiding.on_gps({"fix_type": 3}, 64.0)
    aiding.on_gps({"fix_type": fix}, 65.0)
    assert (aiding.gps_s, aiding.gps_fix) == (65.0 if counts else 64.0, fix)


def test_a_new_flight_misses_nothing_that_never_came_in_it() -> None:
    """Protects a flight without GPS from the one before, which had it."""
    aiding = Aiding()
    aiding.on_gps({"fix_type": 3}, 64.0)
    for now_s in (64.0, 65.0):
        aiding.on_estimator(AutopilotKind.PX4, figures(AutopilotKind.PX4, 0.1, 0.2), now_s)
    aiding.reset()
    assert (aiding.gps_s, aiding.gps_fix) == (-math.inf, 0)
    assert aiding.figures_stand_for_s() == 0.0
