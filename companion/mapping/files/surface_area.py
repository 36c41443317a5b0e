"""How much surface a map shows: the boundary between occupied and free voxels, estimated chunk by chunk.

The faces between occupied and free voxels of a slanted wall have up to 1.7 times its area. So they are counted by axis
in each cube of 4 voxels: one flat surface with the normal n and area A has A |n_x| of them along x, and so on, and its
area is the length of that vector. Edges inside a cube come out smaller than they are; noise adds some.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled
from companion.mapping.journal.rows import keys_of
from companion.mapping.voxels.chunks import EDGE, NOTHING, OFFSETS, VOLUME

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
