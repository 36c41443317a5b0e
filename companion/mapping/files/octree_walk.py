"""The way through OctoMap's files: from node to node, with everything checked that a damaged file could say."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled
from companion.mapping.files.octree import BINARY_NODE_BYTES, CHUNK_LEVEL, LEVELS
from companion.mapping.voxels.chunks import VOLUME

SOUND, TOO_DEEP, NOT_FINITE, NO_CHILDREN = 0, 1, 2, 3
"""What may be wrong with a node."""

DEPTH, CODE = 0, 1
TOP, NODES_SEEN, PROBLEM = 0, 1, 2

MOST_WAITING = 8 * (LEVELS + 1)
"""Seven brothers on each level, and the node itself."""

_FREE_BITS, _OCCUPIED_BITS, _INNER_BITS = 1, 2, 3

BINARY_FREE, BINARY_OCCUPIED = np.int16(-2000), np.int16(3511)
"""What OctoMap gives to leaves of a binary file: its default clamps, 0.1192 and 0.971 as probabilities."""


class Found(NamedTuple):
    """What a walk met at the level of chunks and above.

    Attributes:
        codes: (k,) Morton codes at their depth.
        depths: (k,) uint8: 12 is a chunk; a leaf nearer to the root stands for many.
        starts: (k,) offset in the tree's bytes of a chunk's nodes; -1 for a leaf.
        values: (k,) int16 log-odds of a leaf, in thousandths.
    """

    codes: NDArray[np.int64]
    depths: NDArray[np.uint8]
    starts: NDArray[np.int64]
    values: NDArray[np.int16]


def room_for(size_bytes: int) -> Found:
    """Room for what there can be in so many bytes: eight leaves in two of them."""
    most = 4 * size_bytes + 8
    return Found(np.empty(most, np.int64), np.empty(most, np.uint8), np.empty(most, np.int64), np.empty(most, np.int16))


@compiled
def thousandths(log_odds: float) -> np.int16:
    """Log-odds in thousandths; what is free, however little, stays free."""
    value = round(max(min(1000.0 * log_odds, 32767.0), -32767.0))
    return np.int16(-1 if log_odds < 0.0 and value == 0 else value)


@compiled
def walk(
    data: NDArray[np.uint8],
    offset: int,
    value_bytes: int,
    waiting: NDArray[np.int64],
    state: NDArray[np.int64],
    found: Found,
) -> tuple[int, int]:
    """Go on through the tree as far as ``data`` reaches.

    Args:
        data: bytes of the tree from ``offset`` on.
        offset: where they are in the tree.
        value_bytes: of a node of a ``.ot`` file what stands before the bits of its children: the log-odds, and a
            colour where the tree has them; 0: of a ``.bt``.
        waiting: (MOST_WAITING, 2) nodes that are still to come, by depth and code, the next one last.
        state: (3,) how many wait, how many nodes there were, what is wrong.
        found: filled from its beginning.

    Returns:
        How many bytes are done with, and how many entries of ``found`` are filled. At a problem the walk stops before
        the node that has it.
    """
    word = np.empty(1, np.uint32)
    log_odds = word.view(np.float32)
    full = value_bytes > 0
    node_bytes = value_bytes + 1 if full else BINARY_NODE_BYTES
    at = entries = 0
    while state[TOP] > 0 and at + node_bytes <= data.shape[0]:
        depth, code = waiting[state[TOP] - 1, DEPTH], waiting[state[TOP] - 1, CODE]
        inner = leaves = 0
        if full:
            word[0] = data[at] | data[at + 1] << 8 | data[at + 2] << 16 | np.uint32(data[at + 3]) << np.uint32(24)
            inner = int(data[at + value_bytes])
            if not np.isfinite(log_odds[0]):
                state[PROBLEM] = NOT_FINITE
        else:
            word[0] = data[at] | data[at + 1] << 8
            for k in range(8):
                bits = word[0] >> np.uint32(2 * k) & np.uint32(3)
                inner |= int(bits == _INNER_BITS) << k
                leaves |= int(bits in (_FREE_BITS, _OCCUPIED_BITS)) << k
            if inner == 0 and leaves == 0:
                state[PROBLEM] = NO_CHILDREN
        if inner != 0 and depth == (LEVELS if full else LEVELS - 1):
            state[PROBLEM] = TOO_DEEP
        if state[PROBLEM] != SOUND:
            break
        state[TOP] -= 1
        state[NODES_SEEN] += 1
        if depth == CHUNK_LEVEL and (not full or inner != 0):
            found.codes[entries], found.depths[entries] = code, depth
            found.starts[entries], found.values[entries] = offset + at, 0
            entries += 1
        elif full and depth <= CHUNK_LEVEL and inner == 0:
            found.codes[entries], found.depths[entries] = code, depth
            found.starts[entries], found.values[entries] = -1, thousandths(log_odds[0])
            entries += 1
        for k in range(7, -1, -1):
            if inner >> k & 1:
                waiting[state[TOP], DEPTH], waiting[state[TOP], CODE] = depth + 1, code << 3 | k
                state[TOP] += 1
            elif leaves >> k & 1:
                state[NODES_SEEN] += 1
                if depth < CHUNK_LEVEL:
                    occupied = word[0] >> np.uint32(2 * k) & np.uint32(3) == _OCCUPIED_BITS
                    found.codes[entries], found.depths[entries] = code << 3 | k, depth + 1
                    found.starts[entries] = -1
                    found.values[entries] = BINARY_OCCUPIED if occupied else BINARY_FREE
                    entries += 1
        at += node_bytes
    return at, entries


@compiled
def decode_chunk(data: NDArray[np.uint8], at: int, value_bytes: int, values: NDArray[np.int16]) -> bool:
    """Fill ``values`` (4096,) from the nodes of one chunk, from ``at`` on; whether they are all there.

    It checks again what `walk` did: the file may have changed since.
    """
    word = np.empty(1, np.uint32)
    log_odds = word.view(np.float32)
    full = value_bytes > 0
    node_bytes = value_bytes + 1 if full else BINARY_NODE_BYTES
    places, sizes = np.empty(MOST_WAITING, np.int64), np.empty(MOST_WAITING, np.int64)
    places[0], sizes[0], top = 0, VOLUME, 1
    while top > 0:
        top -= 1
        place, size = places[top], sizes[top]
        if at + node_bytes > data.shape[0]:
            return False
        inner = 0
        if full:
            word[0] = data[at] | data[at + 1] << 8 | data[at + 2] << 16 | np.uint32(data[at + 3]) << np.uint32(24)
            inner = int(data[at + value_bytes])
            if not np.isfinite(log_odds[0]):
                return False
            if inner == 0:
                values[place : place + size] = thousandths(log_odds[0])
        else:
            word[0] = data[at] | data[at + 1] << 8
        at += node_bytes
        part = size >> 3
        for k in range(7, -1, -1):
            bits = word[0] >> np.uint32(2 * k) & np.uint32(3)
            first = place + k * part
            if inner >> k & 1 if full else bits == _INNER_BITS:
                if part < (1 if full else 8):
                    return False
                places[top], sizes[top] = first, part
                top += 1
            elif not full and bits != 0:
                values[first : first + part] = BINARY_OCCUPIED if bits == _OCCUPIED_BITS else BINARY_FREE
    return True
