"""What a map shows the beginning of and the vehicle cannot look into: by name of the reason, where it lies."""

from __future__ import annotations

import numpy as np
import pytest

from companion.control.left_out import LeftOut, Why
from companion.mapping import FREE, OCCUPIED, UNKNOWN
from companion.mapping.frontiers.surveyor import Surveyor
from tests.mapping.frontiers.scenes import REACH, Dense, room, snapshot

MIDDLE = np.array([[4.0, 3.0, 1.7]])
"""The floor of `room` is at 0.2 m, so H is at 1.7 m."""


def left_out(dense: Dense) -> tuple[LeftOut, ...]:
    surveyor = Surveyor(0.1, REACH)
    surveyor.update(snapshot(dense))
    surveyor.flew(MIDDLE)
    return surveyor.left_out(surveyor.survey((4.0, 3.0, 1.7)))


def with_passage(height_m: float, deep_m: float = 2.0) -> Dense:
    """`room` with a passage 2 m wide from its eastern wall on, which ends in the unseen."""
    whole = room()
    longer = np.full((whole.shape[0] + round(10.0 * deep_m), *whole.shape[1:]), OCCUPIED, np.uint8)
    longer[: whole.shape[0]] = whole
    longer[whole.shape[0] - 2 :, 22:42, 2 : 2 + round(10.0 * height_m)] = FREE
    return longer


def test_a_room_that_was_seen_leaves_nothing_out() -> None:
    assert left_out(room()) == ()


def test_a_passage_under_a_low_roof_is_too_low() -> None:
    """At flight height its roof is a wall like any other: without a look below nobody would hear of it."""
    (low,) = left_out(with_passage(height_m=1.2))
    assert low.why is Why.TOO_LOW
    assert (low.x_m, low.y_m) == pytest.approx((8.2, 3.2), abs=0.3)
    assert low.extent_m == pytest.approx(2.0, abs=0.3), "as wide as the passage"


@pytest.mark.parametrize(("height_m", "deep_m"), [(0.3, 2.0), (1.2, 0.4)])
def test_a_chink_and_a_hanging_wall_are_no_passage(height_m: float, deep_m: float) -> None:
    """Protects the list from every wall of a mine that leans over."""
    assert left_out(with_passage(height_m, deep_m)) == ()


def test_a_passage_that_is_high_enough_and_unseen_was_not_reached() -> None:
    dense = with_passage(height_m=3.0)
    dense[-8:, 22:42, 2:-2] = UNKNOWN
    (open_one,) = left_out(dense)
    assert open_one.why in (Why.NOT_REACHED, Why.TOO_NARROW)
    assert open_one.x_m == pytest.approx(9.5, abs=0.5)


def test_a_roof_further_off_than_the_camera_sees_is_out_of_range() -> None:
    """In a hall the roof is never in the picture: the map has a hole there, and says so."""
    (hall,) = left_out(room(z_m=12.0))
    assert hall.why is Why.OUT_OF_RANGE
    assert hall.extent_m == pytest.approx(6.0, abs=0.6), "where the vehicle gets to"
