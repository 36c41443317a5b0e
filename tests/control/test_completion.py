"""When a mission is done: nothing left for whoever knows, and for long enough."""

from __future__ import annotations

import pytest

from companion.control.completion import (
    ALONE_S,
    ENOUGH_SEEN,
    SETTLED_S,
    SETTLED_SEEN,
    SUSTAINED_S,
    Completion,
    MapWord,
)

FITS_M = 1.6
ALL = MapWord(frontier_m=0.0, seen_share=1.0, surfaces_seen=1000, has_room=True)
SOME = ALL._replace(frontier_m=3.0)
SHORT = ALL._replace(frontier_m=1.0)
"""A frontier through which the vehicle does not fit."""


def done_after_s(ground: bool | None, word: MapWord | None, for_s: float = 1000.0) -> float | None:
    """When a mission is done of which the same is said all the time."""
    completion = Completion(FITS_M)
    return next((float(t_s) for t_s in range(int(for_s)) if completion.update(float(t_s), ground, word)), None)


@pytest.mark.parametrize(
    ("ground", "word", "done_s"),
    [
        (False, ALL, SUSTAINED_S),
        (False, SHORT, SUSTAINED_S),
        (None, ALL, SUSTAINED_S),
        (False, None, ALONE_S),
        # What nobody can get to or see is given up in the end.
        (False, SOME, SETTLED_S),
        (None, SHORT, SETTLED_S),
        (False, ALL._replace(seen_share=SETTLED_SEEN), SETTLED_S),
        # Never.
        (None, None, None),
        (True, ALL, None),
        (True, None, None),
        (None, SOME, None),
        (False, ALL._replace(seen_share=SETTLED_SEEN - 0.01), None),
        (False, ALL._replace(has_room=False), None),
    ],
)
def test_done_is_what_all_say_who_know(ground: bool | None, word: MapWord | None, done_s: float | None) -> None:
    """Protects from an end with a way left, and from none at all before water and glass."""
    assert done_after_s(ground, word) == done_s


def test_a_moment_with_something_left_begins_it_anew() -> None:
    """A chink that comes and goes ends nothing; an opening after the end is news, and it goes on."""
    completion = Completion(FITS_M)
    assert not completion.update(0.0, False, ALL)
    assert not completion.update(SUSTAINED_S - 1.0, True, ALL)
    assert not completion.update(SUSTAINED_S, False, ALL)
    assert not completion.update(2.0 * SUSTAINED_S - 1.0, False, ALL)
    assert completion.update(2.0 * SUSTAINED_S, False, ALL)
    assert completion.done_at_s == 2.0 * SUSTAINED_S
    assert not completion.update(2.0 * SUSTAINED_S + 1.0, False, SOME)
    assert completion.done_at_s is None


def test_news_keep_it_from_settling() -> None:
    """Flying where something new comes is no waste, whatever else cannot be reached."""
    completion = Completion(FITS_M)
    for k in range(10):
        assert not completion.update(0.9 * SETTLED_S * k, False, SOME._replace(surfaces_seen=1000 + 10 * k))
    last_s = 0.9 * SETTLED_S * 9
    assert completion.update(last_s + SETTLED_S, False, SOME._replace(surfaces_seen=1091)), "a 1000th is no news"


def test_a_map_that_dies_leaves_the_word_to_the_ground() -> None:
    """Exploring never depends on the map being alive, nor does its end; alone the ground has to say it for longer."""
    completion = Completion(FITS_M)
    assert not completion.update(0.0, False, SOME)
    assert not completion.update(10.0, False, None)
    assert not completion.update(10.0 + SUSTAINED_S, False, None)
    assert completion.update(10.0 + ALONE_S, False, None)


def test_enough_of_floor_and_roof_is_not_all() -> None:
    """No reachable place looks into every niche."""
    assert done_after_s(None, ALL._replace(seen_share=ENOUGH_SEEN)) == SUSTAINED_S
