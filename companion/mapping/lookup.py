"""Questions to the map: the state of points, the centres of voxels, what is near."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from companion.mapping.chunks import EDGE, MASK, NOTHING, OFFSETS, SHIFT, VOLUME, ChunkTable, chunk_key, find_row, place_of, row_of_key
from companion.model import FloatArray

UNKNOWN, FREE, OCCUPIED = np.uint8(0), np.uint8(1), np.uint8(2)
"""What the map says of a voxel: nobody looked, or not surely; seen free; an obstacle."""


def _slabs() -> NDArray[np.uint64]:
    slabs = np.zeros((3, 6), np.uint64)
    for axis in range(3):
        for n, coordinate in enumerate(OFFSETS[:64, axis]):
            for at in range(-1, 5):
                if abs(coordinate - at) <= 1:
                    slabs[axis, at + 1] |= np.uint64(1) << np.uint64(n)
    return slabs


_SLABS = _slabs()
"""(3, 6) bits of a cube of 4 whose coordinate along an axis is within one of -1, 0, .. 4."""

_WORD = place_of.py_func(np.arange(EDGE), 0, 0) >> 6
"""(16,) the part of a word's number that follows from x; those from y and z are shifted by one and two more."""

_SPREAD = place_of.py_func(np.arange(EDGE), 0, 0)
"""The bits of a coordinate in its chunk as they lie in a place: a table is faster than `place_of` in a tight loop."""


@njit(cache=True, nogil=True)
def states_of(values: NDArray[np.int16], threshold: int) -> NDArray[np.uint8]:
    """The state of each of ``values`` (n, m), as (n, m) uint8: occupied from ``threshold`` on, free below 0."""
    states = np.zeros(values.shape, np.uint8)
    for row in range(values.shape[0]):
        for place in range(values.shape[1]):
            value = values[row, place]
            if value >= threshold:
                states[row, place] = OCCUPIED
            elif value != NOTHING and value < 0:
                states[row, place] = FREE
    return states


@njit(cache=True, nogil=True)
def states_at(table: ChunkTable, points: FloatArray, voxel_m: float, threshold: int) -> NDArray[np.uint8]:
    """The state of the voxel that holds each of ``points`` (n, 3)."""
    states = np.zeros(points.shape[0], np.uint8)
    for i in range(points.shape[0]):
        x = math.floor(points[i, 0] / voxel_m)
        y = math.floor(points[i, 1] / voxel_m)
        z = math.floor(points[i, 2] / voxel_m)
        row = find_row(table, x >> SHIFT, y >> SHIFT, z >> SHIFT)
        if row >= 0:
            value = table.values[row, place_of(x & MASK, y & MASK, z & MASK)]
            if value >= threshold:
                states[i] = OCCUPIED
            elif value != NOTHING and value < 0:
                states[i] = FREE
    return states


