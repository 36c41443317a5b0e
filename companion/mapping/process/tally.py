"""What became of every image and scan that the map was offered."""

from __future__ import annotations

from collections import Counter
from typing import Literal

Kind = Literal["frames", "scans"]


class Tally:
    """Counts over all processes of one map: each offer ends as in the map, dropped, refused or lost.

    Attributes:
        dropped: there was no room, or the process that had it died before it looked at it.
        refused: cannot be used.
        lost: were in the map of a process that died before they were on the disk.
    """

    def __init__(self) -> None:
        self.dropped = self.refused = self.lost = 0
        self._safe: Counter[Kind] = Counter()  # of processes that are gone
        self._used: Counter[Kind] = Counter()  # of this process
        self._kept: Counter[Kind] = Counter()  # of these, on the disk

    def used(self, kind: Kind) -> None:
        """One more is in the map."""
        self._used[kind] += 1

    def kept(self, frames: int, scans: int) -> None:
        """So many of what this process took are on the disk."""
        self._kept = Counter[Kind]({"frames": frames, "scans": scans})

    def died(self, waiting: int) -> int:
        """The process is gone with what was not on the disk, and with ``waiting`` that it had not looked at.

        Returns:
            How many are lost with it.
        """
        lost = self._used.total() - self._kept.total()
        self.lost += lost
        self.dropped += waiting
        self._safe += self._kept
        self._used.clear()
        self._kept.clear()
        return lost

    def in_map(self, kind: Kind) -> int:
        """How many are in the map."""
        return self._safe[kind] + self._used[kind]
