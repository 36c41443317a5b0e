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

from companion.compiled import compiled
from companion.mapping.journal.rows import keys_of
from companion.mapping.voxels.chunks import EDGE, NOTHING, OFFSETS, VOLUME
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
    counts = np.zeros(4, np.int64)
    box = np.array([[_LIMIT] * 3, [-_LIMIT] * 3])
    area = SurfaceArea()
    for piece in source.pieces(_PIECE):
        # Compiled functions are compiled anew for memory that is read-only, as that of a file is.
        values = np.require(piece.values, np.int16, ["C", "W"])
        _count(np.require(piece.chunks, np.int32, ["C", "W"]), values, source.threshold, counts, box)
        area.add(piece.chunks, values, source.threshold)
        progress(int(counts[3]))
    occupied, free, undecided, chunks = (int(count) for count in counts)
    corners = [(float(x), float(y), float(z)) for x, y, z in box * source.voxel_m]
    return MapFacts(
        voxel_m=source.voxel_m,
        chunks=chunks,
        occupied=occupied,
        free=free,
        undecided=undecided,
        low_m=corners[0] if occupied or free else None,
        high_m=corners[1] if occupied or free else None,
        free_m3=free * source.voxel_m**3,
        surface_m2=area.in_faces() * source.voxel_m**2,
    )


@compiled
def _count(
    chunks: NDArray[np.int32],
    values: NDArray[np.int16],
    threshold: int,
    counts: NDArray[np.int64],
    box: NDArray[np.int64],
) -> None:
    """Count the voxels of some chunks, and widen the box around those that are occupied or free.

    Args:
        chunks: (n, 3) coordinates.
        values: (n, 4096) log-odds.
        threshold: occupied from this on.
        counts: (4,) occupied, free, undecided voxels, and chunks with something in them; are added to.
        box: (2, 3) lowest voxel and the one after the highest; is widened.
    """
    for row in range(chunks.shape[0]):
        occupied = free = seen = 0
        for place in range(VOLUME):
            value = values[row, place]
            occupied += value >= threshold
            free += (value < 0) & (value != NOTHING)
            seen += value != NOTHING
        counts[0] += occupied
        counts[1] += free
        counts[2] += seen - occupied - free
        counts[3] += seen > 0
        inside = True
        for axis in range(3):
            corner = np.int64(chunks[row, axis]) * EDGE
            inside &= corner >= box[0, axis] and corner + EDGE <= box[1, axis]
        if inside or occupied + free == 0:
            continue
        for place in range(VOLUME):
            value = values[row, place]
            if value >= threshold or (value < 0 and value != NOTHING):
                for axis in range(3):
                    at = np.int64(chunks[row, axis]) * EDGE + OFFSETS[place, axis]
                    box[0, axis] = min(box[0, axis], at)
                    box[1, axis] = max(box[1, axis], at + 1)


_BRICKS = 64
_SIDES = 6


class SurfaceArea:
    """Adds up the surface of a map that comes in pieces.

    Faces between two chunks can only be counted when both have come, so the outer layers of each chunk are kept: half
    a kilobyte for each.
    """

    def __init__(self) -> None:
        self._keys: list[NDArray[np.int64]] = []
        self._faces: list[NDArray[np.uint8]] = []
        self._occupied: list[NDArray[np.uint16]] = []
        self._free: list[NDArray[np.uint16]] = []

    def add(self, chunks: NDArray[np.int32], values: NDArray[np.int16], threshold: int) -> None:
        """Take some chunks, (n, 3), with their voxels, (n, 4096); each chunk once."""
        faces = np.zeros((len(chunks), _BRICKS, 3), np.uint8)
        occupied = np.zeros((len(chunks), _SIDES, EDGE), np.uint16)
        free = np.zeros_like(occupied)
        _count_inside(np.require(values, np.int16, ["C", "W"]), threshold, faces, occupied, free)
        self._keys.append(keys_of(chunks))
        self._faces.append(faces)
        self._occupied.append(occupied)
        self._free.append(free)

    def in_faces(self) -> float:
        """The area so far, in faces of a voxel."""
        if not self._keys:
            return 0.0
        keys = np.concatenate(self._keys)
        order = np.argsort(keys)
        faces = np.concatenate(self._faces)
        occupied, free = np.concatenate(self._occupied), np.concatenate(self._free)
        steps = keys_of(np.eye(3, dtype=np.int32)) - keys_of(np.zeros((3, 3), np.int32))
        for axis, step in enumerate(steps.tolist()):
            at = np.searchsorted(keys, keys + step, sorter=order)
            beyond = order[np.minimum(at, len(keys) - 1)]
            lower = np.flatnonzero(keys[beyond] == keys + step)
            _count_between(faces, occupied, free, lower, beyond[lower], axis)
        return _total(faces)


