"""A map that is kept on the disk while it grows, with a bound on its memory."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray

from companion.config.mapping import MapSettings
from companion.mapping.journal import Header
from companion.mapping.journal.paging import PagedMap
from companion.mapping.process.journal_thread import PatientJournal, sync_files
from companion.mapping.process.keeper import Keeper, told
from companion.mapping.voxels.piece import MapPiece
from companion.mapping.voxels.snapshot import MapSnapshot
from companion.model import DepthFrame, PlanarScan

BYTES_PER_MB = 1_000_000

MEMORY_SLACK = 1.5
"""What the disk does not take stays in memory, but not without end: this many times the bound."""


class KeptMap:
    """A `PagedMap` that writes its journal by itself; a context manager. For one thread.

    What changed is appended to the journal every ``settings.journal_period_s`` and then given to the disk by a thread.
    When the disk takes nothing, the map goes on in memory and tries again.

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
        self.problem = ""
        self.kept_frames = self.kept_scans = 0
        self._settings = settings
        self._folder = folder
        self._bound_bytes = settings.memory_mb * BYTES_PER_MB
        self._journal = None if folder is None else PatientJournal.open(folder, Header.of(settings))
        self._map = PagedMap(settings, self._journal, self._bound_bytes)
        self._keeper = Keeper(self._sync)
        self._frames = self._scans = 0
        self._synced_ns = self._written_ns = 0
        self._dirty = self._syncing = False
        self._next_s = -math.inf

    def __enter__(self) -> Self:
        """Nothing but itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Keep everything, unless an error of ours has broken off what was done, and let go of the journal."""
        self._keeper.wait()
        if error is None:
            self.keep()
        if self._journal is not None:
            try:
                self._journal.close()
            except OSError as refused:
                self.problem = told(refused)

    @property
    def voxel_m(self) -> float:
        """Edge of a voxel."""
        return self._map.voxel_m

    @property
    def threshold(self) -> int:
        """A voxel is occupied from this value on, in thousandths of log-odds."""
        return self._map.threshold

    @property
    def revision(self) -> int:
        """Grows with everything that changes the map."""
        return self._map.revision

    @property
    def chunks(self) -> int:
        """How many chunks there are, in memory and in the journal."""
        return self._map.chunks

    @property
    def chunks_in_memory(self) -> int:
        """How many of them are in memory."""
        return self._map.chunks_in_memory

    @property
    def memory_bytes(self) -> int:
        """What is in memory."""
        return self._map.memory_bytes

    @property
    def journal_bytes(self) -> int:
        """What is on the disk."""
        return 0 if self._journal is None else self._journal.bytes_on_disk

    def snapshot(self, since: int = 0) -> MapSnapshot:
        """The states of the chunks that changed after revision ``since``, as a copy; 0 gives all."""
        return self._map.snapshot(since)

    def pieces(self) -> Iterator[MapPiece]:
        """Every chunk once, those on the disk too."""
        return self._map.pieces()

    def integrate(self, frame: DepthFrame) -> bool:
        """Put one depth image into the map; whether there was room for it. The image may be changed.

        Raises:
            ValueError: as `VoxelMap.integrate`.
        """
        if self._is_full():
            return False
        _leave_out_saturated(frame.depth_m, self._settings.saturated_m)
        self._map.integrate(frame)
        self._frames += 1
        self._dirty = True
        return True

    def integrate_scan(self, scan: PlanarScan) -> bool:
        """Put one turn of a planar scanner into the map; whether there was room for it. The ranges may be changed.

        Raises:
            ValueError: as `VoxelMap.integrate_scan`.
        """
        if self._is_full():
            return False
        _leave_out_saturated(scan.ranges_m, self._settings.saturated_m)
        self._map.integrate_scan(scan)
        self._scans += 1
        self._dirty = True
        return True

    def turn(self, now_s: float) -> bool:
        """Write what is due, and take note of what the thread has done; whether anything of it is news."""
        if self._journal is None or self._keeper.busy:
            return False
        news = self._commit() if self._syncing else False
        if now_s < self._next_s or not (self._dirty or self.problem):
            return news
        self._next_s = now_s + self._settings.journal_period_s
        if self._append():
            self._begin_sync()
        return True

    def keep(self) -> str:
        """Have everything on the disk, and wait for it; what is wrong with that, empty when nothing is."""
        if self._journal is not None:
            self._keeper.wait()
            if self._append():
                self._commit()
        return self.problem

    def _append(self) -> bool:
        """Write what changed: from then on it survives this process."""
        journal = self._journal
        if journal is None:
            return False
        journal.patient = True
        self._written_ns = time.time_ns()
        try:
            self._map.flush()
        except OSError as error:
            self.problem = told(error)
            return False
        finally:
            journal.patient = False
        self._dirty = False
        self.kept_frames, self.kept_scans = self._frames, self._scans
        return True

    def _begin_sync(self) -> None:
        self._syncing = True
        self._keeper.begin()

    def _sync(self) -> None:
        """In the thread."""
        if self._folder is not None:
            sync_files(self._folder, self._synced_ns)

    def _commit(self) -> bool:
        """Make sure of what was appended; nothing has been since the thread began. Whether the problem is another."""
        before, refused = self.problem, self._keeper.result() if self._syncing else None
        self._syncing = False
        try:
            if self._journal is not None:
                self._journal.commit()
        except OSError as error:
            refused = error
        if refused is None:
            self._synced_ns = self._written_ns
        self.problem = "" if refused is None else told(refused)
        return self.problem != before

    def _is_full(self) -> bool:
        """Whether the disk takes nothing and the memory no more."""
        return bool(self.problem) and self._map.memory_bytes > MEMORY_SLACK * self._bound_bytes


def _leave_out_saturated(readings_m: NDArray[np.floating], saturated_m: float | None) -> None:
    """Make NaN of what the sensor says when nothing comes back."""
    if saturated_m is not None:
        readings_m[readings_m >= saturated_m] = np.nan
