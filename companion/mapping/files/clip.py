"""A part of a map: what is inside a box."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from companion.mapping.voxels.chunks import EDGE, NOTHING, OFFSETS
from companion.mapping.voxels.piece import MOST_CHUNKS, MapPiece, MapSource

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
