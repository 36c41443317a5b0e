"""What is left on known ground, and what was left out and why."""

from __future__ import annotations

import numpy as np
import pytest

from companion.control import remaining
from companion.control.ground_grid import FREE, UNSEEN, WALL
from companion.control.known_ground import KnownGround, Place
from companion.control.left_out import Why
from companion.control.remaining import is_way_left, left_out
from tests.control.test_informed import CROSSING, MINE, WEST_END, known, level_ground

CLOSED = "\n".join(
    line if len(line) < 39 or line.endswith("#") else line[:38] + "#"
    for line in MINE.replace("#.......#\n               #.......#", "#########\n               #.......#", 1).split(
        "\n"
    )
)


def why_left_out(ground: KnownGround, place: Place = WEST_END) -> dict[tuple[int, int], Why]:
    """The reasons, by whole metres."""
    return {(round(found.x_m), round(found.y_m)): found.why for found in left_out(ground, place)}


def narrowed() -> KnownGround:
    """The drift to the east is 1 m wide for 3 m, and ends in the unseen behind that."""
    ground = known()
    for rows in (slice(41, 43), slice(45, 48)):
        ground._grid.cells[0, rows, 65:71] = WALL
    return ground


def test_a_mine_that_was_seen_has_nothing_left() -> None:
    """Before the first look nobody knows; after it there is a way or none."""
    assert is_way_left(KnownGround(), WEST_END) is None
    assert is_way_left(known(), WEST_END) is True
    assert is_way_left(known(CLOSED), WEST_END) is False
    assert not why_left_out(KnownGround())
    assert not why_left_out(known(CLOSED))


def test_a_chink_is_nothing_that_is_left() -> None:
    """The law looks into it when nothing else is left; a mission does not go on for it."""
    chink = known(CLOSED)
    chink._grid.cells[0, 43, 50:52] = UNSEEN
    assert is_way_left(chink, WEST_END) is False


def test_every_reason_is_told_of_its_place() -> None:
    """The branch in the north ends in the unseen, and so does the drift in the east, 1 m wide before."""
    assert why_left_out(known()) == {(10, 8): Why.NOT_REACHED, (19, 2): Why.NOT_REACHED}
    assert why_left_out(narrowed()) == {(10, 8): Why.NOT_REACHED, (19, 2): Why.TOO_NARROW}
    blocked = known()
    for y_m in (0.75, 2.25, 3.75):
        blocked.block(Place(13.25, y_m, 0.0))
    assert why_left_out(blocked) == {(10, 8): Why.NOT_REACHED, (19, 2): Why.BLOCKED}
    given_up = known()
    given_up.give_up(Place(9.75, 7.75, 0.0), 2.5)
    assert why_left_out(given_up) == {(10, 8): Why.GIVEN_UP, (19, 2): Why.NOT_REACHED}
    (east,) = (found for found in left_out(given_up, CROSSING) if found.why is Why.NOT_REACHED)
    assert east.extent_m == pytest.approx(2.5), "as wide as the drift, but for the cells beside its walls"


def test_what_lies_beyond_the_window_of_the_law_is_left_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects from landing with half of a long mine unseen: the law searches 96 m to each side only."""
    cells = np.full((512, 512), UNSEEN, np.uint8)
    cells[20:29, 10:502] = WALL
    cells[21:28, 11:501] = FREE
    cells[21:28, 501] = UNSEEN
    ground = KnownGround()
    ground._origin, ground._grid = (0.0, 0.0), level_ground(cells)
    near_west = Place(10.25, 12.25, 0.0)
    assert is_way_left(ground, near_west) is True
    assert why_left_out(ground, near_west) == {(250, 12): Why.NOT_REACHED}
    ground._grid.cells[0, 21:28, 501] = WALL
    assert is_way_left(ground, near_west) is False
    monkeypatch.setattr(remaining, "MOST_SEARCHED_CELLS", 400)
    assert is_way_left(ground, near_west) is None, "more than can be searched: it is not known"
