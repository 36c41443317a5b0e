"""Several maps of the same place as one: log-odds are added, then clamped.

Chunks are joined by their coordinates, a few hundred at a time, so that no map has to be in memory as a whole.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from companion.mapping.journal.rows import keys_of
from companion.mapping.voxels.chunks import NOTHING, VOLUME
from companion.mapping.voxels.fusion import add_log_odds
from companion.mapping.voxels.piece import MOST_CHUNKS, MapPiece

_LEAST, _MOST = -32767, 32767
"""What a voxel's 16 bits hold beside `NOTHING`: the clamps while there is more to add."""


class IndexedMap(Protocol):
    """A map that gives the chunks that it is asked for, such as a journal."""

    @property
    def voxel_m(self) -> float:
        """Edge of a voxel."""
        ...

    @property
    def chunks(self) -> NDArray[np.int32]:
        """(n, 3) coordinates of all its chunks."""
        ...

    def read(self, chunks: NDArray[np.int32]) -> MapPiece:
        """Those of ``chunks`` (n, 3) that it has."""
        ...


class MergedMap:
    """Several maps as one `MapSource`; each piece is added up when it is asked for.

    The order of the maps does not matter: all are added before anything is clamped. (Sums are held to 16 bits, which
    four maps never fill.)

    Args:
        maps: at least one; all with voxels of the same size, in the same frame.
        threshold: a voxel of the result is occupied from this value on.
        lowest: lower clamp of the result.
        highest: upper clamp of the result.

    Raises:
        ValueError: there is no map, or voxel sizes differ.
    """

    def __init__(self, maps: Sequence[IndexedMap], threshold: int, lowest: int, highest: int) -> None:
        sizes = {voxels.voxel_m for voxels in maps}
        if len(sizes) != 1:
            raise ValueError(f"cannot merge maps with voxels of {sorted(sizes)} m")
        self._maps = tuple(maps)
        self._clamps = lowest, highest
        self.voxel_m = sizes.pop()
        self.threshold = threshold
        everything = np.concatenate([np.asarray(voxels.chunks, np.int32) for voxels in maps])
        # By key: neighbours come together, and are looked up by bisection.
        keys, first = np.unique(keys_of(everything), return_index=True)
        self.chunks: NDArray[np.int32] = everything[first]
        self._keys = keys

    def pieces(self, most_chunks: int = MOST_CHUNKS) -> Iterator[MapPiece]:
        """Every chunk once, ``most_chunks`` at a time."""
        for first in range(0, len(self.chunks), most_chunks):
            chunks, keys = self.chunks[first : first + most_chunks], self._keys[first : first + most_chunks]
            values = np.full((len(chunks), VOLUME), NOTHING, np.int16)
            for voxels in self._maps:
                theirs = voxels.read(chunks)
                rows = np.searchsorted(keys, keys_of(theirs.chunks))
                sums = values[rows]
                add_log_odds(sums, np.require(theirs.values, np.int16, ["C", "W"]), _LEAST, _MOST)
                values[rows] = sums
            add_log_odds(values, np.full_like(values, NOTHING), *self._clamps)
            yield MapPiece(chunks, values)
