"""OctoMap's trees: `.bt` with free and occupied only, `.ot` with the log-odds of every voxel.

Chunks are nodes at depth 12. Each is written by itself, pruned (eight equal leaves are one leaf in their parent's
place), to a spool as it comes: its nodes are numbered from its root downwards, level by level, so that the children of
node n are the eight from 8 n + 1 on. Voxels in Morton order are the last level as they lie, and OctoMap's order of
children is the same.

Then the tree above the chunks is built, level by level, from their roots. A node is known there by its Morton code,
from which the last three bits are taken for its parent's. The file holds them depth first, so each chunk's nodes stay
together.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled
from companion.mapping.files.export import Export, MapFileError
from companion.mapping.files.whole import Spool
from companion.mapping.voxels.chunks import NOTHING, SHIFT, VOLUME, plain
from companion.mapping.voxels.piece import Progress

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

LEVELS = 16

CHUNK_LEVEL = LEVELS - SHIFT
"""A chunk is a node at this depth."""

CHUNK_OFFSET = 2 ** (CHUNK_LEVEL - 1)
"""OctoMap counts from the lowest corner of its cube, and the origin is in the middle of it."""

BINARY_NAME, FULL_NAME = "# Octomap OcTree binary file", "# Octomap OcTree file"
"""First lines of the files."""

THRESHOLD_NOTE = "# occupied from log-odds of"
"""OctoMap's files do not say from where on a voxel is occupied; our reader finds it in this comment."""

_CHUNKS = 256
"""Chunks that are encoded at a time: their room in memory is 6 MB."""

_ENCODED_SHARE = 0.7
"""Of the whole work, when everything is in the spool."""


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


def write_bt(export: Export, file: BinaryIO, progress: Progress) -> None:
    """Write an OctoMap ``.bt`` file: what is free and what is occupied.

    Raises:
        MapFileError: something known is further than 32768 voxels from the origin along some axis.
    """
    _write(export, file, progress, full=False)


def write_ot(export: Export, file: BinaryIO, progress: Progress) -> None:
    """Write an OctoMap ``.ot`` file: the log-odds of all that was seen.

    Raises:
        MapFileError: something known is further than 32768 voxels from the origin along some axis.
    """
    _write(export, file, progress, full=True)


def _write(export: Export, file: BinaryIO, progress: Progress, *, full: bool) -> None:
    voxel_m = float(export.source.voxel_m)
    if export.lowest_chunk.min() < -CHUNK_OFFSET or export.highest_chunk.max() >= CHUNK_OFFSET:
        raise MapFileError(
            f"the map reaches further than {2 ** (LEVELS - 1) * voxel_m:g} m from its origin, which an OctoMap with "
            f"voxels of {voxel_m:g} m cannot hold: use larger voxels (mapping.voxel_m), another format, or a part of "
            "the map (--box)"
        )
    with Spool(Path(file.name).parent) as spool:
        roots, nodes = _encoded(export, spool, progress, full=full)
        tree = _tree_above(roots, full=full)
        note = f"{THRESHOLD_NOTE} {export.source.threshold / 1000!r} on\n" if full else ""
        header = (
            f"{FULL_NAME if full else BINARY_NAME}\n"
            f"# (feel free to add / change comments, but leave the first line as it is!)\n#\n{note}"
            f"id OcTree\nsize {nodes - tree.pruned + tree.nodes}\nres {voxel_m!r}\ndata\n"
        )
        file.write(header.encode("ascii"))
        for k, (from_spool, number) in enumerate(zip(tree.is_chunk, tree.numbers, strict=True)):
            file.write(spool.block(number) if from_spool else tree.records[number])
            if k % _CHUNKS == 0:
                progress(_ENCODED_SHARE + (1.0 - _ENCODED_SHARE) * k / len(tree.numbers))
    progress(1.0)


@dataclass(frozen=True, slots=True)
class _Roots:
    """Nodes of one level, in ascending order of their Morton codes.

    Attributes:
        codes: (n,) Morton codes at their level.
        values: (n,) values, of inner nodes the largest below them.
        kinds: (n,) LEAF or INNER.
        numbers: (n,) where they are kept.
    """

    codes: NDArray[np.int64]
    values: NDArray[np.int16]
    kinds: NDArray[np.uint8]
    numbers: NDArray[np.int64]


