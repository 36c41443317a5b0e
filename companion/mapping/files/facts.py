"""What a map amounts to, in numbers: found in one pass over its pieces.

The surface is the boundary between occupied and free voxels, estimated chunk by chunk. The faces between occupied and
free voxels of a slanted wall have up to 1.7 times its area. So they are counted by axis in each cube of 4 voxels: one
flat surface with the normal n and area A has A |n_x| of them along x, and so on, and its area is the length of that
vector. Edges inside a cube come out smaller than they are; noise adds some.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.mapping.voxels.chunks import EDGE, NOTHING, PLACES, keys_of
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
    area = SurfaceArea()
    occupied = free = seen = chunks = 0
    low, high = np.full(3, _LIMIT), np.full(3, -_LIMIT)
    for piece in source.pieces(_PIECE):
        values = piece.values.take(PLACES, axis=1)
        known = values != NOTHING
        is_occupied, is_free = values >= source.threshold, known & (values < 0)
        area.add(piece.chunks, is_occupied, is_free)
        occupied += int(np.count_nonzero(is_occupied))
        free += int(np.count_nonzero(is_free))
        seen += int(np.count_nonzero(known))
        chunks += int(np.count_nonzero(known.any(axis=(1, 2, 3))))
        decided = is_occupied | is_free
        for axis, across in enumerate(((2, 3), (1, 3), (1, 2))):
            row, place = np.nonzero(decided.any(axis=across))
            at = EDGE * piece.chunks[row, axis].astype(np.int64) + place
            low[axis] = at.min(initial=low[axis])
            high[axis] = (at + 1).max(initial=high[axis])
        progress(chunks)
    corners = [(float(x), float(y), float(z)) for x, y, z in np.stack([low, high]) * source.voxel_m]
    return MapFacts(
        voxel_m=source.voxel_m,
        chunks=chunks,
        occupied=occupied,
        free=free,
        undecided=seen - occupied - free,
        low_m=corners[0] if occupied or free else None,
        high_m=corners[1] if occupied or free else None,
        free_m3=free * source.voxel_m**3,
        surface_m2=area.in_faces() * source.voxel_m**2,
    )


class SurfaceArea:
    """Adds up the surface of a map that comes in pieces.

    Faces between two chunks can only be counted when both have come, so the outer layers of each chunk are kept: half
    a kilobyte for each.
    """

    def __init__(self) -> None:
        self._keys: list[NDArray[np.int64]] = []
        self._faces: list[NDArray[np.uint8]] = []
        self._sides: list[NDArray[np.uint8]] = []

    def add(self, chunks: NDArray[np.int32], occupied: NDArray[np.bool_], free: NDArray[np.bool_]) -> None:
        """Take some chunks, (n, 3), and which of their voxels are occupied and free, (n, 16, 16, 16); each chunk once.

        Faces are counted at the occupied voxel: (n, 4, 4, 4, 3) by cube of 4 voxels and axis. Of the sides it is kept
        which voxels are occupied and free: (n, 3, 2, 2, 32) by axis, lower and upper, state, and 256 bits.
        """
        faces, sides = np.empty((len(chunks), 4, 4, 4, 3), np.uint8), np.empty((len(chunks), 3, 2, 2, 32), np.uint8)
        for axis in range(3):
            its, others = (np.moveaxis(voxels, 1 + axis, 1) for voxels in (occupied, free))
            count = np.zeros(its.shape, np.uint8)
            count[:, 1:] += its[:, 1:] & others[:, :-1]
            count[:, :-1] += its[:, :-1] & others[:, 1:]
            faces[..., axis] = np.moveaxis(_by_brick(count), 1, 1 + axis)
            for state, voxels in enumerate((its, others)):
                sides[:, axis, :, state] = np.packbits(voxels[:, (0, -1)].reshape(-1, 2, EDGE * EDGE), axis=-1)
        self._keys.append(keys_of(chunks))
        self._faces.append(faces)
        self._sides.append(sides)

    def in_faces(self) -> float:
        """The area so far, in faces of a voxel."""
        if not self._keys:
            return 0.0
        keys, faces, sides = np.concatenate(self._keys), np.concatenate(self._faces), np.concatenate(self._sides)
        order = np.argsort(keys)
        steps = keys_of(np.eye(3, dtype=np.int32)) - keys_of(np.zeros((3, 3), np.int32))
        for axis, step in enumerate(steps.tolist()):
            at = np.searchsorted(keys, keys + step, sorter=order)
            beyond = order[np.minimum(at, len(keys) - 1)]
            lower = np.flatnonzero(keys[beyond] == keys + step)
            upper = beyond[lower]
            layers = np.moveaxis(faces[..., axis], 1 + axis, 1)
            for its, ours, theirs, layer in ((lower, 0, 1, -1), (upper, 1, 0, 0)):
                both = np.unpackbits(sides[lower, axis, 1, ours] & sides[upper, axis, 0, theirs], axis=-1)
                layers[its, layer] += _by_brick(both.reshape(-1, EDGE, EDGE))
        return float(np.sqrt(np.square(faces, dtype=np.float32).sum(axis=-1)).sum(dtype=np.float64))


def _by_brick(counts: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """(n, 4, ..) the sums over four by four of what is counted by voxel, (n, 16, ..)."""
    for axis in range(1, counts.ndim):
        along = np.moveaxis(counts, axis, 0)
        counts = np.moveaxis(along[::4] + along[1::4] + along[2::4] + along[3::4], 0, axis)
    return counts
