"""Which orders reach the application, and what becomes of those that come again."""

from __future__ import annotations

from dataclasses import replace

import pytest

from companion.link.vehicle.guard import MOST_REMEMBERED, CommandGuard, by_its_word
from companion.link.wire import Order, RefusedError, SignedOrder, encoded
from companion.link.words import Answer, Command

ORDER = Order("0123456789abcdef" * 2, 1, "drone1", "session", 100.0, Command.STOP, "anna")
DONE = Answer(accepted=True)


def guard() -> CommandGuard:
    return CommandGuard("drone1", "session", 5.0, by_its_word)


def sent(order: Order) -> bytes:
    return encoded(SignedOrder(encoded(order).decode()))


def test_an_order_passes_once_and_its_answer_is_said_again() -> None:
    """Protects from doing twice what a bad link makes a sender ask twice."""
    ours = guard()
    assert ours.check(sent(ORDER), 100.1) == (ORDER, None, True)
    second, third = replace(ORDER, attempt=2), replace(ORDER, attempt=3)
    assert ours.check(sent(second), 100.6) == (second, None, False), "not answered yet"
    ours.answered(ORDER.id, DONE)
    assert ours.check(sent(third), 101.1) == (third, DONE, False)


@pytest.mark.parametrize(
    ("order", "now_s", "why"),
    [
        (replace(ORDER, vehicle="drone2"), 100.1, "for the vehicle 'drone2', and this is drone1"),
        (replace(ORDER, session="earlier"), 100.1, "before the vehicle's link began anew"),
        (ORDER, 105.2, r"5\.2 s ago, more than link\.oldest_command_s = 5 s"),
        (ORDER, 98.5, r"1\.5 s ahead"),
        (replace(ORDER, id="short"), 100.1, "number"),
        (replace(ORDER, id="0123456789ABCDEF" * 2), 100.1, "number"),
    ],
    ids=["another vehicle", "another session", "old", "from the future", "no id", "no id either"],
)
def test_what_may_not_be_obeyed_is_refused_with_its_reason(order: Order, now_s: float, why: str) -> None:
    with pytest.raises(RefusedError, match=why):
        guard().check(sent(order), now_s)


def test_a_replay_is_refused() -> None:
    ours = guard()
    ours.check(sent(ORDER), 100.1)
    ours.check(sent(replace(ORDER, attempt=2)), 100.2)
    for again in (ORDER, replace(ORDER, attempt=2)):
        with pytest.raises(RefusedError, match="replay"):
            ours.check(sent(again), 100.3)
    with pytest.raises(RefusedError, match="ago"):
        ours.check(sent(ORDER), 107.0)


def test_a_number_stands_for_one_command() -> None:
    ours = guard()
    ours.check(sent(ORDER), 100.1)
    with pytest.raises(RefusedError, match="same number"):
        ours.check(sent(replace(ORDER, attempt=2, command=Command.LAND)), 100.2)


def test_a_flood_of_orders_is_bounded() -> None:
    ours = guard()
    for number in range(MOST_REMEMBERED):
        ours.check(sent(replace(ORDER, id=f"{number:032x}")), 100.1)
    with pytest.raises(RefusedError, match="wait a moment"):
        ours.check(sent(ORDER), 100.2)
    late = replace(ORDER, clock_s=107.0)
    assert ours.check(sent(late), 107.0)[2], "what is too old to be obeyed is forgotten"


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"{}",
        b"\xff",
        encoded(SignedOrder("{}")),
        encoded(SignedOrder(encoded(ORDER).decode().replace("100.0", "NaN"))),
        encoded(SignedOrder(encoded(ORDER).decode().replace("stop", "fly into the wall"))),
        b'{"order": "' + b"x" * 100_000 + b'"}',
    ],
    ids=["nothing", "empty", "no text", "no order", "NaN", "unknown", "large"],
)
def test_what_is_no_order_is_refused(data: bytes) -> None:
    with pytest.raises(RefusedError):
        guard().check(data, 100.1)
