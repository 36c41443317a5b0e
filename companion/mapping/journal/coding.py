"""Chunks as bytes: brick by brick, each with the values that occur in it and a few bits for each voxel.

A chunk is 64 bricks of 64 voxels in Morton order. A brick begins with one byte:

- 0: all its voxels have the value of the last brick that was alike throughout (unknown, if there was none);
- 1: all have the value that follows, in two bytes, lowest first;
- k = 2 .. `_MOST_VALUES`: k values follow, two bytes each, then for each voxel the number of its value, in as many bits
  as k numbers need, lowest bits first;
- 255: 64 values follow.

So a brick takes 1 or 3 bytes where nothing changes, which is most of a map, and 129 at the worst.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled
from companion.mapping.voxels.chunks import NOTHING, VOLUME

_BRICK = 64
_BRICKS = VOLUME // _BRICK
_MOST_VALUES = 39
"""With more values than these and six bits for each voxel a brick would take more than 128 bytes."""

_AS_LAST, _ALIKE, _PLAIN = 0, 1, 255

MOST_BYTES = _BRICKS * (1 + 2 * _BRICK)
"""No chunk takes more."""


@compiled
def encode(values: NDArray[np.int16], out: NDArray[np.uint8], gap: int) -> NDArray[np.int64]:
    """Write chunks as bytes, one behind the other.

    Args:
        values: (n, 4096) in Morton order.
        out: at least n (gap + `MOST_BYTES`) bytes.
        gap: bytes left free before each chunk.

    Returns:
        (n,) bytes of each chunk, without the gaps.
    """
    sizes = np.empty(values.shape[0], np.int64)
    at = 0
    for row in range(values.shape[0]):
        at += gap
        end = _encode_chunk(values[row], out, at)
        sizes[row] = end - at
        at = end
    return sizes


@compiled
def _encode_chunk(chunk: NDArray[np.int16], out: NDArray[np.uint8], at: int) -> int:
    last = NOTHING
    for brick in range(_BRICKS):
        voxels = chunk[_BRICK * brick : _BRICK * brick + _BRICK]
        first = voxels[0]
        if np.all(voxels == first):
            out[at] = _AS_LAST if first == last else _ALIKE
            at += 1
            if first != last:
                at = _put(out, at, first)
            last = first
        else:
            at = _encode_brick(voxels, out, at)
    return at


@compiled
def _encode_brick(voxels: NDArray[np.int16], out: NDArray[np.uint8], at: int) -> int:
    found = np.empty(_MOST_VALUES, np.int16)
    numbers = np.empty(_BRICK, np.uint8)
    count, number, before = 0, 0, voxels[0]
    for n in range(_BRICK):
        value = voxels[n]
        if value != before or n == 0:
            number = 0
            while number < count and found[number] != value:
                number += 1
            if number == _MOST_VALUES:
                return _encode_plain(voxels, out, at)
            if number == count:
                found[count] = value
                count += 1
            before = value
        numbers[n] = number
    out[at] = count
    at += 1
    for k in range(count):
        at = _put(out, at, found[k])
    width = _bits_for(count)
    bits, held = 0, 0
    for n in range(_BRICK):
        bits |= int(numbers[n]) << held
        held += width
        while held >= 8:
            out[at] = bits & 255
            at += 1
            bits >>= 8
            held -= 8
    return at


@compiled
def _encode_plain(voxels: NDArray[np.int16], out: NDArray[np.uint8], at: int) -> int:
    out[at] = _PLAIN
    at += 1
    for n in range(_BRICK):
        at = _put(out, at, voxels[n])
    return at


@compiled
def _put(out: NDArray[np.uint8], at: int, value: np.int16) -> int:
    out[at] = value & 255
    out[at + 1] = (value >> 8) & 255
    return at + 2


@compiled
def _bits_for(count: int) -> int:
    """Bits that hold the numbers 0 .. count - 1; 64 voxels of them are whole bytes, whatever it is."""
    width = 1
    while (1 << width) < count:
        width += 1
    return width


@compiled
def decode(data: NDArray[np.uint8], starts: NDArray[np.int64], values: NDArray[np.int16]) -> NDArray[np.bool_]:
    """Fill in chunks from bytes. Whatever the bytes are, nothing else is read or written.

    Args:
        data: what `encode` wrote.
        starts: (n + 1,) where each chunk begins, and the end of the last.
        values: (n, 4096) to be filled in; those of a chunk that is not valid have no meaning.

    Returns:
        (n,) whether the bytes of each chunk were valid.
    """
    valid = np.empty(values.shape[0], np.bool_)
    for row in range(values.shape[0]):
        valid[row] = _decode_chunk(data[starts[row] : starts[row + 1]], values[row])
    return valid


@compiled
def _decode_chunk(data: NDArray[np.uint8], chunk: NDArray[np.int16]) -> bool:
    last = NOTHING
    at = 0
    for brick in range(_BRICKS):
        voxels = chunk[_BRICK * brick : _BRICK * brick + _BRICK]
        if at >= data.shape[0]:
            return False
        count = int(data[at])
        at += 1
        if count == _AS_LAST:
            voxels[:] = last
            continue
        if count > _MOST_VALUES and count != _PLAIN:
            return False
        width = _bits_for(count)
        wanted = 2 if count == _ALIKE else 2 * _BRICK if count == _PLAIN else 2 * count + 8 * width
        if at + wanted > data.shape[0]:
            return False
        if count == _ALIKE:
            last = _get(data, at)
            voxels[:] = last
        elif count == _PLAIN:
            for n in range(_BRICK):
                voxels[n] = _get(data, at + 2 * n)
        elif not _decode_brick(data[at : at + wanted], count, width, voxels):
            return False
        at += wanted
    return bool(at == data.shape[0])


@compiled
def _decode_brick(data: NDArray[np.uint8], count: int, width: int, voxels: NDArray[np.int16]) -> bool:
    bits, held, at = 0, 0, 2 * count
    for n in range(_BRICK):
        while held < width:
            bits |= int(data[at]) << held
            at += 1
            held += 8
        number = bits & ((1 << width) - 1)
        bits >>= width
        held -= width
        if number >= count:
            return False
        voxels[n] = _get(data, 2 * number)
    return True


@compiled
def _get(data: NDArray[np.uint8], at: int) -> np.int16:
    return np.int16(np.uint16(data[at]) | np.uint16(data[at + 1]) << np.uint16(8))
