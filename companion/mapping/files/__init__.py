"""The map as files that other programs open, and the maps that are in files.

Each file is written beside its place and moved there when it is whole, so a program that is killed leaves the old file
or the new one, never half of one. A map with nothing in it gives valid files with nothing in them. Maps are read piece
by piece, so one that does not fit into memory can be written.
"""

from __future__ import annotations

from collections.abc import Callable
from datetime import date
from pathlib import Path
from typing import BinaryIO

from companion.mapping.files.clouds import write_las, write_laz, write_pcd, write_ply
from companion.mapping.files.export import Export, MapFileError
from companion.mapping.files.georeference import Georeference
from companion.mapping.files.mesh import write_mesh
from companion.mapping.files.octree import write_bt, write_ot
from companion.mapping.files.octree_read import open_octree
from companion.mapping.files.point_cloud import READERS, CloudReading, PointCloudFile, is_point_cloud, open_point_cloud
from companion.mapping.files.whole import whole_file
from companion.mapping.journal import Journal
from companion.mapping.voxels.piece import MapSource, Progress, silent

FORMATS: dict[str, Callable[[Export, BinaryIO, Progress], None]] = {
    "ply": write_ply,
    "pcd": write_pcd,
    "las": write_las,
    "laz": write_laz,
    "bt": write_bt,
    "ot": write_ot,
}
"""What writes each format. The first four hold the occupied voxels, the others also what is free."""

OF_A_MISSION = ("ply", "pcd", "laz", "bt")
"""What is brought home. The last may fail where the others do not: a map can be too large for it."""

GEOREFERENCED = ("las", "laz")
"""Formats with coordinates of the size that surveyors use, and a place for what they are."""

_OCTREES = (".bt", ".ot")


def open_map(path: Path, progress: Progress = silent, reading: CloudReading | None = None) -> MapSource:
    """The map in an OctoMap file (``.bt``, ``.ot``), in a point cloud, or in the folder of a journal.

    A ``.bt`` file says only what is free and what is occupied: its voxels get OctoMap's least and greatest log-odds. A
    point cloud says only what is occupied, and its voxels get the greatest.

    Args:
        path: the file or the folder.
        progress: takes the share of it that was read, 0 to 1, from time to time.
        reading: how the points of a cloud become voxels; None: voxels of the default size, at the file's coordinates.

    Raises:
        MapFileError: there is no such map, or the file is damaged: it is read once, from end to end, to know.
        CompanionError: the folder holds no journal that can be read.
        ModuleNotFoundError: the library that reads the cloud's format is not installed.
        OSError: the file cannot be read.
    """
    if path.is_dir():
        return Journal.read_only(path, progress=progress)
    if path.suffix.lower() not in _OCTREES and not is_point_cloud(path):
        *most, last = (*_OCTREES, *READERS)
        raise MapFileError(
            f"{path}: not a map that can be read; give the folder of a journal (map.journal) or a file that ends in "
            f"{', '.join(most)} or {last}"
        )
    if not path.exists():
        raise MapFileError(f"{path}: there is no such file")
    if is_point_cloud(path):
        return open_point_cloud(path, reading or CloudReading(), progress)
    return open_octree(path, progress)


def write(
    source: MapSource,
    path: Path,
    progress: Progress = silent,
    created: date | None = None,
    georeference: Georeference | None = None,
) -> None:
    """Write a map in the format that the suffix of ``path`` names.

    Args:
        source: the map. It must not change meanwhile.
        path: the file; its folder must be there.
        progress: takes the share of the work done, 0 to 1, from time to time.
        created: the day that the file is to bear, where the format has a place for one.
        georeference: where the map lies, where the format can hold it (`GEOREFERENCED`); None: at its own origin.

    Raises:
        MapFileError: the suffix is none of `FORMATS`, or the format cannot hold the map.
        OSError: the file cannot be written; what was there before still is.
    """
    format_ = path.suffix.lower().removeprefix(".")
    if format_ not in FORMATS:
        known = ", ".join(f".{name}" for name in FORMATS)
        raise MapFileError(f"{path}: the suffix {path.suffix!r} names no format of a map; give one of {known}")
    _write(Export.of(source, created, progress, georeference), format_, path, progress)


def write_map(source: MapSource, folder: Path, created: date | None = None) -> dict[str, Path]:
    """Write what a mission brings home: map.ply, map.pcd, map.laz and map.bt; by format, where they are.

    Args:
        source: the map.
        folder: is made when it does not exist.
        created: the day that the files are to bear.

    Raises:
        MapFileError: a voxel is too far away for the OctoMap format; the other files are there.
        OSError: a file cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    export = Export.of(source, created)
    paths = {format_: folder / f"map.{format_}" for format_ in OF_A_MISSION}
    for format_, path in paths.items():
        _write(export, format_, path, silent)
    return paths


def _write(export: Export, format_: str, path: Path, progress: Progress) -> None:
    with whole_file(path) as file:
        FORMATS[format_](export, file, progress)


__all__ = [
    "FORMATS",
    "GEOREFERENCED",
    "OF_A_MISSION",
    "CloudReading",
    "Georeference",
    "MapFileError",
    "PointCloudFile",
    "Progress",
    "is_point_cloud",
    "open_map",
    "write",
    "write_map",
    "write_mesh",
]