@compiled
def _count_inside(
    values: NDArray[np.int16],
    threshold: int,
    faces: NDArray[np.uint8],
    occupied: NDArray[np.uint16],
    free: NDArray[np.uint16],
) -> None:
    """Count the faces inside each chunk, and note which voxels of its six sides are occupied and free.

    Args:
        values: (n, 4096) log-odds in Morton order.
        threshold: occupied from this on.
        faces: (n, 64, 3) by cube of 4 voxels, that of the occupied voxel, and axis; is added to.
        occupied: (n, 6, 16) bits of the sides, lower and upper along x, y and z; are set.
        free: the same for free voxels.
    """
    state = np.empty((EDGE, EDGE, EDGE), np.int8)
    for row in range(values.shape[0]):
        some = False
        for place in range(VOLUME):
            value = values[row, place]
            said = np.int8(1) if value >= threshold else np.int8(-1 if value < 0 and value != NOTHING else 0)
            state[OFFSETS[place, 0], OFFSETS[place, 1], OFFSETS[place, 2]] = said
            if said > 0:
                some = True
        for side in range(_SIDES):
            at = (EDGE - 1) * (side & 1)
            for a in range(EDGE):
                for b in range(EDGE):
                    if side < 2:
                        said = state[at, a, b]
                    elif side < 4:
                        said = state[a, at, b]
                    else:
                        said = state[a, b, at]
                    if said > 0:
                        occupied[row, side, a] |= np.uint16(1 << b)
                    elif said < 0:
                        free[row, side, a] |= np.uint16(1 << b)
        if not some:
            continue
        for x in range(EDGE):
            for y in range(EDGE):
                for z in range(EDGE):
                    if state[x, y, z] <= 0:
                        continue
                    brick = _brick(x, y, z)
                    faces[row, brick, 0] += (x > 0 and state[x - 1, y, z] < 0) + (x < 15 and state[x + 1, y, z] < 0)
                    faces[row, brick, 1] += (y > 0 and state[x, y - 1, z] < 0) + (y < 15 and state[x, y + 1, z] < 0)
                    faces[row, brick, 2] += (z > 0 and state[x, y, z - 1] < 0) + (z < 15 and state[x, y, z + 1] < 0)


@compiled
def _brick(x: int, y: int, z: int) -> int:
    return 16 * (x >> 2) + 4 * (y >> 2) + (z >> 2)


@compiled
def _count_between(
    faces: NDArray[np.uint8],
    occupied: NDArray[np.uint16],
    free: NDArray[np.uint16],
    lower: NDArray[np.int64],
    upper: NDArray[np.int64],
    axis: int,
) -> None:
    """Count the faces between the chunks ``lower`` and the chunks ``upper``, (n,) rows, that follow along an axis."""
    for n in range(lower.shape[0]):
        for a in range(EDGE):
            below = occupied[lower[n], 2 * axis + 1, a] & free[upper[n], 2 * axis, a]
            above = free[lower[n], 2 * axis + 1, a] & occupied[upper[n], 2 * axis, a]
            for b in range(EDGE):
                if (below >> b) & 1:
                    faces[lower[n], _brick_at_side(axis, EDGE - 1, a, b), axis] += 1
                if (above >> b) & 1:
                    faces[upper[n], _brick_at_side(axis, 0, a, b), axis] += 1


@compiled
def _brick_at_side(axis: int, at: int, a: int, b: int) -> int:
    if axis == 0:
        return _brick(at, a, b)
    return _brick(a, at, b) if axis == 1 else _brick(a, b, at)


@compiled
def _total(faces: NDArray[np.uint8]) -> float:
    total = 0.0
    for row in range(faces.shape[0]):
        for brick in range(_BRICKS):
            x, y, z = faces[row, brick]
            total += np.sqrt(float(x) * x + float(y) * y + float(z) * z)
    return total
