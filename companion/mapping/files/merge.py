"""Maps made of other maps: a part of one, and several of the same place as one.

Nothing is in memory as a whole: pieces are cut, and chunks joined by their coordinates, a few hundred at a time.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from companion.mapping.voxels.chunks import EDGE, NOTHING, OFFSETS, VOLUME, keys_of, plain
from companion.mapping.voxels.piece import MOST_CHUNKS, MapPiece, MapSource, add_log_odds

Box = tuple[float, float, float, float, float, float]


class ClippedMap:
    """What a map says of the voxels whose centres are in a box; a `MapSource`. Of the others nothing is known.

    Args:
        source: the whole map.
        box_m: lowest x, y and z, then highest, in m.

    Raises:
        ValueError: a bound is not finite, or the box is empty.
    """

    def __init__(self, source: MapSource, box_m: Box) -> None:
        low_m, high_m = np.array(box_m[:3]), np.array(box_m[3:])
        if not (np.isfinite(box_m).all() and (low_m < high_m).all()):
            raise ValueError(f"{' '.join(f'{bound:g}' for bound in box_m)} is no box: give the lowest corner first")
        self._source = source
        self.voxel_m = source.voxel_m
        self.threshold = source.threshold
        # The first voxel whose centre is in the box, and the first beyond.
        self._low = np.ceil(low_m / source.voxel_m - 0.5)
        self._high = np.ceil(high_m / source.voxel_m - 0.5)

    def pieces(self, most_chunks: int = MOST_CHUNKS) -> Iterator[MapPiece]:
        """Every chunk that reaches into the box, once, at most ``most_chunks`` at a time."""
        for piece in self._source.pieces(most_chunks):
            corners = piece.chunks.astype(np.int64) * EDGE
            reaches = ((corners < self._high) & (corners + EDGE > self._low)).all(axis=1)
            if not reaches.any():
                continue
            places = corners[reaches, np.newaxis] + OFFSETS
            inside = ((places >= self._low) & (places < self._high)).all(axis=2)
            yield MapPiece(piece.chunks[reaches], np.where(inside, piece.values[reaches], NOTHING))


LEAST, MOST = -32767, 32767
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
                add_log_odds(sums, plain(theirs.values, np.int16), LEAST, MOST)
                values[rows] = sums
            add_log_odds(values, np.full_like(values, NOTHING), *self._clamps)
            yield MapPiece(chunks, values)
