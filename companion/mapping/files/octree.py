"""OctoMap's binary tree: free and occupied, with eight equal children drawn together into their parent.

The tree is built from its leaves upwards, one level at a time, and a node is known by its Morton code, from which the
last three bits are taken for its parent's. The file holds 16 bits for each inner node, two for each child, depth first.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from companion.errors import CompanionError
from companion.mapping.chunks import SHIFT
from companion.mapping.files.whole import whole_file
from companion.mapping.lookup import FREE, OCCUPIED, UNKNOWN
from companion.mapping.snapshot import MapSnapshot

_LEVELS = 16
_CHUNK_LEVEL = _LEVELS - SHIFT
"""A chunk is a node at this depth."""

_CHUNK_OFFSET = 2 ** (_CHUNK_LEVEL - 1)
"""OctoMap counts from the lowest corner of its cube, and the origin is in the middle of it."""

_INNER = np.uint8(3)
"""A child that has children itself. UNKNOWN, FREE and OCCUPIED are written as they are: 0, 1 and 2."""

_ALL_FREE, _ALL_OCCUPIED = np.uint16(0x5555), np.uint16(0xAAAA)


class MapFileError(CompanionError):
    """A map that a file format cannot hold."""


def write_octree(snapshot: MapSnapshot, path: Path) -> None:
    """Write an OctoMap ``.bt`` file.

    Raises:
        MapFileError: a voxel is further than 32768 voxels from the origin along some axis.
    """
    nodes, words = _tree(*_sorted_chunks(snapshot))
    header = (
        "# Octomap OcTree binary file\n# (feel free to add / change comments, but leave the first line as it is!)\n#\n"
        f"id OcTree\nsize {nodes}\nres {snapshot.voxel_m!r}\ndata\n"
    )
    with whole_file(path) as file:
        file.write(header.encode("ascii"))
        file.write(words.astype("<u2").tobytes())


def _sorted_chunks(snapshot: MapSnapshot) -> tuple[NDArray[np.int64], NDArray[np.uint8]]:
    """Morton codes of the chunks with something in them, ascending, and the states of their voxels (n, 4096)."""
    known = np.any(snapshot.states != UNKNOWN, axis=1)
    chunks = snapshot.chunks[known].astype(np.int64) + _CHUNK_OFFSET
    if np.any((chunks < 0) | (chunks >= 2 * _CHUNK_OFFSET)):
        raise MapFileError(
            f"the map reaches further than {2 ** (_LEVELS - 1) * snapshot.voxel_m:g} m from its origin, which an "
            f"OctoMap with voxels of {snapshot.voxel_m:g} m cannot hold: use larger voxels (mapping.voxel_m)"
        )
    codes = np.zeros(len(chunks), np.int64)
    for bit in range(_CHUNK_LEVEL):
        for axis in range(3):
            codes |= (chunks[:, axis] >> bit & 1) << (3 * bit + axis)
    order = np.argsort(codes)
    return codes[order], snapshot.states[known][order]


def _tree(codes: NDArray[np.int64], kinds: NDArray[np.uint8]) -> tuple[int, NDArray[np.uint16]]:
    """The number of nodes of the pruned tree, and the words of its inner nodes in depth-first order.

    Args:
        codes: (n,) Morton codes of the chunks, ascending.
        kinds: (n, 4096) states of their voxels, in Morton order.
    """
    nodes = min(len(codes), 1)  # the root; every other node is counted as a child
    keys: list[NDArray[np.int64]] = []
    words: list[NDArray[np.uint16]] = []
    for level in range(_LEVELS - 1, -1, -1):
        if level >= _CHUNK_LEVEL:
            # Inside the chunks every parent has its eight places, side by side.
            children = kinds.reshape(-1, 8)
            parents = codes[:, np.newaxis] << 3 * (level - _CHUNK_LEVEL) | np.arange(
                len(children) // max(len(codes), 1)
            )
        else:
            parents, place = np.unique(codes >> 3, return_inverse=True)
            children = np.zeros((len(parents), 8), np.uint8)
            children[place, codes & 7] = kinds
            codes = parents
        word, kinds = _joined(children)
        inner = kinds == _INNER
        nodes += int(np.count_nonzero(children[inner]))
        # A node stands before all of its descendants: first by the code of its lowest voxel, then by its depth.
        keys.append((parents.ravel()[inner] << 3 * (_LEVELS - level)) * _LEVELS + level)
        words.append(word[inner])
    return nodes, np.concatenate(words)[np.argsort(np.concatenate(keys))]


def _joined(children: NDArray[np.uint8]) -> tuple[NDArray[np.uint16], NDArray[np.uint8]]:
    """The words (n,) of parents with these ``children`` (n, 8), and what the parents are themselves."""
    word = np.zeros(len(children), np.uint16)
    for place in range(8):
        word |= children[:, place].astype(np.uint16) << np.uint16(2 * place)
    kinds = np.full(len(children), _INNER)
    kinds[word == 0] = UNKNOWN
    kinds[word == _ALL_FREE] = FREE
    kinds[word == _ALL_OCCUPIED] = OCCUPIED
    return word, kinds
