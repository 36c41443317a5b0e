"""The surface between free and occupied as triangles: PLY and OBJ.

It is what the walls look like from the drift: open where nobody looked, and its triangles face the free side.

The map is read once, into a spool, because the surface of a chunk needs its neighbours; then chunk by chunk, first
which cells the surface passes (64 bytes for 512 cells are kept), by which every vertex has its number, then vertices
and triangles.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from companion.mapping.files.export import MapFileError
from companion.mapping.files.mesh_cells import WORDS, make_surface, mark_cells
from companion.mapping.files.whole import Spool, whole_file
from companion.mapping.voxels.chunks import NOTHING, VOLUME, keys_of, plain
from companion.mapping.voxels.piece import MapSource, Progress, silent

SHIFT = 0.5
"""How much deeper than where the log-odds pass the threshold the surface is put, in voxels.

There the occupied voxel begins; but a voxel is occupied when a wall is anywhere inside it, on average half a voxel
deeper. Without this the whole surface stands before the wall, 85 mm in a room with voxels of 0.1 m, with it 42 mm: what
is left is that a slanting wall passes through several voxels, of which the first counts.
"""

_CHUNKS = 64
"""Chunks that are done at a time."""

_CHUNK_BYTES = 2 * VOLUME

_MARKED_SHARE = 0.4
"""Of the whole work, when it is known which cells the surface passes."""

_FACE = np.dtype([("corners", "u1"), ("vertices", "<i4", 3)])
_AROUND = np.array(list(np.ndindex(3, 3, 3)), np.int32) - 1


class _Index(NamedTuple):
    """Where chunks are: keys in ascending order, and the number of each."""

    keys: NDArray[np.int64]
    numbers: NDArray[np.int64]

    def find(self, keys: NDArray[np.int64]) -> NDArray[np.int64]:
        """The numbers of these chunks, of any shape; -1 where there is none."""
        if not len(self.keys):
            return np.full(keys.shape, -1, np.int64)
        at = np.minimum(np.searchsorted(self.keys, keys), len(self.keys) - 1)
        return np.where(self.keys[at] == keys, self.numbers[at], -1)


class _Cells(NamedTuple):
    """The cells that the surface passes.

    Attributes:
        chunks: (k, 3) chunks that have some, in the order in which they are done.
        bits: (k, 64) from `mark_cells`.
        first: (k,) number of the first vertex of each.
    """

    chunks: NDArray[np.int32]
    bits: NDArray[np.uint64]
    first: NDArray[np.int64]


def write_mesh(source: MapSource, path: Path, progress: Progress = silent) -> None:
    """Write the surface as a mesh, in the format that the suffix names: ``.ply`` or ``.obj``.

    Args:
        source: the map. It is read once.
        path: the file; its folder must be there, with room for the whole map beside it (8 KiB a chunk) meanwhile.
        progress: takes the share of the work done, 0 to 1, from time to time.

    Raises:
        MapFileError: the suffix is another.
        OSError: the file cannot be written; what was there before still is.
    """
    suffix = path.suffix.lower()
    if suffix not in MESH_FORMATS:
        raise MapFileError(f"{path}: a surface is written as {' or '.join(MESH_FORMATS)}, not as {path.suffix!r}")
    with whole_file(path) as file, Spool(path.parent) as spool:
        chunks = _spooled(source, spool, progress)
        stored = _index(chunks)
        cells = _marked(chunks, stored, spool, source.threshold, progress)
        with tempfile.TemporaryFile(dir=path.parent) as vertices, tempfile.TemporaryFile(dir=path.parent) as triangles:
            for some_vertices, some_triangles in _surface(cells, stored, spool, source, progress):
                vertices.write(some_vertices.tobytes())
                triangles.write(some_triangles.tobytes())
            MESH_FORMATS[suffix](vertices, triangles, file)
    progress(1.0)


def _write_ply(vertices: BinaryIO, triangles: BinaryIO, file: BinaryIO) -> None:
    n_vertices, n_triangles = vertices.tell() // 12, triangles.tell() // 12
    header = (
        "ply\nformat binary_little_endian 1.0\ncomment surface of a map, east north up in m\n"
        f"element vertex {n_vertices}\nproperty float x\nproperty float y\nproperty float z\n"
        f"element face {n_triangles}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    file.write(header.encode("ascii"))
    vertices.seek(0)
    shutil.copyfileobj(vertices, file)
    for some in _rows(triangles, np.dtype(np.int32)):
        faces = np.empty(len(some), _FACE)
        faces["corners"] = 3
        faces["vertices"] = some
        file.write(faces.tobytes())


def _write_obj(vertices: BinaryIO, triangles: BinaryIO, file: BinaryIO) -> None:
    file.write(b"# surface of a map, east north up in m\n")
    file.writelines(_text("v %.4f %.4f %.4f\n", some) for some in _rows(vertices, np.dtype(np.float32)))
    # OBJ counts from one.
    file.writelines(_text("f %d %d %d\n", some + 1) for some in _rows(triangles, np.dtype(np.int32)))


def _text(line: str, rows: NDArray[np.float32] | NDArray[np.int32]) -> bytes:
    return (line * len(rows) % tuple(rows.ravel().tolist())).encode("ascii")


MESH_FORMATS: dict[str, Callable[[BinaryIO, BinaryIO, BinaryIO], None]] = {".ply": _write_ply, ".obj": _write_obj}
"""What writes vertices and triangles, by suffix."""


def _rows(file: BinaryIO, kind: np.dtype[np.generic]) -> Iterator[NDArray[np.float32] | NDArray[np.int32]]:
    """(n, 3) what was written into a file, from its beginning, some at a time."""
    file.seek(0)
    while data := file.read(3 * kind.itemsize * 2**16):
        yield np.frombuffer(data, kind).reshape(-1, 3)


def _index(chunks: NDArray[np.int32]) -> _Index:
    keys = keys_of(chunks)
    order = np.argsort(keys)
    return _Index(keys[order], order)


def _spooled(source: MapSource, spool: Spool, progress: Progress) -> NDArray[np.int32]:
    """(n, 3) the chunks in which something is known, whose values are in the spool."""
    chunks = [np.zeros((0, 3), np.int32)]
    for piece in source.pieces():
        known = np.any(piece.values != NOTHING, axis=1)
        values = plain(piece.values[known], np.int16)
        spool.append(values.view(np.uint8).ravel(), _CHUNK_BYTES * np.arange(1, len(values) + 1))
        chunks.append(piece.chunks[known])
        progress(0.0)
    return np.concatenate(chunks)


def _marked(chunks: NDArray[np.int32], stored: _Index, spool: Spool, threshold: int, progress: Progress) -> _Cells:
    """The cells that the surface passes."""
    # Cells that begin in a chunk of which nothing is known may end in one that is.
    everything = np.unique((chunks[:, np.newaxis] + _AROUND[(_AROUND <= 0).all(axis=1)]).reshape(-1, 3), axis=0)
    # Blocks of 4 x 4 x 4 chunks together: so neighbours are read once for many.
    everything = everything[np.argsort(keys_of(everything >> 2), kind="stable")]
    kept, bits, counts = [everything[:0]], [np.zeros((0, WORDS), np.uint64)], [np.zeros(0, np.int64)]
    for first in range(0, len(everything), _CHUNKS):
        some = everything[first : first + _CHUNKS]
        values, rows = _with_neighbours(some, stored, spool)
        some_bits = np.empty((len(some), WORDS), np.uint64)
        some_counts = mark_cells(values, rows, threshold, some_bits)
        kept.append(some[some_counts > 0])
        bits.append(some_bits[some_counts > 0])
        counts.append(some_counts[some_counts > 0])
        progress(_MARKED_SHARE * first / len(everything))
    every_count = np.concatenate(counts)
    return _Cells(np.concatenate(kept), np.concatenate(bits), np.cumsum(every_count) - every_count)


def _surface(
    cells: _Cells, stored: _Index, spool: Spool, source: MapSource, progress: Progress
) -> Iterator[tuple[NDArray[np.float32], NDArray[np.int32]]]:
    """Vertices (n, 3) in m and triangles (m, 3), some at a time."""
    index = _index(cells.chunks)
    vertices = np.empty((_CHUNKS * VOLUME, 3), np.float32)
    triangles = np.empty((6 * _CHUNKS * VOLUME, 3), np.int32)
    for first in range(0, len(cells.chunks), _CHUNKS):
        some = cells.chunks[first : first + _CHUNKS]
        values, rows = _with_neighbours(some, stored, spool)
        before = some[:, np.newaxis] + _AROUND[(_AROUND <= 0).all(axis=1)]
        owners = index.find(keys_of(before)).astype(np.int32)
        n_vertices, n_triangles = make_surface(
            *(values, rows, some, source.threshold, source.voxel_m, SHIFT),
            *(owners, cells.bits, cells.first, vertices, triangles),
        )
        yield vertices[:n_vertices], triangles[:n_triangles]
        progress(_MARKED_SHARE + (1.0 - _MARKED_SHARE) * first / len(cells.chunks))


def _with_neighbours(
    some: NDArray[np.int32], stored: _Index, spool: Spool
) -> tuple[NDArray[np.int16], NDArray[np.int32]]:
    """The values (n, 4096) of chunks and all around them, and the (m, 27) rows there, as `gather` takes them."""
    numbers = stored.find(keys_of(some[:, np.newaxis] + _AROUND))
    needed, rows = np.unique(numbers, return_inverse=True)
    values = np.full((len(needed), VOLUME), NOTHING)
    for row, number in enumerate(needed.tolist()):
        if number >= 0:
            values[row] = np.frombuffer(spool.block(number), np.int16)
    rows = rows.reshape(numbers.shape)
    return values, np.where(numbers < 0, -1, rows).astype(np.int32)
