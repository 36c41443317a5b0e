"""What the application and the process of the map tell each other, through one pipe. All of it is small."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from companion.model import Camera, Pose


@dataclass(frozen=True, slots=True)
class Offered:
    """To the map: there is an image in a slot, exposed at ``t_s`` from ``pose`` by ``camera``."""

    slot: int
    t_s: float
    pose: Pose
    camera: Camera


@dataclass(frozen=True, slots=True)
class Save:
    """To the map: write your files into this folder. The answer bears the same number."""

    number: int
    folder: Path


@dataclass(frozen=True, slots=True)
class Stop:
    """To the map: end."""


@dataclass(frozen=True, slots=True)
class Ready:
    """From the map: everything is loaded and compiled."""


@dataclass(frozen=True, slots=True)
class Taken:
    """From the map: the slot has been read."""

    slot: int


@dataclass(frozen=True, slots=True)
class Report:
    """From the map, several times a second: how it stands. The fields are those of `MapStatus`."""

    frames: int = 0
    refused: int = 0
    occupied: int = 0
    completeness: float = 0.0
    complete: bool = False
    frontiers: int = 0
    survey_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Saved:
    """From the map: the files that were written, or why they were not."""

    number: int
    paths: tuple[Path, ...]
    error: str | None = None


ToMap = Offered | Save | Stop
FromMap = Ready | Taken | Report | Saved
