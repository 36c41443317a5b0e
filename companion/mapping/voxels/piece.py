"""What a map gives away, free of the map that said it: it can be pickled, sent and kept.

Pieces have all that is known of their voxels: they are kept, sent to the disk, merged and exported.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled
from companion.mapping.voxels.chunks import NOTHING
from companion.mapping.voxels.lookup import FREE, OCCUPIED, centres
from companion.model import FloatArray

Progress = Callable[[float], None]
"""Takes the share of the work that is done, from 0 to 1. An error that it raises ends the work."""

MOST_CHUNKS = 1024
"""Chunks of one piece, where nothing else is said: 8 MiB of voxels."""


def silent(_share: float) -> None:
    """The progress that nobody watches."""


@dataclass(frozen=True, slots=True)
class MapPiece:
    """Some chunks of a map.

    Attributes:
        chunks: (n, 3) int32 chunk coordinates, each once: voxel (i, j, k) is in chunk (i // 16, j // 16, k // 16).
        values: (n, 4096) int16 log-odds in thousandths, `NOTHING` where nothing was ever seen, in Morton order.
    """

    chunks: NDArray[np.int32]
    values: NDArray[np.int16]


class MapSource(Protocol):
    """Something that holds a whole map and gives it away piece by piece, so that it need not fit into memory twice."""

    @property
    def voxel_m(self) -> float:
        """Edge of a voxel."""
        ...

    @property
    def threshold(self) -> int:
        """A voxel is occupied from this value on, in thousandths of log-odds, and free below zero."""
        ...

    def pieces(self, most_chunks: int = MOST_CHUNKS) -> Iterator[MapPiece]:
        """Every chunk once, in no particular order, ``most_chunks`` at a time."""
        ...


@compiled
def add_log_odds(ours: NDArray[np.int16], theirs: NDArray[np.int16], lowest: int, highest: int) -> None:
    """Add ``theirs`` to ``ours``, and clamp; `NOTHING` adds nothing, and stays where neither knows anything.

    Args:
        ours: (n, k) log-odds in thousandths; is changed.
        theirs: (n, k) the same voxels of another map.
        lowest: lower clamp.
        highest: upper clamp.
    """
    for row in range(ours.shape[0]):
        for place in range(ours.shape[1]):
            a, b = np.int32(ours[row, place]), np.int32(theirs[row, place])
            known_a, known_b = a != NOTHING, b != NOTHING
            total = (a if known_a else np.int32(0)) + (b if known_b else np.int32(0))
            clamped = min(max(total, np.int32(lowest)), np.int32(highest))
            ours[row, place] = np.int16(clamped if known_a | known_b else NOTHING)


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
        return centres(self.chunks, self.states, OCCUPIED, self.voxel_m)

    def free(self) -> FloatArray:
        """(n, 3) centres of the free voxels, in m."""
        return centres(self.chunks, self.states, FREE, self.voxel_m)