@njit(cache=True, nogil=True)
def occupied_bits(values: NDArray[np.int16], size: int, threshold: int) -> NDArray[np.uint64]:
    """(size, 64) one bit for each voxel of the first ``size`` rows, set where it is occupied."""
    bits = np.zeros((size, VOLUME // 64), np.uint64)
    for row in range(size):
        for w in range(VOLUME // 64):
            word = np.uint64(0)
            for n in range(64):
                word |= np.uint64(values[row, 64 * w + n] >= threshold) << np.uint64(n)
            bits[row, w] = word
    return bits


@njit(cache=True, nogil=True, error_model="numpy")
def near_occupied(table: ChunkTable, bits: NDArray[np.uint64], points: FloatArray, voxel_m: float) -> NDArray[np.bool_]:
    """Whether some voxel among the 27 around and at each of ``points`` (n, 3) is occupied.

    Args:
        table: the chunks.
        bits: (rows, 64) from `occupied_bits`.
        points: (n, 3) in m.
        voxel_m: edge of a voxel.
    """
    near = np.zeros(points.shape[0], np.bool_)
    keys, rows = table.keys, table.rows
    last, row = -1, -1
    for i in range(points.shape[0]):
        x = math.floor(points[i, 0] / voxel_m)
        y = math.floor(points[i, 1] / voxel_m)
        z = math.floor(points[i, 2] / voxel_m)
        key = chunk_key(x >> SHIFT, y >> SHIFT, z >> SHIFT)
        if key != last:
            last, row = key, row_of_key(keys, rows, key)
        a, b, c = x & MASK, y & MASK, z & MASK
        if min(a, min(b, c)) > 0 and max(a, max(b, c)) < MASK:
            near[i] = row >= 0 and _near_inside(bits, row, a, b, c)
        else:
            near[i] = _near_across(keys, rows, bits, x, y, z)
    return near


@njit(cache=True, nogil=True)
def _near_inside(bits: NDArray[np.uint64], row: int, x: int, y: int, z: int) -> bool:
    """The same for one voxel, given by its coordinates in its chunk, whose 27 lie in that chunk.

    They lie in two cubes of 4 along each axis, which may be the same: eight words, tested without a branch.
    """
    found = np.uint64(0)
    for a in (x - 1, x + 1):
        word_x, bits_x = _WORD[a], _SLABS[0, x - (a & 12) + 1]
        for b in (y - 1, y + 1):
            word_xy, bits_xy = word_x | _WORD[b] << 1, bits_x & _SLABS[1, y - (b & 12) + 1]
            for c in (z - 1, z + 1):
                found |= bits[row, word_xy | _WORD[c] << 2] & bits_xy & _SLABS[2, z - (c & 12) + 1]
    return found != np.uint64(0)


@njit(cache=True, nogil=True)
def _near_across(
    keys: NDArray[np.int64], rows: NDArray[np.int32], bits: NDArray[np.uint64], x: int, y: int, z: int
) -> bool:
    """The same for one voxel, given by its coordinates in the map, whose 27 lie in several chunks."""
    for a in range((x - 1) >> SHIFT, ((x + 1) >> SHIFT) + 1):
        for b in range((y - 1) >> SHIFT, ((y + 1) >> SHIFT) + 1):
            for c in range((z - 1) >> SHIFT, ((z + 1) >> SHIFT) + 1):
                row = row_of_key(keys, rows, chunk_key(a, b, c))
                if row >= 0 and _near_clipped(bits, row, x - a * EDGE, y - b * EDGE, z - c * EDGE):
                    return True
    return False


@njit(cache=True, nogil=True)
def _near_clipped(bits: NDArray[np.uint64], row: int, x: int, y: int, z: int) -> bool:
    """The part of the 27 that lies in one chunk; coordinates from its lowest voxel, in [-1, 16]."""
    for a in range(max(x - 1, 0) >> 2, (min(x + 1, MASK) >> 2) + 1):
        word_x, bits_x = _WORD[4 * a], _SLABS[0, x - 4 * a + 1]
        for b in range(max(y - 1, 0) >> 2, (min(y + 1, MASK) >> 2) + 1):
            word_xy, bits_xy = word_x | _WORD[4 * b] << 1, bits_x & _SLABS[1, y - 4 * b + 1]
            for c in range(max(z - 1, 0) >> 2, (min(z + 1, MASK) >> 2) + 1):
                if bits[row, word_xy | _WORD[4 * c] << 2] & bits_xy & _SLABS[2, z - 4 * c + 1]:
                    return True
    return False


def centres(coords: NDArray[np.int32], states: NDArray[np.uint8], state: np.uint8, voxel_m: float) -> FloatArray:
    """(k, 3) centres in m of the voxels with one state, chunk by chunk.

    Args:
        coords: (n, 3) chunk coordinates.
        states: (n, 4096) states of their voxels.
        state: which to list.
        voxel_m: edge of a voxel.
    """
    rows, places = np.nonzero(states == state)
    voxels = coords[rows].astype(np.int64) * EDGE + OFFSETS[places]
    return (voxels + 0.5) * voxel_m


__all__ = ["FREE", "OCCUPIED", "UNKNOWN", "centres", "near_occupied", "states_at", "states_of"]
