"""How far a campaign is: what became of the missions, and how long the rest will take."""

from __future__ import annotations

import io

from rich.console import Console

from sitl.campaign.mission import Row, failure
from sitl.campaign.progress import PLAIN_PERIOD_S, CampaignProgress
from tests.shared.clocks import HandClock
from tests.sitl.campaign.missions import mission, once


def rows(count: int) -> list[Row]:
    return [{**mission(number).given(), **once(mission(number))} for number in range(count)]


def test_the_rest_takes_as_long_as_what_was_flown_by_this_command() -> None:
    """Protects the estimate after a restart: what was there before took none of its time."""
    clock, out = HandClock(), io.StringIO()
    there, *flown = rows(4)
    progress = CampaignProgress(Console(file=out, width=200), 10, [there], lambda: "2 at a time", clock.now_s)
    progress.look()
    for row in flown:
        clock.advance(120.0)
        progress.ended(row)
    progress.look()
    progress.ended({**mission(4).given(), **failure("x")})
    clock.advance(36000.0)
    progress.look()
    assert out.getvalue().splitlines() == [
        "1 of 10 missions, time left not known yet, 2 at a time: 1 complete, 0 with a contact, 0 failed",
        "4 of 10 missions, about 12 min left, 2 at a time: 4 complete, 0 with a contact, 0 failed",
        "5 of 10 missions, about 12.6 h left, 2 at a time: 4 complete, 0 with a contact, 1 failed",
    ]


def test_without_a_terminal_there_is_a_line_now_and_then() -> None:
    """Protects logs from a line every half second, and from none."""
    clock, out = HandClock(), io.StringIO()
    with CampaignProgress(Console(file=out, width=200), 10, [], lambda: "2 at a time", clock.now_s) as progress:
        for _ in range(4):
            progress.look()
            clock.advance(0.75 * PLAIN_PERIOD_S)
    first, second, last = out.getvalue().splitlines()
    assert first == second
    assert last == "0 of 10 missions: 0 complete, 0 with a contact, 0 failed"
