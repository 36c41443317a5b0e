"""Places that were left out: told once, for the gravest reason, in one line."""

from __future__ import annotations

import numpy as np
import pytest

from companion.control.left_out import MOST_LISTED, LeftOut, Why, in_words, merged, pieces, so_many, to_explore


def place(x_m: float, why: Why, extent_m: float = 1.0, z_m: float = 0.0) -> LeftOut:
    return LeftOut(x_m, 0.0, z_m, extent_m, why)


def test_ground_and_map_tell_of_the_same_place_once() -> None:
    """The ground knows that it gave up, the map only that something is open there; above each other are two."""
    places = (place(1.0, Why.NOT_REACHED, 3.0), place(0.0, Why.GIVEN_UP), place(0.0, Why.NOT_REACHED, z_m=5.0))
    assert merged(places) == (place(0.0, Why.GIVEN_UP), place(0.0, Why.NOT_REACHED, z_m=5.0))
    inside, wide = place(4.0, Why.NOT_REACHED), place(0.0, Why.NOT_REACHED, 9.0)
    assert merged((inside, wide)) == (wide,)


def test_a_list_has_an_end() -> None:
    """Protects a summary from the thousand niches of a mine; the largest are kept."""
    listed = merged(place(200.0 * k, Why.TOO_NARROW, float(k)) for k in range(2 * MOST_LISTED))
    assert len(listed) == MOST_LISTED
    assert min(found.extent_m for found in listed) == MOST_LISTED


def test_one_line_counts_the_reasons() -> None:
    places = (place(0.0, Why.TOO_LOW), place(9.0, Why.BLOCKED), place(18.0, Why.TOO_LOW))
    assert in_words(places) == "2 too low, 1 blocked"
    assert in_words(()) == "nothing"


def test_a_place_is_as_large_as_its_cells() -> None:
    """Cells that meet at a corner are one piece, those that are apart in the plan or in height are not."""
    points_m = np.array([[0.25, 0.25, 0.0], [0.75, 0.75, 0.0], [1.25, 0.75, 0.2], [5.25, 0.25, 0.0], [0.25, 0.25, 9.0]])
    found = sorted((LeftOut.over(points_m[part], 0.5, Why.TOO_LOW) for part in pieces(points_m, 0.5, 1.0)), key=str)
    assert [round(piece.extent_m, 2) for piece in found] == [0.5, 1.5, 0.5]
    assert found[1].as_json() == {"x_m": 0.75, "y_m": 0.58, "z_m": 0.07, "extent_m": 1.5, "why": "too low"}


@pytest.mark.parametrize(("reached", "told"), [(0, "0 places"), (1, "1 place"), (12, "12 places")])
def test_only_what_a_way_leads_to_is_left_to_explore(reached: int, told: str) -> None:
    """Another flight gets no further where there is no room; what it does get to is told in words."""
    others = [LeftOut(0.0, 0.0, 0.0, 1.0, why) for why in Why if why is not Why.NOT_REACHED]
    places = others + [LeftOut(float(n), 0.0, 0.0, 1.0, Why.NOT_REACHED) for n in range(reached)]
    assert to_explore(places) == reached
    assert so_many(to_explore(places)) == told
