"""How the map stands, as whoever flies sees it."""

from __future__ import annotations

from dataclasses import dataclass

from companion.errors import CompanionError


class MapError(CompanionError):
    """The map could not be started, resumed or written."""


@dataclass(frozen=True, slots=True)
class MapStatus:
    """How the map stands.

    Attributes:
        frames: images in the map that this flight put there.
        dropped: images and scans for which there was no room, since the beginning.
        refused: those that cannot be used: of another size, or with a pose that is no number.
        occupied: occupied voxels.
        completeness: an estimate from 0 to 1 of how much of the map is there (`Survey.completeness`).
        complete: no frontier is left (`Judge.complete`).
        frontiers: how many are left.
        survey_s: how long the last look for frontiers took.
        age_s: since the process was last heard; infinite before.
        alive: whether the process runs.
        restarts: how often it died and was started again, with what the journal held.
        scans: planar scans in the map that this flight put there.
        lost: images and scans that were in the map and are not any more, because the process died before they were on
            the disk: the last second's, each time.
        resumed_chunks: chunks that the journal held when the process was last started.
        frame_ms: what one image takes, the median of the last ones.
        chunks: chunks of the map, in memory and on the disk.
        memory_bytes: what the map takes in memory.
        journal_bytes: what it takes on the disk.
        problem: what is wrong with the map, in words for the operator; empty when nothing is.
    """

    frames: int
    dropped: int
    refused: int
    occupied: int
    completeness: float
    complete: bool
    frontiers: int
    survey_s: float
    age_s: float
    alive: bool
    restarts: int
    scans: int = 0
    lost: int = 0
    resumed_chunks: int = 0
    frame_ms: float = 0.0
    chunks: int = 0
    memory_bytes: int = 0
    journal_bytes: int = 0
    problem: str = ""
