"""Points of point clouds, block by block: LAS and LAZ, PLY, PCD. What the libraries cannot read is said in one way."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from itertools import islice
from pathlib import Path
from typing import Any

import laspy
import numpy as np

from companion.mapping.files.export import MapFileError
from companion.mapping.voxels.piece import Progress
from companion.model import FloatArray

BLOCK = 1 << 20
"""Points at a time: 24 MB of coordinates."""

_MOST_HEADER_LINES = 1000


def las_points(path: Path, progress: Progress) -> Iterator[FloatArray]:
    """(n, 3) coordinates in m from a LAS or LAZ file; the file itself is never in memory as a whole.

    Raises:
        MapFileError: it is damaged or no such file, or not in m.
        OSError: it cannot be read.
    """
    with path.open("rb") as file:
        with _named(path, "LAS"):
            # Of LAZ in the newer formats only what is needed is decompressed.
            only = laspy.DecompressionSelection.xy_returns_channel().decompress_z()
            reader = laspy.open(file, closefd=False, decompression_selection=only)
            total, seen = int(reader.header.point_count), 0
            blocks = reader.chunk_iterator(BLOCK)
        _refuse_other_units(path, reader.header)
        while True:
            with _named(path, "LAS"):
                block = next(blocks, None)
            if block is None:
                break
            with _named(path, "LAS"):
                points = np.column_stack([block.x, block.y, block.z]).astype(np.float64)
            seen += len(points)
            yield points
            progress(seen / total)
    if seen != total:
        raise MapFileError(f"{path}: its header says {total:,} points, it has {seen:,}: it is cut off, get it again")


def ply_points(path: Path, progress: Progress) -> Iterator[FloatArray]:
    """(n, 3) coordinates from a PLY file, binary or ASCII; a binary one is not in memory as a whole.

    Raises:
        MapFileError: it is damaged, no PLY, or a mesh: its corners alone are not its surface.
        OSError: it cannot be read.
    """
    from plyfile import PlyData

    faces = _faces(path)
    if faces:
        raise MapFileError(
            f"{path}: is a mesh of {faces:,} faces and no point cloud: its corners alone are not its surface. Put "
            "points on it first (CloudCompare: Edit > Mesh > Sample points), closer together than a voxel"
        )
    with _named(path, "PLY"):
        vertices: Any = PlyData.read(path, mmap="r")["vertex"].data
    yield from _of_columns(path, "PLY", vertices, progress)


def pcd_points(path: Path, progress: Progress) -> Iterator[FloatArray]:
    """(n, 3) coordinates from a PCD file, ASCII, binary or compressed; all of it is in memory meanwhile.

    Raises:
        MapFileError: it is damaged or no PCD.
        OSError: it cannot be read.
    """
    from pypcd4.pypcd4 import PointCloud

    with _named(path, "PCD"):
        with path.open("rb") as file:
            is_text = any(line.split() == [b"DATA", b"ascii"] for line in islice(file, _MOST_HEADER_LINES))
        cloud = PointCloud.from_fileobj(_as_the_library_likes(path)) if is_text else PointCloud.from_path(path)
        columns = np.atleast_1d(cloud.pc_data)
    total = int(cloud.metadata.points)
    if len(columns) != total:
        raise MapFileError(
            f"{path}: its header says {total:,} points, it has {len(columns):,}: it is cut off, get it again"
        )
    yield from _of_columns(path, "PCD", columns, progress)


def _as_the_library_likes(path: Path) -> io.BufferedReader:
    """A text file with one space between words and none at the ends of lines; people's programs write more.

    Whatever size the header gives its numbers, they have the digits that stand there: double precision.
    """
    lines = [b" ".join(line.split()) for line in path.read_bytes().splitlines()]
    header = {line.partition(b" ")[0]: number for number, line in enumerate(lines[:_MOST_HEADER_LINES])}
    if {b"TYPE", b"SIZE"} <= header.keys():
        sizes, types = (lines[header[name]].split() for name in (b"SIZE", b"TYPE"))
        wide = [b"8" if kind == b"F" else size for size, kind in zip(sizes, types, strict=False)]
        lines[header[b"SIZE"]] = b" ".join([b"SIZE", *wide[1:]])
    return io.BufferedReader(io.BytesIO(b"\n".join(lines)))


def _of_columns(path: Path, kind: str, columns: Any, progress: Progress) -> Iterator[FloatArray]:
    """The fields x, y and z of a structured array in its own precision, a block of points at a time."""
    names = columns.dtype.names or ()
    if missing := [axis for axis in "xyz" if axis not in names]:
        raise MapFileError(
            f"{path}: its points have no {' and no '.join(missing)}, only {', '.join(names) or 'nothing'}: it is no "
            "cloud of points in space"
        )
    for first in range(0, len(columns), BLOCK):
        with _named(path, kind):
            block = columns[first : first + BLOCK]
            points = np.column_stack([block[axis] for axis in "xyz"])
        yield points
        progress(min(1.0, (first + BLOCK) / len(columns)))


def _faces(path: Path) -> int:
    """How many faces the header of a PLY announces: to read them all, only to refuse them then, takes minutes."""
    with path.open("rb") as file:
        for _ in range(_MOST_HEADER_LINES):
            words = file.readline(4096).split()
            if words[:2] == [b"element", b"face"] and words[2:] and words[2].isdigit():
                return int(words[2])
            if not words or words == [b"end_header"]:
                break
    return 0


def _refuse_other_units(path: Path, header: laspy.LasHeader) -> None:
    crs: Any = None
    # Descriptions of coordinates come in all kinds: what cannot be understood is taken for m, as if nothing was said.
    with suppress(Exception):
        crs = header.parse_crs()
    for axis in crs.axis_info if crs is not None else ():
        if axis.unit_name != "metre":
            raise MapFileError(
                f"{path}: its coordinates ({crs.name}) count {axis.direction} in {axis.unit_name}: a map is in m; "
                "bring it into a system in m first, such as with PDAL's filters.reprojection"
            )


@contextmanager
def _named(path: Path, kind: str) -> Iterator[None]:
    """Say of what a library cannot read which file it is."""
    try:
        yield
    except (OSError, MapFileError, ModuleNotFoundError):
        raise
    except MemoryError:
        raise MapFileError(f"{path}: there is not memory enough to read it; write it as .laz, or in parts") from None
    except Exception as error:  # noqa: BLE001 - of damaged files the libraries raise whatever comes
        what = " ".join(str(error).split())[:200] or type(error).__name__
        raise MapFileError(f"{path}: is damaged, or no {kind} file ({what}); get it again") from None
