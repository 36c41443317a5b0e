"""Pieces of a map with all that is known of their voxels: what is kept, sent to the disk, merged and exported."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

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
