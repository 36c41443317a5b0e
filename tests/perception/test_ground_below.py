"""The ground below, and other vehicles that are not it."""

from __future__ import annotations

import pytest

from companion.control.separation import Back
from companion.model import Pose
from companion.perception.ground_below import MEETS_M, GroundBelow, above_ground_m

BACK = Back(down_m=0.85, height_m=1.15)
"""Of a vehicle at 1 m, below one at 2 m."""


@pytest.mark.parametrize(
    ("down_m", "beneath", "height_m"),
    [
        (None, (BACK,), None),
        (2.0, (), 2.0),
        (0.9, (BACK,), 2.05),
        (0.9, (Back(1.6, 0.4), BACK), 2.05),
        (2.0, (BACK,), 2.0),
        (0.85 - MEETS_M, (BACK,), 0.85 - MEETS_M),
    ],
    ids=["nothing", "alone", "its back", "the nearer of two", "past it", "something else, nearer"],
)
def test_a_beam_that_ends_on_a_back_says_how_high_that_is(
    down_m: float | None, beneath: tuple[Back, ...], height_m: float | None
) -> None:
    """Only what is where a vehicle says that it is, is it: rock stays rock."""
    assert above_ground_m(down_m, beneath) == (None if height_m is None else pytest.approx(height_m))


@pytest.mark.parametrize("known", [True, False])
def test_behind_a_vehicle_that_was_passed_the_ground_has_not_fallen(known: bool) -> None:
    """Taken for ground its back would be the edge of a shaft, and the vehicle above it would stand there for good."""
    ground, beneath = GroundBelow(1.1, 0.35), (BACK,) if known else ()
    ended = False
    for tick in range(60):
        t_s = 0.05 * tick
        down_m = 0.85 if 20 <= tick < 40 else 2.0
        h_m, over = ground.see(above_ground_m(down_m, beneath), False, Pose(t_s, 0.0, 0.0, 2.0, 0.0), t_s)
        ended |= over
        assert not known or h_m == pytest.approx(2.0)
    assert ended != known


def test_the_wall_of_a_shaft_leads_nobody_into_it() -> None:
    """Met askew, as at a broken edge, it falls bit by bit: each reading by less than a fall from the one before."""
    ground, seen = GroundBelow(1.1, 0.35), []
    for tick, down_m in enumerate([1.5] * 20 + [2.5, 2.5, 3.5, 3.5, 2.1, 2.1, 3.1, 3.1, 4.1, 5.1]):
        x_m = 0.025 * tick
        seen.append(ground.see(down_m, False, Pose(0.05 * tick, x_m, 0.0, 1.5, 0.0), 0.05 * tick))
    assert [over for _, over in seen[20:]] == [False, False, True, True, False, False, True, True, True, True]
    assert all(h_m is None or h_m <= 2.6 for h_m, _ in seen)


def test_a_ramp_is_no_shaft_however_long() -> None:
    """Nor where the position leaps, or drifts while the vehicle stands: then nothing below it has moved."""
    ground = GroundBelow(0.5, 0.35)
    for tick in range(1200):
        t_s, x_m = 0.05 * tick, 0.025 * min(tick, 400)
        z_m = 1.5 - 0.35 * x_m - 0.02 * max(0.0, t_s - 30.0) - 2.0 * (t_s > 50.0)
        h_m, over = ground.see(1.5, False, Pose(t_s, x_m, 0.0, z_m, 0.0), t_s)
        assert (h_m, over) == (1.5, False)
