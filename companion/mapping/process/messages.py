"""What passes between the application and the process of the map: small messages through a pipe, and readings.

Readings are in memory that both share, a ring of a few slots for each sensor. The memory is a file that has no name any
more when it is first used, so nothing is left of it however the processes end. Who writes and who reads a slot is
agreed by message: the writer takes a free one, fills it and tells the reader, who tells back when it has been read.
"""

from __future__ import annotations

import ctypes
import math
from dataclasses import dataclass
from multiprocessing.context import SpawnContext
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from companion.control.completion import MapWord
from companion.control.left_out import LeftOut
from companion.errors import CompanionError
from companion.model import Camera, Pose

SLOTS = 3
"""One is being read, one is waiting, and one is the next to be written."""


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
        word: what the map says to `Completion`; None while it knows nothing, or its process is dead or silent.
        frontiers: how many are left.
        frontiers_m: a place on each, those that count first; not more than `MOST_FRONTIERS`.
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
    word: MapWord | None = None
    frontiers: int = 0
    frontiers_m: tuple[tuple[float, float, float], ...] = ()
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
    """From the map: everything is on the disk, or why it is not; and what was seen and not looked into."""

    number: int
    problem: str = ""
    left_out: tuple[LeftOut, ...] = ()


Offered = OfferedFrame | OfferedScan
ToMap = Offered | Keep | Stop
FromMap = Preparing | Ready | Failed | Taken | MapStatus | Kept


class SlotRing:
    """The slots of one sensor. Is handed over to the other process when that is started.

    A sensor has slots of its own, so that none can take the room of another.

    Args:
        context: that starts the other process.
        shape: of every reading, or of the largest.
        dtype: of its numbers.
    """

    def __init__(self, context: SpawnContext, shape: tuple[int, ...], dtype: DTypeLike) -> None:
        self.shape = shape
        self._dtype = np.dtype(dtype)
        size_bytes = SLOTS * int(np.prod(shape)) * self._dtype.itemsize
        self._memory: Any = context.RawArray(ctypes.c_byte, size_bytes)
        self._free = list(range(SLOTS))

    def take(self) -> int | None:
        """The number of a slot to write to; None when there is none."""
        return self._free.pop() if self._free else None

    @property
    def in_use(self) -> int:
        """How many slots have not been given back."""
        return SLOTS - len(self._free)

    def array(self, slot: int) -> NDArray[Any]:
        """What is in a slot, without a copy."""
        return np.asarray(np.frombuffer(self._memory, self._dtype).reshape(SLOTS, *self.shape)[slot])

    def give_back(self, slot: int) -> None:
        """The slot has been read."""
        if slot not in self._free:
            self._free.append(slot)

    def give_back_all(self) -> None:
        """Nobody reads any more: the other process is gone."""
        self._free = list(range(SLOTS))
