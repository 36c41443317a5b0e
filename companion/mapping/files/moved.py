"""A map in another frame: moved, and turned about the vertical.

Each voxel of the result takes the log-odds of the voxel into which its centre falls, and where nothing is known there,
nothing is known of it. So no value is invented or averaged: a wall of one voxel stays closed, each voxel is wrong by
half a voxel at most, and where whole voxels and right angles are all that it is moved by, it comes out exactly.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled
from companion.control.sharing import Frame
from companion.mapping.files.merge import IndexedMap
from companion.mapping.voxels.chunks import (
    CHUNK_LIMIT,
    EDGE,
    MASK,
    NOTHING,
    SHIFT,
    VOLUME,
    Integer,
    chunk_key,
    chunks_of,
    keys_of,
    place_of,
    plain,
)
from companion.mapping.voxels.piece import MapPiece
from companion.model import FloatArray

_BATCH = 256
"""Chunks that are made at a time: of each up to 27 others are read, 8 kB each."""

_SNAP = 1e-6
"""Of a voxel: a centre so little below the edge between two voxels lies on it, and goes into the upper one."""

_CORNERS = np.indices((2, 2, 2)).reshape(3, -1).T
_STEPS = np.indices((3, 3, 3)).reshape(3, -1).T
"""A turned chunk is less than 1.5 chunks wide: it reaches into three, at most, along each axis."""


class MovedMap:
    """A map in the frame in which its own one lies; an `IndexedMap`.

    Args:
        source: the map in its own frame.
        lies: where that frame lies in the one of the result.

    Raises:
        ValueError: it lies nowhere, or farther away than chunks can be numbered.
    """

    def __init__(self, source: IndexedMap, lies: Frame) -> None:
        if not all(map(math.isfinite, (lies.x_m, lies.y_m, lies.z_m, lies.yaw_rad))):
            raise ValueError(f"a map cannot be moved by {lies}")
        self._source = source
        self.voxel_m = source.voxel_m
        self._by = np.array([lies.x_m, lies.y_m, lies.z_m]) / source.voxel_m
        self._cos, self._sin = math.cos(lies.yaw_rad), math.sin(lies.yaw_rad)
        reached = self._reached(np.asarray(source.chunks, np.int32), back=False)
        self.chunks: NDArray[np.int32] = np.concatenate(
            [np.empty((0, 3), np.int32), *(piece.chunks for piece in self._pieces(reached))]
        )
        """(n, 3) coordinates of all chunks with something known in them."""

    def read(self, chunks: NDArray[np.int32]) -> MapPiece:
        """Those of ``chunks`` (n, 3) in which something is known."""
        pieces = list(self._pieces(chunks))
        return MapPiece(
            np.concatenate([np.empty((0, 3), np.int32), *(piece.chunks for piece in pieces)]),
            np.concatenate([np.empty((0, VOLUME), np.int16), *(piece.values for piece in pieces)]),
        )

    def _pieces(self, chunks: NDArray[np.int32]) -> Iterator[MapPiece]:
        for first in range(0, len(chunks), _BATCH):
            wanted = plain(chunks[first : first + _BATCH], np.int32)
            theirs = self._source.read(self._reached(wanted, back=True))
            keys = keys_of(theirs.chunks)
            order = np.argsort(keys)
            values = _resampled(
                wanted,
                plain(keys[order], np.int64),
                plain(theirs.values[order], np.int16),
                self._by,
                self._cos,
                self._sin,
            )
            known = (values != NOTHING).any(axis=1)
            yield MapPiece(wanted[known], values[known])

    def _reached(self, chunks: NDArray[np.int32], *, back: bool) -> NDArray[np.int32]:
        """(n, 3) the chunks that ``chunks`` reach into when they are moved, or moved ``back``; each once."""
        corners = (chunks[:, np.newaxis].astype(np.float64) + _CORNERS) * EDGE
        sin = self._sin
        if back:
            corners, sin = corners - self._by, -sin
        x, y, z = np.moveaxis(corners, -1, 0)
        moved = np.stack([self._cos * x - sin * y, sin * x + self._cos * y, z], axis=-1)
        if not back:
            moved = moved + self._by
        low = np.floor((moved.min(axis=1, initial=np.inf) - _SNAP) / EDGE)
        high = np.floor((moved.max(axis=1, initial=-np.inf) + _SNAP) / EDGE)
        if len(chunks) and not (low.min() >= -CHUNK_LIMIT and high.max() < CHUNK_LIMIT):
            raise ValueError("a map cannot be moved so far away")
        reached = low[:, np.newaxis] + _STEPS
        return chunks_of(np.unique(keys_of(reached[(reached <= high[:, np.newaxis]).all(axis=2)].astype(np.int32))))


@compiled
def _resampled(
    chunks: NDArray[np.int32],
    keys: NDArray[np.int64],
    values: NDArray[np.int16],
    by: FloatArray,
    cos: float,
    sin: float,
) -> NDArray[np.int16]:
    """(n, 4096) what the voxels of ``chunks`` (n, 3) take from ``values`` (m, 4096).

    Args:
        chunks: of the result.
        keys: (m,) of the chunks of the source, ascending.
        values: of their voxels.
        by: (3,) where the source's origin lies, in voxels.
        cos: of the angle by which the source is turned to the left.
        sin: of the same.
    """
    made = np.full((chunks.shape[0], VOLUME), NOTHING, np.int16)
    if keys.shape[0] == 0:
        return made
    for row in range(chunks.shape[0]):
        last: Integer = -1
        at = -1
        for z in range(EDGE):
            own_z = math.floor(chunks[row, 2] * EDGE + z + 0.5 - by[2] + _SNAP)
            for y in range(EDGE):
                from_y = chunks[row, 1] * EDGE + y + 0.5 - by[1]
                for x in range(EDGE):
                    from_x = chunks[row, 0] * EDGE + x + 0.5 - by[0]
                    own_x = math.floor(cos * from_x + sin * from_y + _SNAP)
                    own_y = math.floor(cos * from_y - sin * from_x + _SNAP)
                    key = chunk_key(own_x >> SHIFT, own_y >> SHIFT, own_z >> SHIFT)
                    if key != last:
                        last, at = key, int(np.searchsorted(keys, key))
                        if at == keys.shape[0] or keys[at] != key:
                            at = -1
                    if at >= 0:
                        made[row, place_of(x, y, z)] = values[at, place_of(own_x & MASK, own_y & MASK, own_z & MASK)]
    return made
