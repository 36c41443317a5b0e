"""A map that writes its own journal while it grows, with a bound on its memory."""

from __future__ import annotations

import errno
import math
from collections.abc import Callable
from pathlib import Path
from typing import Self

from companion.config.mapping import MapSettings
from companion.mapping.journal import Header, Journal
from companion.mapping.journal.paging import PagedMap
from companion.mapping.voxels.piece import IntegrationReport
from companion.model import DepthFrame, PlanarScan

BYTES_PER_MB = 1_000_000

MEMORY_SLACK = 1.5
"""What the disk does not take stays in memory, but not without end: this many times the bound."""

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


class JournaledMap(PagedMap):
    """A `PagedMap` that writes its journal by itself; a context manager. For one thread.

    What changed is appended to the journal every ``settings.journal_period_s`` and then given to the disk by a thread
    of the journal's. When the disk takes nothing, the map goes on in memory and tries again.

    Args:
        settings: of the map.
        folder: of the journal; None: it is kept nowhere, and its memory has no bound.

    Attributes:
        problem: what is wrong with the disk, in words for the operator; empty when nothing is.
        kept_frames: images that survive the death of this process, of those that it integrated.
        kept_scans: the same of scans.

    Raises:
        JournalError: the folder holds another map, is in use, or cannot be written.
    """

    def __init__(self, settings: MapSettings, folder: Path | None) -> None:
        journal = None if folder is None else Journal.open(folder, Header.of(settings))
        super().__init__(settings, journal, settings.memory_mb * BYTES_PER_MB)
        self.problem = ""
        self.kept_frames = self.kept_scans = 0
        self._frames = self._scans = 0
        self._is_committing = False
        self._next_s = -math.inf

    def __enter__(self) -> Self:
        return self

    def __exit__(self, _kind: object, error: BaseException | None, _trace: object) -> None:
        """Keep everything, unless an error of ours has broken off what was done, and let go of the journal."""
        if error is None:
            self.keep()
        if self._journal is not None:
            self._tried(self._journal.close)

    @property
    def journal_bytes(self) -> int:
        """What is on the disk."""
        return 0 if self._journal is None else self._journal.bytes_on_disk

    @property
    def is_full(self) -> bool:
        """Whether the disk takes nothing and the memory no more: nothing should be integrated then."""
        return bool(self.problem) and self.memory_bytes > MEMORY_SLACK * self._bound_bytes

    def integrate(self, frame: DepthFrame) -> IntegrationReport:
        """Put one depth image into the map, as `PagedMap.integrate` does, and count it."""
        report = super().integrate(frame)
        self._frames += 1
        return report

    def integrate_scan(self, scan: PlanarScan) -> IntegrationReport:
        """Put one turn of a planar scanner into the map, as `PagedMap.integrate_scan` does, and count it."""
        report = super().integrate_scan(scan)
        self._scans += 1
        return report

    def turn(self, now_s: float) -> bool:
        """Write what is due, and take note of what the disk has done; whether anything of it is news."""
        journal = self._journal
        if journal is None or journal.is_syncing:
            return False
        news = self._commit() if self._is_committing else False
        is_dirty = (self._frames, self._scans) != (self.kept_frames, self.kept_scans)
        if now_s < self._next_s or not (is_dirty or self.problem):
            return news
        self._next_s = now_s + self._settings.journal_period_s
        self._is_committing = self._append()
        return True

    def keep(self) -> str:
        """Have everything on the disk, and wait for it; what is wrong with that, empty when nothing is."""
        if self._journal is not None and self._append():
            self._commit()
        return self.problem

    def _append(self) -> bool:
        """Write what changed, which survives this process from then on, and have the disk begin with it."""
        counts = self._frames, self._scans
        if not self._tried(lambda: self.flush(wait=False)):
            return False
        self.kept_frames, self.kept_scans = counts
        return True

    def _commit(self) -> bool:
        """Wait until what was appended is safe; whether the problem is another one then."""
        before = self.problem
        self._is_committing = False
        if self._journal is not None and self._tried(self._journal.commit):
            self.problem = ""
        return self.problem != before

    def _tried(self, write: Callable[[], object]) -> bool:
        """Whether the disk took it; when not, that is the problem."""
        try:
            write()
        except OSError as error:
            self.problem = disk_problem(error)
            return False
        return True


def disk_problem(error: OSError) -> str:
    """What the disk has against the map, and what to do; the first 50 letters go to the pilot."""
    if error.errno in _FULL:
        return f"disk full, in memory only: make room ({error.strerror})"
    return f"disk fails, in memory only: check it ({error.strerror})"
