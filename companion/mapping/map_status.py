"""How the map stands, as whoever flies sees it."""

from __future__ import annotations

from dataclasses import dataclass

from companion.errors import CompanionError


class MapError(CompanionError):
    """The map could not be started or written."""


@dataclass(frozen=True, slots=True)
class MapStatus:
    """How the map stands.

    Attributes:
        frames: images in the map.
        dropped: images for which there was no room, since the beginning.
        refused: images that cannot be used: of another size, or with a pose that is no number.
        occupied: occupied voxels.
        completeness: an estimate from 0 to 1 of how much of the map is there (`Survey.completeness`).
        complete: no frontier is left (`Judge.complete`).
        frontiers: how many are left.
        survey_s: how long the last look for frontiers took.
        age_s: since the process was last heard; infinite before.
        alive: whether the process runs.
        restarts: how often it died and was started again. Each time the map began anew, empty.
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
