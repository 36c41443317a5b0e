"""The map V: depth frames in; free, occupied and unknown space out.

`VoxelMap` runs where it is made. Whoever only needs to feed a map and to look at it takes a `Mapper`, so that the map
can live in a process of its own: frames and snapshots are plain arrays.

The compiled functions are kept in ``__pycache__``. Whoever changes one that is called from another file deletes these
(``*.nbi``, ``*.nbc``): numba compiles anew only when the calling file has changed.
"""

from __future__ import annotations

from typing import Protocol

from companion.mapping.voxels.lookup import FREE, OCCUPIED, UNKNOWN
from companion.mapping.voxels.snapshot import IntegrationReport, MapCounts, MapSnapshot
from companion.mapping.voxels.voxel_map import VoxelMap
from companion.model import DepthFrame


class Mapper(Protocol):
    """Something that builds a map."""

    def integrate(self, frame: DepthFrame) -> IntegrationReport:
        """Put one depth image into the map."""
        ...

    def snapshot(self, since: int = 0) -> MapSnapshot:
        """What the map says of the chunks that changed after revision ``since``; 0 gives all."""
        ...


__all__ = [
    "FREE",
    "OCCUPIED",
    "UNKNOWN",
    "IntegrationReport",
    "MapCounts",
    "MapSnapshot",
    "Mapper",
    "VoxelMap",
]
