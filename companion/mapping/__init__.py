"""The map V: depth frames in; free, occupied and unknown space out.

`VoxelMap` runs where it is made. `process` has the map in a process of its own, with a journal on the disk: frames and
snapshots are plain arrays. `frontiers` says what is left to explore, `files` writes a map for other programs
and reads theirs, `datasets` has depth images that others recorded.
"""

from __future__ import annotations

from companion.mapping.voxels.lookup import FREE, OCCUPIED, UNKNOWN
from companion.mapping.voxels.piece import IntegrationReport, MapCounts, MapSnapshot
from companion.mapping.voxels.voxel_map import VoxelMap

__all__ = ["FREE", "OCCUPIED", "UNKNOWN", "IntegrationReport", "MapCounts", "MapSnapshot", "VoxelMap"]
