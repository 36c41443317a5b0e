"""What a map amounts to, in numbers: found in one pass over its pieces."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled
from companion.mapping.files.surface_area import SurfaceArea
from companion.mapping.voxels.chunks import EDGE, NOTHING, OFFSETS, VOLUME
from companion.mapping.voxels.piece import MapSource

_PIECE = 256
"""Chunks taken at a time: small enough that progress shows and Ctrl-C acts at once."""

_LIMIT = np.int64(1) << 40


@dataclass(frozen=True, slots=True)
class MapFacts:
    """The figures of a map.

    Attributes:
        voxel_m: edge of a voxel.
        chunks: blocks of 16 x 16 x 16 voxels in which something was seen.
        occupied: voxels with an obstacle.
        free: voxels seen free.
        undecided: voxels that were seen, but not well enough to say.
        low_m, high_m: the box around all voxels that are occupied or free; None when there are none.
        free_m3: volume of the free voxels.
        surface_m2: area of the surface between free and occupied, estimated.
    """

    voxel_m: float
    chunks: int
    occupied: int
    free: int
    undecided: int
    low_m: tuple[float, float, float] | None
    high_m: tuple[float, float, float] | None
    free_m3: float
    surface_m2: float

    @property
    def extent_m(self) -> tuple[float, float, float]:
        """Edges of the box around what is known."""
        if self.low_m is None or self.high_m is None:
            return 0.0, 0.0, 0.0
        x, y, z = (high - low for low, high in zip(self.low_m, self.high_m, strict=True))
        return x, y, z


def facts_of(source: MapSource, progress: Callable[[int], None] = lambda _: None) -> MapFacts:
    """Go through a map once.

    Args:
        source: the map.
        progress: is given how many chunks were seen so far.
    """
    counts = np.zeros(4, np.int64)
    box = np.array([[_LIMIT] * 3, [-_LIMIT] * 3])
    area = SurfaceArea()
    for piece in source.pieces(_PIECE):
        # Compiled functions are compiled anew for memory that is read-only, as that of a file is.
        values = np.require(piece.values, np.int16, ["C", "W"])
        _count(np.require(piece.chunks, np.int32, ["C", "W"]), values, source.threshold, counts, box)
        area.add(piece.chunks, values, source.threshold)
        progress(int(counts[3]))
    occupied, free, undecided, chunks = (int(count) for count in counts)
    corners = [(float(x), float(y), float(z)) for x, y, z in box * source.voxel_m]
    return MapFacts(
        voxel_m=source.voxel_m,
        chunks=chunks,
        occupied=occupied,
        free=free,
        undecided=undecided,
        low_m=corners[0] if occupied or free else None,
        high_m=corners[1] if occupied or free else None,
        free_m3=free * source.voxel_m**3,
        surface_m2=area.in_faces() * source.voxel_m**2,
    )


@compiled
def _count(
    chunks: NDArray[np.int32],
    values: NDArray[np.int16],
    threshold: int,
    counts: NDArray[np.int64],
    box: NDArray[np.int64],
) -> None:
    """Count the voxels of some chunks, and widen the box around those that are occupied or free.

    Args:
        chunks: (n, 3) coordinates.
        values: (n, 4096) log-odds.
        threshold: occupied from this on.
        counts: (4,) occupied, free, undecided voxels, and chunks with something in them; are added to.
        box: (2, 3) lowest voxel and the one after the highest; is widened.
    """
    for row in range(chunks.shape[0]):
        occupied = free = seen = 0
        for place in range(VOLUME):
            value = values[row, place]
            occupied += value >= threshold
            free += (value < 0) & (value != NOTHING)
            seen += value != NOTHING
        counts[0] += occupied
        counts[1] += free
        counts[2] += seen - occupied - free
        counts[3] += seen > 0
        inside = True
        for axis in range(3):
            corner = np.int64(chunks[row, axis]) * EDGE
            inside &= corner >= box[0, axis] and corner + EDGE <= box[1, axis]
        if inside or occupied + free == 0:
            continue
        for place in range(VOLUME):
            value = values[row, place]
            if value >= threshold or (value < 0 and value != NOTHING):
                for axis in range(3):
                    at = np.int64(chunks[row, axis]) * EDGE + OFFSETS[place, axis]
                    box[0, axis] = min(box[0, axis], at)
                    box[1, axis] = max(box[1, axis], at + 1)
