"""One chunk as a part of OctoMap's tree, pruned: eight equal leaves are one leaf in their parent's place.

Nodes of a chunk are numbered from its root downwards, level by level, so that the children of node n are the eight from
8 n + 1 on. Voxels in Morton order are the last level as they lie, and OctoMap's order of children is the same.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled
from companion.mapping.voxels.chunks import NOTHING, SHIFT, VOLUME

NO_NODE, LEAF, INNER = np.uint8(0), np.uint8(1), np.uint8(2)
"""What may be at a place of the tree."""

FIRST_VOXEL = (8**SHIFT - 1) // 7
"""Number of the first node of the last level."""

NODES = FIRST_VOXEL + VOLUME

FULL_NODE_BYTES, BINARY_NODE_BYTES = 5, 2
"""Of a node in ``.ot``: its log-odds and a bit for each child. Of an inner node in ``.bt``: two bits for each child."""

FREE_LEAF, OCCUPIED_LEAF = np.int16(1), np.int16(2)
"""Values of leaves in ``.bt``; as they are they are also the two bits."""

_INNER_BITS = 3


@compiled
def joined(
    values: NDArray[np.int16], kinds: NDArray[np.uint8], first: int, value: NDArray[np.int16], kind: NDArray[np.uint8]
) -> None:
    """Put into ``value[0]`` and ``kind[0]`` the parent of the eight children from number ``first`` on.

    An inner node has the largest value of its children (OctoMap's updateInnerOccupancy).
    """
    value[0], kind[0] = NOTHING, NO_NODE
    same = True
    for child in range(first, first + 8):
        same &= kinds[child] == LEAF and values[child] == values[first]
        if kinds[child] != NO_NODE:
            kind[0] = INNER
            value[0] = max(value[0], values[child])
    if same:
        kind[0] = LEAF


@compiled
def binary_word(values: NDArray[np.int16], kinds: NDArray[np.uint8], first: int) -> int:
    """Two bits for each of eight children, the first one lowest: 0 nothing, 1 free, 2 occupied, 3 has children."""
    word = 0
    for k in range(8):
        if kinds[first + k] == INNER:
            word |= _INNER_BITS << 2 * k
        elif kinds[first + k] == LEAF:
            word |= int(values[first + k]) << 2 * k
    return word


@compiled
def children_bits(kinds: NDArray[np.uint8], first: int) -> int:
    """One bit for each of eight children, the first one lowest, set where there is one."""
    bits = 0
    for k in range(8):
        bits |= int(kinds[first + k] != NO_NODE) << k
    return bits


@compiled
def encode_chunks(
    leaves: NDArray[np.int16], full: bool, data: NDArray[np.uint8], ends: NDArray[np.int64], nodes: NDArray[np.int64]
) -> tuple[NDArray[np.int16], NDArray[np.uint8]]:
    """Write the nodes of chunks as they stand in the file: a node, then all below its first child, and so on.

    Args:
        leaves: (n, 4096) values of voxels, NOTHING where there is none; in thousandths of log-odds for ``.ot``, and
            `FREE_LEAF` or `OCCUPIED_LEAF` for ``.bt``.
        full: for ``.ot``; else for ``.bt``.
        data: filled from its beginning; must have room for NODES * FULL_NODE_BYTES bytes a chunk.
        ends: (n,) filled with the end of each chunk in ``data``.
        nodes: (n,) filled with the number of nodes of each chunk, its root among them.

    Returns:
        (n,) value and (n,) kind of the roots.
    """
    n = leaves.shape[0]
    root_values, root_kinds = np.empty(n, np.int16), np.empty(n, np.uint8)
    values, kinds = np.empty(NODES, np.int16), np.empty(NODES, np.uint8)
    log_odds = np.empty(1, np.float32)
    log_odds_bytes = log_odds.view(np.uint8)
    stack = np.empty(8 * SHIFT + 1, np.int64)
    end = 0
    for row in range(n):
        for place in range(VOLUME):
            values[FIRST_VOXEL + place] = leaves[row, place]
            kinds[FIRST_VOXEL + place] = NO_NODE if leaves[row, place] == NOTHING else LEAF
        for node in range(FIRST_VOXEL - 1, -1, -1):
            joined(values, kinds, 8 * node + 1, values[node : node + 1], kinds[node : node + 1])
        root_values[row], root_kinds[row] = values[0], kinds[0]
        count, top = 0, 0
        if kinds[0] != NO_NODE:
            stack[0], top = 0, 1
        while top > 0:
            top -= 1
            node = stack[top]
            count += 1
            first = 8 * node + 1
            inner = kinds[node] == INNER
            if full:
                log_odds[0] = values[node] / 1000.0
                for k in range(4):
                    data[end + k] = log_odds_bytes[k]
                data[end + 4] = children_bits(kinds, first) if inner else 0
                end += FULL_NODE_BYTES
            elif inner:
                word = binary_word(values, kinds, first)
                data[end], data[end + 1] = word & 0xFF, word >> 8
                end += BINARY_NODE_BYTES
            if inner:
                for k in range(7, -1, -1):
                    if kinds[first + k] != NO_NODE:
                        stack[top] = first + k
                        top += 1
        ends[row], nodes[row] = end, count
    return root_values, root_kinds
