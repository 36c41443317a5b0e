"""What is known of a map before it is written, and the points that most formats hold."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import date

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled
from companion.errors import InputError
from companion.mapping.voxels.chunks import EDGE, NOTHING, OFFSETS
from companion.mapping.voxels.piece import MapSource
from companion.model import FloatArray


class MapFileError(InputError):
    """A file that holds no map, a name that says no format, or a map that a format cannot hold."""


Progress = Callable[[float], None]
"""Takes the share of the work that is done, from 0 to 1. An error that it raises ends the work."""

_FAR = 2**40


def silent(_share: float) -> None:
    """The progress that nobody watches."""


@dataclass(frozen=True, slots=True)
class Points:
    """Some of the occupied voxels.

    Attributes:
        centres_m: (n, 3) their centres.
        probabilities: (n,) float32, that each is occupied.
    """

    centres_m: FloatArray
    probabilities: NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Export:
    """A map that is to be written, and what one look at all of it gave.

    Formats say first how many points follow and how far they reach, and the map may be too large for the memory: so it
    is read once for this and once more for every file.

    Attributes:
        source: the map. It must not change meanwhile.
        created: the day that files are to bear, if any.
        chunks: chunks that the source gives.
        occupied: occupied voxels.
        lowest: (3,) least coordinates of occupied voxels, in voxels; zeros when there is none.
        highest: (3,) largest coordinates.
        lowest_chunk: (3,) least coordinates of chunks in which something is known; zeros when there is none.
        highest_chunk: (3,) largest coordinates.
    """

    source: MapSource
    created: date | None
    chunks: int
    occupied: int
    lowest: NDArray[np.int64]
    highest: NDArray[np.int64]
    lowest_chunk: NDArray[np.int64]
    highest_chunk: NDArray[np.int64]

    @classmethod
    def of(cls, source: MapSource, created: date | None = None, progress: Progress = silent) -> Export:
        """Look at a map. The progress stays at 0: how much there is to see is what is being found out."""
        bounds = np.empty((4, 3), np.int64)
        bounds[0::2], bounds[1::2] = _FAR, -_FAR
        chunks = occupied = 0
        for piece in source.pieces():
            chunks += len(piece.chunks)
            occupied += int(_look(piece.chunks, writable(piece.values), source.threshold, bounds))
            progress(0.0)
        bounds[bounds[:, 0] == _FAR] = bounds[bounds[:, 0] == -_FAR] = 0
        return cls(source, created, chunks, occupied, *bounds)

    def points(self, progress: Progress = silent) -> Iterator[Points]:
        """All occupied voxels, piece by piece.

        Raises:
            MapFileError: there are not as many as before.
        """
        source, chunks, occupied = self.source, 0, 0
        for piece in source.pieces():
            voxels, values = _occupied(piece.chunks, writable(piece.values), source.threshold)
            chunks += len(piece.chunks)
            occupied += len(voxels)
            if occupied > self.occupied:
                break
            yield Points(np.asarray((voxels + 0.5) * source.voxel_m, np.float64), probabilities(values))
            progress(chunks / max(self.chunks, 1))
        if occupied != self.occupied:
            raise MapFileError(
                f"the map changed while it was being written ({self.occupied} occupied voxels before, now {occupied}): "
                "write it again when nothing is put into it"
            )


def writable(values: NDArray[np.int16]) -> NDArray[np.int16]:
    """The same values as the compiled functions take them, whether they lay in a map or in a file."""
    return np.require(values, np.int16, ["C", "W"])


def probabilities(values: NDArray[np.int16]) -> NDArray[np.float32]:
    """Probabilities of log-odds in thousandths."""
    return np.asarray(1.0 / (1.0 + np.exp(values * -0.001)), np.float32)


@compiled
def _look(chunks: NDArray[np.int32], values: NDArray[np.int16], threshold: int, bounds: NDArray[np.int64]) -> int:
    """Widen ``bounds`` to these chunks; how many of their voxels are occupied.

    Args:
        chunks: (n, 3) chunk coordinates.
        values: (n, 4096) log-odds in thousandths.
        threshold: a voxel is occupied from this on.
        bounds: (4, 3) lowest and highest occupied voxel, lowest and highest chunk in which something is known.
    """
    occupied = 0
    for row in range(values.shape[0]):
        known = False
        for place in range(values.shape[1]):
            value = values[row, place]
            known |= value != NOTHING
            if value >= threshold:
                occupied += 1
                for axis in range(3):
                    at = EDGE * chunks[row, axis] + OFFSETS[place, axis]
                    bounds[0, axis] = min(bounds[0, axis], at)
                    bounds[1, axis] = max(bounds[1, axis], at)
        if known:
            for axis in range(3):
                bounds[2, axis] = min(bounds[2, axis], chunks[row, axis])
                bounds[3, axis] = max(bounds[3, axis], chunks[row, axis])
    return occupied


@compiled
def _occupied(
    chunks: NDArray[np.int32], values: NDArray[np.int16], threshold: int
) -> tuple[NDArray[np.int32], NDArray[np.int16]]:
    """(k, 3) coordinates of the occupied voxels and (k,) their log-odds."""
    found = 0
    for row in range(values.shape[0]):
        for place in range(values.shape[1]):
            found += values[row, place] >= threshold
    voxels, logs = np.empty((found, 3), np.int32), np.empty(found, np.int16)
    found = 0
    for row in range(values.shape[0]):
        for place in range(values.shape[1]):
            if values[row, place] >= threshold:
                for axis in range(3):
                    voxels[found, axis] = EDGE * chunks[row, axis] + OFFSETS[place, axis]
                logs[found] = values[row, place]
                found += 1
    return voxels, logs
