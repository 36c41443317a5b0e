"""What the application and the process of the map tell each other, through one pipe. All of it is small."""

from __future__ import annotations

from dataclasses import dataclass

from companion.model import Camera, Pose


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
class Report:
    """From the map, several times a second: how it stands. The fields are those of `MapStatus`.

    Attributes:
        kept_frames: how many images are on the disk, of those that this process took.
        kept_scans: the same of scans.
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


@dataclass(frozen=True, slots=True)
class Kept:
    """From the map: everything is on the disk, or why it is not."""

    number: int
    problem: str = ""


Offered = OfferedFrame | OfferedScan
ToMap = Offered | Keep | Stop
FromMap = Preparing | Ready | Failed | Taken | Report | Kept