def _encoded(export: Export, spool: Spool, progress: Progress, *, full: bool) -> tuple[_Roots, int]:
    """All chunks with something in them, whose nodes are in the spool, and how many nodes these are."""
    data = np.empty(_CHUNKS * NODES * FULL_NODE_BYTES, np.uint8)
    chunks, values, kinds, total, done = [], [], [], 0, 0
    for piece in export.source.pieces(_CHUNKS):
        if len(piece.chunks) > _CHUNKS:
            raise ValueError(f"a piece of {len(piece.chunks)} chunks, where no more than {_CHUNKS} were asked for")
        leaves = plain(piece.values, np.int16)
        if not full:
            leaves = _decided(leaves, export.source.threshold)
        ends, nodes = np.empty(len(leaves), np.int64), np.empty(len(leaves), np.int64)
        some_values, some_kinds = encode_chunks(leaves, full, data, ends, nodes)
        spool.append(data, ends)
        chunks.append(piece.chunks)
        values.append(some_values)
        kinds.append(some_kinds)
        total += int(nodes.sum())
        done += len(leaves)
        progress(_ENCODED_SHARE * min(done / max(export.chunks, 1), 1.0))
    if not chunks:
        return _Roots(np.zeros(0, np.int64), np.zeros(0, np.int16), np.zeros(0, np.uint8), np.zeros(0, np.int64)), 0
    every_kind = np.concatenate(kinds)
    codes = _morton(np.concatenate(chunks))
    numbers = np.argsort(codes)
    numbers = numbers[every_kind[numbers] != NO_NODE]
    return _Roots(codes[numbers], np.concatenate(values)[numbers], every_kind[numbers], numbers), total


@compiled
def _decided(values: NDArray[np.int16], threshold: int) -> NDArray[np.int16]:
    """The leaves of a binary tree, from log-odds: what is not decided is no leaf."""
    leaves = np.full(values.shape, NOTHING, np.int16)
    for row in range(values.shape[0]):
        for place in range(values.shape[1]):
            value = values[row, place]
            if value >= threshold:
                leaves[row, place] = OCCUPIED_LEAF
            elif value < 0 and value != NOTHING:
                leaves[row, place] = FREE_LEAF
    return leaves


def _morton(chunks: NDArray[np.int32]) -> NDArray[np.int64]:
    """(n,) Morton codes of chunk coordinates (n, 3)."""
    shifted = chunks.astype(np.int64) + CHUNK_OFFSET
    codes = np.zeros(len(chunks), np.int64)
    for bit in range(CHUNK_LEVEL):
        for axis in range(3):
            codes |= (shifted[:, axis] >> bit & 1) << (3 * bit + axis)
    return codes


@dataclass(frozen=True, slots=True)
class _Tree:
    """What is written, in its order.

    Attributes:
        is_chunk: for each block whether it is a chunk.
        numbers: for each block its number in the spool, or among ``records``.
        records: nodes above the chunks, as bytes.
        nodes: how many nodes are above the chunks.
        pruned: how many roots of chunks are in the tree no more.
    """

    is_chunk: list[bool]
    numbers: list[int]
    records: list[bytes]
    nodes: int
    pruned: int


def _tree_above(roots: _Roots, *, full: bool) -> _Tree:
    """The tree above the chunks.

    A node stands before all that is below it: it is sorted first by the code of its lowest voxel, then by its depth.
    """
    records: list[bytes] = []
    keys, numbers, is_chunk = [], [], []
    nodes = pruned = 0
    level = roots
    for depth in range(CHUNK_LEVEL, -1, -1):
        # Nothing is above the root, and it stays in the tree.
        above, in_tree, own_records = (
            _parents(level, full=full) if depth else (level, np.ones(len(level.codes), bool), [])
        )
        kept = level.kinds == INNER if depth < CHUNK_LEVEL and not full else in_tree
        if depth == CHUNK_LEVEL:
            pruned = int(np.count_nonzero(~in_tree))
        else:
            nodes += int(np.count_nonzero(in_tree))
        keys.append((level.codes[kept] << 3 * (LEVELS - depth)) * (LEVELS + 1) + depth)
        numbers.append(level.numbers[kept])
        is_chunk.append(np.full(int(np.count_nonzero(kept)), depth == CHUNK_LEVEL))
        level = _Roots(above.codes, above.values, above.kinds, above.numbers + len(records))
        records += own_records
    order = np.argsort(np.concatenate(keys))
    return _Tree(
        np.concatenate(is_chunk)[order].tolist(), np.concatenate(numbers)[order].tolist(), records, nodes, pruned
    )


def _parents(below: _Roots, *, full: bool) -> tuple[_Roots, NDArray[np.bool_], list[bytes]]:
    """The parents of nodes, which of these stay in the tree, and the parents' records."""
    codes, place = np.unique(below.codes >> 3, return_inverse=True)
    at = 8 * place + (below.codes & 7)
    values, kinds = np.full(8 * len(codes), NOTHING), np.full(8 * len(codes), NO_NODE)
    values[at], kinds[at] = below.values, below.kinds
    own_values, own_kinds = np.empty(len(codes), np.int16), np.empty(len(codes), np.uint8)
    records = []
    for n in range(len(codes)):
        joined(values, kinds, 8 * n, own_values[n : n + 1], own_kinds[n : n + 1])
        if full:
            bits = children_bits(kinds, 8 * n) if own_kinds[n] == INNER else 0
            records.append(np.float32(own_values[n] / 1000.0).tobytes() + bytes([bits]))
        else:
            records.append(binary_word(values, kinds, 8 * n).to_bytes(2, "little"))
    return _Roots(codes, own_values, own_kinds, np.arange(len(codes))), own_kinds[place] != LEAF, records
