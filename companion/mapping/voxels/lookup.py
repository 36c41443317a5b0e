"""Questions to the map: the state of voxels and of points, the centres of voxels, what is near."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled, compiled_unchecked
from companion.mapping.voxels.chunk_table import CHUNKS, Table, find_row, shared_value
from companion.mapping.voxels.chunks import (
    EDGE,
    MASK,
    NOTHING,
    OFFSETS,
    SHIFT,
    WORDS,
    Integer,
    chunk_key,
    place_of,
    row_of_key,
)
from companion.model import FloatArray

UNKNOWN, FREE, OCCUPIED = np.uint8(0), np.uint8(1), np.uint8(2)
"""What the map says of a voxel: nobody looked, or what was seen does not decide; seen free; an obstacle."""


def _slabs() -> NDArray[np.uint64]:
    slabs = np.zeros((3, 6), np.uint64)
    for axis in range(3):
        for n, coordinate in enumerate(OFFSETS[:64, axis]):
            for at in range(-1, 5):
                if abs(int(coordinate) - at) <= 1:
                    slabs[axis, at + 1] |= np.uint64(1) << np.uint64(n)
    return slabs


_SLABS = _slabs()
"""(3, 6) the bits of a cube of 4 whose coordinate along an axis is within one of -1, 0, .. 4."""

_WORD = np.array([int(place_of.py_func(x, 0, 0)) >> 6 for x in range(EDGE)])
"""(16,) the part of a word's number that follows from x; those from y and z are shifted by one and two more."""


@compiled
def _state(value: int, threshold: int) -> np.uint8:
    if value >= threshold:
        return OCCUPIED
    return FREE if value < 0 and value != NOTHING else UNKNOWN


@compiled
def states_of(values: NDArray[np.int16], threshold: int) -> NDArray[np.uint8]:
    """The state of each of ``values``, (n, 4096) as they are."""
    states = np.empty(values.shape, np.uint8)
    for row in range(values.shape[0]):
        for place in range(values.shape[1]):
            states[row, place] = _state(values[row, place], threshold)
    return states


@compiled_unchecked
def states_at(table: Table, points: FloatArray, voxel_m: float, threshold: int) -> NDArray[np.uint8]:
    """The state of the voxel that holds each of ``points`` (n, 3), in m."""
    states = np.full(points.shape[0], UNKNOWN, np.uint8)
    for i in range(points.shape[0]):
        x = math.floor(points[i, 0] / voxel_m)
        y = math.floor(points[i, 1] / voxel_m)
        z = math.floor(points[i, 2] / voxel_m)
        row = find_row(table, x >> SHIFT, y >> SHIFT, z >> SHIFT)
        if row >= 0:
            place = place_of(x & MASK, y & MASK, z & MASK)
            code = table.codes[row, place >> 6]
            value = shared_value(code) if code < 0 else int(table.voxels[code, place & 63])
            states[i] = _state(value, threshold)
    return states


def centres(chunks: NDArray[np.int32], states: NDArray[np.uint8], state: np.uint8, voxel_m: float) -> FloatArray:
    """(k, 3) centres in m of all voxels with one state.

    Args:
        chunks: (n, 3) chunk coordinates.
        states: (n, 4096) states of their voxels.
        state: which to list.
        voxel_m: edge of a voxel.
    """
    row, place = np.nonzero(states == state)
    return np.asarray((EDGE * chunks[row] + OFFSETS[place] + 0.5) * voxel_m)


@compiled
def occupied_bits(table: Table, threshold: int) -> NDArray[np.uint64]:
    """(rows in use, 64) one bit for each voxel of each chunk, set where it is occupied."""
    bits = np.zeros((table.used[CHUNKS], WORDS), np.uint64)
    for row in range(bits.shape[0]):
        for w in range(WORDS):
            code = table.codes[row, w]
            if code < 0:
                bits[row, w] = ~np.uint64(0) if shared_value(code) >= threshold else np.uint64(0)
                continue
            word = np.uint64(0)
            for n in range(64):
                word |= np.uint64(table.voxels[code, n] >= threshold) << np.uint64(n)
            bits[row, w] = word
    return bits


@compiled_unchecked
def near_occupied(table: Table, bits: NDArray[np.uint64], points: FloatArray, voxel_m: float) -> NDArray[np.bool_]:
    """Whether some voxel among the 27 around and at each of ``points`` (n, 3) is occupied.

    The 27 voxels lie in two cubes of 4 along each axis, which may be the same: eight words of ``bits``, each tested
    once. A test for fewer would be a branch that the processor cannot foresee, and slower.

    Args:
        table: the chunks.
        bits: (rows, 64) from `occupied_bits`.
        points: (n, 3) in m.
        voxel_m: edge of a voxel.
    """
    near = np.zeros(points.shape[0], np.bool_)
    keys, rows = table.keys, table.rows
    last: Integer = -1
    row = -1
    for i in range(points.shape[0]):
        x = math.floor(points[i, 0] / voxel_m)
        y = math.floor(points[i, 1] / voxel_m)
        z = math.floor(points[i, 2] / voxel_m)
        found = np.uint64(0)
        for a in (x - 1, x + 1):
            for b in (y - 1, y + 1):
                word_xy = _WORD[a & MASK] | _WORD[b & MASK] << 1
                mask_xy = _SLABS[0, x - (a & ~3) + 1] & _SLABS[1, y - (b & ~3) + 1]
                for c in (z - 1, z + 1):
                    key = chunk_key(a >> SHIFT, b >> SHIFT, c >> SHIFT)
                    if key != last:
                        last, row = key, row_of_key(keys, rows, key)
                    if row >= 0:
                        found |= bits[row, word_xy | _WORD[c & MASK] << 2] & mask_xy & _SLABS[2, z - (c & ~3) + 1]
        near[i] = found != np.uint64(0)
    return near
