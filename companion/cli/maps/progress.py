"""How far a long task is: a bar on a terminal, now and then a line elsewhere, nothing when it is over at once."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bar

PATIENCE_S = 2.0
"""What takes less shows nothing."""

LINE_PERIOD_S = 10.0
"""In a log: one line in this time."""


class Progress:
    """Shows on stderr how far a task is; to be called with the share that is done, from 0 to 1, or None: not known.

    Args:
        what: the task, as the user sees it.
        console: where to show it; stderr by default.
        now_s: the time, for tests.
    """

    def __init__(self, what: str, console: Console | None = None, now_s: Callable[[], float] = time.monotonic) -> None:
        self._what = what
        self._console = Console(stderr=True) if console is None else console
        self._now_s = now_s
        self._begun_s = now_s()
        self._next_line_s = self._begun_s + PATIENCE_S
        self._bar: Bar | None = None

    def __enter__(self) -> Self:
        """Begin the task."""
        return self

    def __exit__(self, *_: object) -> None:
        """Take the bar away: what is said next stands in its place."""
        if self._bar is not None:
            self._bar.stop()

    def __call__(self, share: float | None) -> None:
        """Say that ``share`` of the task is done."""
        if self._bar is not None:
            self._bar.update(self._bar.task_ids[0], completed=share or 0.0, total=None if share is None else 1.0)
            return
        now_s = self._now_s()
        if now_s < self._next_line_s:
            return
        if self._console.is_terminal:
            columns = TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn()
            self._bar = Bar(*columns, console=self._console, transient=True)
            task = self._bar.add_task(self._what, total=None if share is None else 1.0)
            self._bar.update(task, completed=share or 0.0)
            self._bar.start()
        else:
            done = "still at it" if share is None else f"{share:.0%}"
            self._console.print(f"{self._what}: {done}", highlight=False, markup=False)
            self._next_line_s = now_s + LINE_PERIOD_S
