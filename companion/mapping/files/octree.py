"""OctoMap's trees: `.bt` with free and occupied only, `.ot` with the log-odds of every voxel.

Chunks are nodes at depth 12. They are written one by one to a spool as they come; then the tree above them is built,
level by level, from their roots. A node is known by its Morton code, from which the last three bits are taken for its
parent's. The file holds them depth first, so each chunk's nodes stay together.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled
from companion.mapping.files.export import Export, MapFileError, Progress, writable
from companion.mapping.files.octree_nodes import (
    FREE_LEAF,
    FULL_NODE_BYTES,
    INNER,
    LEAF,
    NO_NODE,
    NODES,
    OCCUPIED_LEAF,
    binary_word,
    children_bits,
    encode_chunks,
    joined,
)
from companion.mapping.files.whole import Spool
from companion.mapping.voxels.chunks import NOTHING, SHIFT

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
        leaves = writable(piece.values) if full else _decided(writable(piece.values), export.source.threshold)
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
        above, in_tree, own_records = _parents(level, full=full) if depth else _top(level)
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


def _top(root: _Roots) -> tuple[_Roots, NDArray[np.bool_], list[bytes]]:
    """Nothing is above the root, and it stays in the tree."""
    return root, np.ones(len(root.codes), np.bool_), []


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
