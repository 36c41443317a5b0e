"""Maps in OctoMap's files, read piece by piece."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from companion.mapping.files.export import MapFileError
from companion.mapping.files.octree import BINARY_NAME, CHUNK_LEVEL, CHUNK_OFFSET, FULL_NAME, THRESHOLD_NOTE
from companion.mapping.files.octree_walk import (
    MOST_WAITING,
    NO_CHILDREN,
    NODES_SEEN,
    NOT_FINITE,
    PROBLEM,
    SOUND,
    TOO_DEEP,
    TOP,
    Found,
    decode_chunk,
    room_for,
    walk,
)
from companion.mapping.voxels.chunks import NOTHING, VOLUME
from companion.mapping.voxels.piece import MOST_CHUNKS, MapPiece, Progress, silent

_MOST_HEADER_BYTES = 65536
_MOST_LINE_BYTES = 4096
_LEAST_VOXEL_M, _MOST_VOXEL_M = 1e-4, 1e4
_READ_BYTES = 2**20

_MOST_MAP_CHUNKS = 2**20
"""Of a whole map: ten times a tunnel of 10 km. A few bytes can claim all of OctoMap's cube, 7e10 chunks."""

_VALUE_BYTES = {"OcTree": 4, "ColorOcTree": 7}
"""Of a node in ``.ot``, by the kind of tree: log-odds, and a colour, which is passed over. ``.bt`` has neither."""

_PROBLEMS = {
    TOO_DEEP: f"a node below the voxels, deeper than {CHUNK_LEVEL + 4} levels",
    NOT_FINITE: "log-odds that are not a finite number",
    NO_CHILDREN: "an inner node without children",
}


class _Header(NamedTuple):
    """What stands before the tree.

    Attributes:
        value_bytes: of a node of a ``.ot`` file what stands before the bits of its children; 0: a ``.bt``.
        voxel_m: edge of a voxel.
        threshold: a voxel is occupied from this on, in thousandths of log-odds.
        nodes: how many nodes the tree has.
        end: offset in the file of the tree.
    """

    value_bytes: int
    voxel_m: float
    threshold: int
    nodes: int
    end: int


class OctreeFile:
    """The map in an OctoMap file (a `MapSource`).

    Only where chunks are is kept in memory.

    Args:
        path: the file.
        header: its header.
        identity: what tells it from a file that took its place.
        found: its chunks, and the leaves that stand for several.
    """

    def __init__(self, path: Path, header: _Header, identity: tuple[int, ...], found: Found) -> None:
        self._path, self._header, self._identity = path, header, identity
        stored = found.starts >= 0
        self._chunks = _coordinates(found.codes[stored])
        self._starts = found.starts[stored] + header.end
        self._leaves = Found._make(part[~stored] for part in found)

    @property
    def voxel_m(self) -> float:
        """Edge of a voxel."""
        return self._header.voxel_m

    @property
    def threshold(self) -> int:
        """A voxel is occupied from this value on, in thousandths of log-odds."""
        return self._header.threshold

    def pieces(self, most_chunks: int = MOST_CHUNKS) -> Iterator[MapPiece]:
        """Every chunk once, ``most_chunks`` at a time.

        Raises:
            MapFileError: the file is not the one that was opened.
            OSError: it cannot be read.
        """
        with self._path.open("rb") as file:
            status = os.fstat(file.fileno())
            if _identity(status) != self._identity:
                raise MapFileError(f"{self._path}: the file was written anew since it was opened; open it again")
            ends = np.append(self._starts[1:], status.st_size)
            for first in range(0, len(self._starts), most_chunks):
                last = min(first + most_chunks, len(self._starts))
                file.seek(int(self._starts[first]))
                data = np.frombuffer(file.read(int(ends[last - 1] - self._starts[first])), np.uint8).copy()
                values = np.full((last - first, VOLUME), NOTHING)
                for row, start in enumerate(self._starts[first:last]):
                    if not decode_chunk(data, int(start - self._starts[first]), self._header.value_bytes, values[row]):
                        raise MapFileError(f"{self._path}: byte {start}: the file changed while it was being read")
                yield MapPiece(self._chunks[first:last], values)
        for depth in np.unique(self._leaves.depths):
            at_depth = self._leaves.depths == depth
            yield from _expanded(
                self._leaves.codes[at_depth], self._leaves.values[at_depth], 3 * (CHUNK_LEVEL - int(depth)), most_chunks
            )


def open_octree(path: Path, progress: Progress = silent) -> OctreeFile:
    """The map in an OctoMap file, after a walk through all of it.

    Args:
        path: the file.
        progress: takes the share of the file that was walked through, 0 to 1, from time to time.

    Raises:
        MapFileError: the file is not an OctoMap, or damaged, or holds more than any real map.
        OSError: it cannot be read.
    """
    with path.open("rb") as file:
        header = _read_header(file, path)
        found = _walked(file, path, header, progress)
        return OctreeFile(path, header, _identity(os.fstat(file.fileno())), found)


def _identity(status: os.stat_result) -> tuple[int, ...]:
    return status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns


def _read_header(file: BinaryIO, path: Path) -> _Header:
    first = _line(file, path)
    if first not in (BINARY_NAME, FULL_NAME):
        raise MapFileError(f"{path}: not an OctoMap file: it begins neither with {BINARY_NAME!r} nor {FULL_NAME!r}")
    said: dict[str, str] = {}
    threshold = 0
    while (line := _line(file, path)) != "data":
        if line.startswith(THRESHOLD_NOTE):
            threshold = round(1000.0 * _number(path, "the threshold", line.removeprefix(THRESHOLD_NOTE).split()[:1]))
        elif line and not line.startswith("#"):
            key, _, value = line.partition(" ")
            said[key] = value.strip()
    kind = said.get("id", "")
    if kind not in _VALUE_BYTES:
        raise MapFileError(
            f"{path}: holds a tree of the kind {kind!r}; {' and '.join(map(repr, _VALUE_BYTES))} can be read: write it "
            "as one of these, with what made it"
        )
    voxel_m = _number(path, "res", said.get("res", "").split())
    if not _LEAST_VOXEL_M <= voxel_m <= _MOST_VOXEL_M:
        raise MapFileError(f"{path}: res = {voxel_m:g} m must be from {_LEAST_VOXEL_M:g} to {_MOST_VOXEL_M:g}")
    if not 0 <= threshold < -int(NOTHING):
        raise MapFileError(f"{path}: a threshold of {threshold / 1000:g} must be from 0 to 32.767")
    nodes = _number(path, "size", said.get("size", "").split())
    return _Header(_VALUE_BYTES[kind] if first == FULL_NAME else 0, voxel_m, threshold, int(nodes), file.tell())


def _line(file: BinaryIO, path: Path) -> str:
    line = file.readline(_MOST_LINE_BYTES)
    if not line.endswith(b"\n") or file.tell() > _MOST_HEADER_BYTES:
        raise MapFileError(f"{path}: byte {file.tell()}: the header has no end: not an OctoMap file, or cut off")
    # Comments may be in any encoding; what matters is ASCII.
    return line.decode("latin-1").rstrip()


def _number(path: Path, name: str, words: list[str]) -> float:
    try:
        number = float(words[0])
    except (ValueError, IndexError):
        number = math.nan
    if not math.isfinite(number):
        raise MapFileError(f"{path}: {name} in the header is {' '.join(words) or 'missing'}, not a finite number")
    return number


def _walked(file: BinaryIO, path: Path, header: _Header, progress: Progress) -> Found:
    """All chunks of the tree, and the leaves that stand for several."""
    waiting = np.zeros((MOST_WAITING, 2), np.int64)
    state = np.zeros(3, np.int64)
    state[TOP] = min(header.nodes, 1)
    room = room_for(_READ_BYTES + 8)
    found, left, offset, chunks = [], b"", 0, 0
    size = os.fstat(file.fileno()).st_size
    while block := file.read(_READ_BYTES):
        progress(min(file.tell() / size, 1.0))
        left += block
        done, entries = walk(np.frombuffer(left, np.uint8).copy(), offset, header.value_bytes, waiting, state, room)
        found.append(Found._make(part[:entries].copy() for part in room))
        offset, left = offset + done, left[done:]
        if state[PROBLEM] != SOUND:
            raise MapFileError(
                f"{path}: byte {header.end + offset}: {_PROBLEMS[int(state[PROBLEM])]}: the file is damaged, get it "
                "again"
            )
        chunks += int((8.0 ** (CHUNK_LEVEL - found[-1].depths.astype(np.float64))).sum())
        if chunks > _MOST_MAP_CHUNKS:
            raise MapFileError(
                f"{path}: byte {header.end + offset}: more than {_MOST_MAP_CHUNKS} chunks of 16 x 16 x 16 voxels: "
                "the file is damaged, or its map too large to be read"
            )
        if state[TOP] == 0:
            break
    if state[TOP] > 0:
        raise MapFileError(
            f"{path}: byte {header.end + offset + len(left)}: the file ends in the middle of the tree: it is cut off, "
            "get it again"
        )
    if left or file.read(1):
        raise MapFileError(f"{path}: byte {header.end + offset}: there is more after the end of the tree")
    if state[NODES_SEEN] != header.nodes:
        raise MapFileError(
            f"{path}: the header says {header.nodes} nodes, the tree has {state[NODES_SEEN]}: the file is damaged, get "
            "it again"
        )
    found.append(Found._make(part[:0] for part in room))
    return Found._make(np.concatenate(parts) for parts in zip(*found, strict=True))


def _coordinates(codes: NDArray[np.int64]) -> NDArray[np.int32]:
    """(n, 3) chunk coordinates of Morton codes at the level of chunks."""
    chunks = np.zeros((len(codes), 3), np.int32)
    for bit in range(CHUNK_LEVEL):
        for axis in range(3):
            chunks[:, axis] |= ((codes >> (3 * bit + axis) & 1) << bit).astype(np.int32)
    return chunks - np.int32(CHUNK_OFFSET)


def _expanded(codes: NDArray[np.int64], values: NDArray[np.int16], bits: int, most_chunks: int) -> Iterator[MapPiece]:
    """The chunks of leaves at one depth, each of which stands for 2**bits of them."""
    total = len(codes) << bits
    for first in range(0, total, most_chunks):
        numbers = np.arange(first, min(first + most_chunks, total))
        leaf = numbers >> bits
        inside = codes[leaf] << bits | numbers & (1 << bits) - 1
        yield MapPiece(_coordinates(inside), np.repeat(values[leaf, np.newaxis], VOLUME, axis=1))
