"""The messages between the application and the process of the map, through one pipe. All of them are small."""

from __future__ import annotations

import math
from dataclasses import dataclass

from companion.errors import CompanionError
from companion.model import Camera, Pose


class MapError(CompanionError):
    """The map could not be started, resumed or written."""


@dataclass(frozen=True, slots=True)
class OfferedFrame:
    """To the map: there is an image in a slot of camera number ``source``, exposed at ``t_s`` from ``pose``."""

    source: int
    slot: int
    t_s: float
    pose: Pose
    camera: Camera


@dataclass(frozen=True, slots=True)
class OfferedScan:
    """To the map: there is one turn of a planar scanner in a slot, with ``rays`` rays."""

    source: int
    slot: int
    t_s: float
    pose: Pose
    rays: int
    max_range_m: float


@dataclass(frozen=True, slots=True)
class Keep:
    """To the map: put everything that came before this on the disk. The answer bears the same number."""

    number: int


@dataclass(frozen=True, slots=True)
class Stop:
    """To the map: put what you have on the disk and end."""


@dataclass(frozen=True, slots=True)
class Preparing:
    """From the map, before it is ready: it goes on, and what it is at."""

    what: str


@dataclass(frozen=True, slots=True)
class Ready:
    """From the map: everything is loaded and compiled.

    Attributes:
        resumed_chunks: how many chunks the journal held already.
    """

    resumed_chunks: int = 0


@dataclass(frozen=True, slots=True)
class Failed:
    """From the map: it cannot begin, and why."""

    why: str


@dataclass(frozen=True, slots=True)
class Taken:
    """From the map: the slot has been read. ``used``: what was in it is in the map."""

    source: int
    slot: int
    used: bool


@dataclass(frozen=True, slots=True)
class MapStatus:
    """From the map, several times a second: how it stands. `MapClient.status` adds what only the application knows.

    Attributes:
        kept_frames: images on the disk, of those that this process took.
        kept_scans: the same of scans.
        occupied: occupied voxels.
        completeness: an estimate from 0 to 1 of how much of the map is there (`Survey.completeness`).
        complete: no frontier is left (`Judge.complete`).
        frontiers: how many are left.
        survey_s: how long the last look for frontiers took.
        frame_ms: what one image takes, the median of the last ones.
        chunks: chunks of the map, in memory and on the disk.
        memory_bytes: what the map takes in memory.
        journal_bytes: what it takes on the disk.
        problem: what is wrong with the map, in words for the operator; empty when nothing is.
        frames: images in the map that this flight put there; from here on known to the application alone.
        scans: planar scans in the map that this flight put there.
        dropped: images and scans for which there was no room, since the beginning.
        refused: those that cannot be used: of another size, or with a pose that is no number.
        lost: images and scans that were in the map and are not any more, because the process died before they were on
            the disk: the last second's, each time.
        age_s: since the last message of the process; infinite before.
        alive: whether the process runs.
        restarts: how often it died and was started again, with what the journal held.
        resumed_chunks: chunks that the journal held when the process was last started.
    """

    kept_frames: int = 0
    kept_scans: int = 0
    occupied: int = 0
    completeness: float = 0.0
    complete: bool = False
    frontiers: int = 0
    survey_s: float = 0.0
    frame_ms: float = 0.0
    chunks: int = 0
    memory_bytes: int = 0
    journal_bytes: int = 0
    problem: str = ""
    frames: int = 0
    scans: int = 0
    dropped: int = 0
    refused: int = 0
    lost: int = 0
    age_s: float = math.inf
    alive: bool = False
    restarts: int = 0
    resumed_chunks: int = 0


@dataclass(frozen=True, slots=True)
class Kept:
    """From the map: everything is on the disk, or why it is not."""

    number: int
    problem: str = ""


Offered = OfferedFrame | OfferedScan
ToMap = Offered | Keep | Stop
FromMap = Preparing | Ready | Failed | Taken | MapStatus | Kept
