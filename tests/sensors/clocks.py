"""Clocks for the tests of drivers."""

from __future__ import annotations

import time


class HandClock:
    """Stands still until it is set."""

    def __init__(self, now_s: float = 100.0) -> None:
        self.now = now_s

    def now_s(self) -> float:
        return self.now


class AheadClock:
    """The clock of another computer: ours, set differently."""

    def __init__(self, ahead_s: float) -> None:
        self._ahead_s = ahead_s

    def now_s(self) -> float:
        return time.monotonic() + self._ahead_s
