"""What a map says at one moment, free of the map that said it: it can be pickled, sent and kept."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.mapping.voxels.lookup import FREE, OCCUPIED, centres
from companion.model import FloatArray


@dataclass(frozen=True, slots=True)
class IntegrationReport:
    """What became of one frame.

    Attributes:
        hits: voxels that held the end of a ray.
        misses: voxels that were looked through, and are surer of being free than before.
        pixels_hit: pixels that measured a surface within the map's range.
        pixels_clear: pixels that saw free space up to the limit.
        pixels_invalid: pixels that said nothing: NaN, or nearer than the camera measures.
        chunks_updated: chunks in which some voxel changed.
        chunks_new: chunks that were seen for the first time.
    """

    hits: int
    misses: int
    pixels_hit: int
    pixels_clear: int
    pixels_invalid: int
    chunks_updated: int
    chunks_new: int


@dataclass(frozen=True, slots=True)
class MapCounts:
    """How many voxels a map holds.

    Attributes:
        occupied: voxels with an obstacle.
        free: voxels seen free.
        undecided: voxels that were seen, but not well enough to say; they count as unknown.
        chunks: chunks of 16 x 16 x 16 voxels with something in them.
    """

    occupied: int
    free: int
    undecided: int
    chunks: int


@dataclass(frozen=True, slots=True)
class MapSnapshot:
    """The states of the chunks that changed after some revision of a map, or of all.

    Attributes:
        voxel_m: edge of a voxel.
        revision: the map's revision; ask for what changed since then to get the next difference.
        chunks: (n, 3) int32 chunk coordinates: voxel (i, j, k) is in chunk (i // 16, j // 16, k // 16), and covers
            i voxel_m <= x < (i + 1) voxel_m, and so on.
        states: (n, 4096) uint8, `UNKNOWN`, `FREE` or `OCCUPIED`, in Morton order: the bits of the place are, from the
            lowest, those of x, y, z, x, y, z ... inside the chunk.
    """

    voxel_m: float
    revision: int
    chunks: NDArray[np.int32]
    states: NDArray[np.uint8]

    def occupied(self) -> FloatArray:
        """(n, 3) centres of the occupied voxels, in m."""
        return np.asarray(centres(self.chunks, self.states, OCCUPIED, self.voxel_m))

    def free(self) -> FloatArray:
        """(n, 3) centres of the free voxels, in m."""
        return np.asarray(centres(self.chunks, self.states, FREE, self.voxel_m))
