"""What is known of a map before it is written, and the points that most formats hold."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import date

import numpy as np
from numpy.typing import NDArray

from companion.errors import InputError
from companion.mapping.files.georeference import Georeference
from companion.mapping.voxels.chunks import EDGE, NOTHING, OFFSETS
from companion.mapping.voxels.piece import MapPiece, MapSource, Progress, silent
from companion.model import FloatArray


class MapFileError(InputError):
    """A file that holds no map, a name that says no format, or a map that a format cannot hold."""


_FAR = 2**30
"""Beyond all that can be mapped."""


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
        georeference: where the map lies, for the formats that can hold it.
        chunks: chunks that the source gives.
        occupied: occupied voxels.
        lowest: (3,) least coordinates of occupied voxels, in voxels; zeros when there is none.
        highest: (3,) largest coordinates.
        lowest_chunk: (3,) least coordinates of chunks in which something is known; zeros when there is none.
        highest_chunk: (3,) largest coordinates.
    """

    source: MapSource
    created: date | None
    georeference: Georeference
    chunks: int
    occupied: int
    lowest: NDArray[np.int64]
    highest: NDArray[np.int64]
    lowest_chunk: NDArray[np.int64]
    highest_chunk: NDArray[np.int64]

    @classmethod
    def of(
        cls,
        source: MapSource,
        created: date | None = None,
        progress: Progress = silent,
        georeference: Georeference | None = None,
    ) -> Export:
        """Look at a map. The progress stays at 0: how much there is to see is what is being found out."""
        bounds = np.array([[_FAR] * 3, [-_FAR] * 3] * 2, np.int64)
        chunks = occupied = 0
        for piece in source.pieces():
            voxels, _ = _occupied(piece, source.threshold)
            chunks += len(piece.chunks)
            occupied += len(voxels)
            known = piece.chunks[(piece.values != NOTHING).any(axis=1)]
            for low, some in ((0, voxels), (2, known)):
                bounds[low] = np.minimum(bounds[low], some.min(axis=0, initial=_FAR))
                bounds[low + 1] = np.maximum(bounds[low + 1], some.max(axis=0, initial=-_FAR))
            progress(0.0)
        bounds[np.abs(bounds) == _FAR] = 0
        return cls(source, created, georeference or Georeference(), chunks, occupied, *bounds)

    def points(self, progress: Progress = silent) -> Iterator[Points]:
        """All occupied voxels, piece by piece.

        Raises:
            MapFileError: there are not as many as before.
        """
        source, chunks, occupied = self.source, 0, 0
        for piece in source.pieces():
            voxels, values = _occupied(piece, source.threshold)
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


def probabilities(values: NDArray[np.int16]) -> NDArray[np.float32]:
    """Probabilities of log-odds in thousandths."""
    return np.asarray(1.0 / (1.0 + np.exp(values * -0.001)), np.float32)


def _occupied(piece: MapPiece, threshold: int) -> tuple[NDArray[np.int32], NDArray[np.int16]]:
    """(k, 3) coordinates of the occupied voxels and (k,) their log-odds."""
    row, place = np.nonzero(piece.values >= threshold)
    return EDGE * piece.chunks[row] + OFFSETS[place], piece.values[row, place]
