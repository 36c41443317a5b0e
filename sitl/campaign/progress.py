"""How far a campaign is, for whoever waits: a bar in a terminal, a line now and then elsewhere."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn

from sitl.campaign.groups import Group
from sitl.campaign.mission import Row

PLAIN_PERIOD_S = 30.0
"""Without a terminal one line is printed this often, and one at the end."""


def outcomes(rows: Sequence[Row]) -> str:
    """What became of missions."""
    group = Group("all", rows)
    return f"{group.complete} complete, {group.contacts} with a contact, {group.failed} failed"


class CampaignProgress:
    """A context manager that is told of every mission, or of whatever else a campaign does, as it ends.

    Args:
        console: where it is shown.
        asked: how many missions the campaign has.
        there: rows of the missions that were there before.
        who: says who flies.
        clock: monotonic time in s.
        what: of which there are that many.
        counts: says what became of those that have ended.
    """

    def __init__(
        self,
        console: Console,
        asked: int,
        there: list[Row],
        who: Callable[[], str],
        clock: Callable[[], float],
        what: str = "missions",
        counts: Callable[[Sequence[Row]], str] = outcomes,
    ) -> None:
        self._console = console
        self._asked = asked
        self._rows = list(there)
        self._who = who
        self._clock = clock
        self._what = what
        self._counts = counts
        self._before = len(there)
        self._began_s = clock()
        self._next_line_s = self._began_s
        self._bar = Progress(
            BarColumn(20), TextColumn("{task.description}"), console=console, transient=True, auto_refresh=True
        )
        self._task = self._bar.add_task(self.line(self._left()), total=asked, completed=len(there))

    def __enter__(self) -> Self:
        if self._console.is_terminal:
            self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._console.is_terminal:
            self._bar.stop()
        self._console.print(self.line(), highlight=False, soft_wrap=True)

    def ended(self, row: Row) -> None:
        """Count a mission that has ended."""
        self._rows.append(row)

    def look(self) -> None:
        """Show how far it is."""
        now_s = self._clock()
        if self._console.is_terminal:
            self._bar.update(self._task, completed=len(self._rows), description=self.line(self._under_way()))
        elif now_s >= self._next_line_s:
            self._next_line_s = now_s + PLAIN_PERIOD_S
            self._console.print(self.line(self._under_way()), highlight=False, soft_wrap=True)

    def line(self, under_way: str = "") -> str:
        """Missions, and what became of them; first what is cut off last where a terminal is narrow."""
        parts = filter(None, (f"{len(self._rows)} of {self._asked} {self._what}", under_way))
        return f"{', '.join(parts)}: {self._counts(self._rows)}"

    def _under_way(self) -> str:
        return f"{self._left()}, {self._who()}"

    def _left(self) -> str:
        flown, left = len(self._rows) - self._before, self._asked - len(self._rows)
        if flown == 0:
            return "time left not known yet"
        minutes = (self._clock() - self._began_s) / flown * left / 60.0
        return f"about {minutes / 60.0:.1f} h left" if minutes >= 90.0 else f"about {minutes:.0f} min left"
