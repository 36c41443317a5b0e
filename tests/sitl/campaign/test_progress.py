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
    progress = CampaignProgress(Console(file=out), 10, [there], lambda: "2 at a time", clock.now_s)
    assert progress.line().endswith("1 complete, 0 with a contact, 0 failed; 2 at a time, how long it takes is known "
                                    "after the first")  # fmt: skip
    for row in flown:
        clock.advance(120.0)
        progress.ended(row)
    assert progress.line() == (
        "4 of 10 missions: 4 complete, 0 with a contact, 0 failed; 2 at a time, about 12 min left"
    )
    progress.ended({**mission(4).given(), **failure("x")})
    clock.advance(36000.0)
    assert progress.line() == (
        "5 of 10 missions: 4 complete, 0 with a contact, 1 failed; 2 at a time, about 12.6 h left"
    )


def test_without_a_terminal_there_is_a_line_now_and_then() -> None:
    """Protects logs from a line every half second, and from none."""
    clock, out = HandClock(), io.StringIO()
    with CampaignProgress(Console(file=out), 10, [], lambda: "2 at a time", clock.now_s) as progress:
        for _ in range(4):
            progress.look()
            clock.advance(0.75 * PLAIN_PERIOD_S)
    assert [line.partition(":")[0] for line in out.getvalue().splitlines()] == ["0 of 10 missions"] * 2
