"""Pieces of a map with all that is known of their voxels: what is kept, sent to the disk, merged and exported."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled
from companion.mapping.voxels.chunks import NOTHING

MOST_CHUNKS = 1024
"""Chunks of one piece, where nothing else is said: 8 MiB of voxels."""


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
