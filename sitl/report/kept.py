"""What a mission has flown and mapped, on the disk while it flies: whoever is killed loses some seconds of it."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Self

import numpy as np

from companion.mapping.journal import JOURNAL_NAME, Header, Journal, JournalError
from companion.mapping.journal.paging import COMPACT_S
from companion.mapping.voxels.chunks import chunks_of, keys_of
from companion.mapping.voxels.piece import MOST_CHUNKS
from sitl.sim.flight_log import CSV_HEADER, FlightLog
from sitl.sim.simulation import Simulation

PERIOD_S = 1.0
"""Nothing is kept more often than this, of the time that somebody waits."""

SHARE = 0.01
"""Of the time that a mission takes, so much may go into keeping it: after what took long, the next one waits longer."""


class Kept:
    """Trajectories and map of a mission in the folder of its run, brought up to date while it flies.

    A context manager. What the disk does not take is tried again the next time; what is wrong with it for good,
    `keep_map` says at the end.

    Args:
        folder: of the run.
        simulation: the mission.
        now_s: monotonic time.
    """

    def __init__(self, folder: Path, simulation: Simulation, now_s: Callable[[], float] = time.perf_counter) -> None:
        self.folder = folder
        self.simulation = simulation
        self._now_s = now_s
        self._next_s = now_s() + PERIOD_S
        self._rows = [0] * len(simulation.flights)
        self._bytes = [0] * len(simulation.flights)
        self._revisions = [0] * len(simulation.flights)
        self._journal: Journal | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Let go of the journal; without `keep_map` it is as of the last look."""
        journal, self._journal = self._journal, None
        if journal is not None:
            with suppress(OSError):
                journal.close()

    def trajectory(self, log: FlightLog) -> Path:
        """Where the trajectory of a vehicle goes."""
        alone = len(self.simulation.flights) == 1
        return self.folder / ("trajectory.csv" if alone else f"trajectory-{log.vehicle_id}.csv")

    def look(self) -> None:
        """Keep what is new, when it is time for that."""
        began_s = self._now_s()
        if began_s < self._next_s:
            return
        with suppress(OSError):
            self._append_rows()
        with suppress(OSError, JournalError):
            self._append_chunks()
        ended_s = self._now_s()
        self._next_s = ended_s + max(PERIOD_S, (ended_s - began_s) / SHARE)

    def keep_map(self) -> None:
        """Write what is not in the journal yet, and close it.

        Raises:
            OSError: the disk is full or broken.
            JournalError: the same, when there is no journal yet.
        """
        self._append_chunks()
        journal, self._journal = self._journal, None
        if journal is not None:
            journal.close()

    def _append_rows(self) -> None:
        for number, flight in enumerate(self.simulation.flights):
            path, rows, kept_bytes = self.trajectory(flight.log), self._rows[number], self._bytes[number]
            data = (("" if rows else CSV_HEADER) + flight.log.csv_rows(rows)).encode()
            with path.open("r+b" if kept_bytes else "wb") as file:
                # A disk that was full has taken half a row.
                file.seek(kept_bytes)
                file.truncate()
                file.write(data)
            self._rows[number], self._bytes[number] = len(flight.log), kept_bytes + len(data)

    def _append_chunks(self) -> None:
        maps = [flight.map for flight in self.simulation.flights]
        revisions = [voxels.revision for voxels in maps]
        if self._journal is None:
            self._journal = Journal.open(self.folder / JOURNAL_NAME, Header.of(self.simulation.settings.mapping))
        changed = [voxels.changed(since) for voxels, since in zip(maps, self._revisions, strict=True)]
        chunks = chunks_of(np.unique(keys_of(np.concatenate(changed))))
        everything = self.simulation.merged_map()
        for first in range(0, len(chunks), MOST_CHUNKS):
            self._journal.append(everything.piece(chunks[first : first + MOST_CHUNKS]))
        self._revisions = revisions
        self._journal.compact_step(COMPACT_S)
        self._journal.commit()
