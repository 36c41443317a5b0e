"""`companion map export`."""

from __future__ import annotations

from pathlib import Path

import typer

from companion.cli.maps.clouds import CloudOptions
from companion.cli.maps.progress import Progress
from companion.cli.maps.sources import opened, refuse_target, write_errors
from companion.cli.maps.surveyed import georeference
from companion.errors import InputError
from companion.mapping.files import FORMATS, write
from companion.mapping.files.merge import Box, ClippedMap
from companion.mapping.files.mesh import MESH_FORMATS, write_mesh
from companion.mapping.voxels.chunks import NOTHING
from companion.mapping.voxels.piece import MapSource


def export_map(
    source: Path,
    targets: list[Path],
    *,
    mesh: bool,
    box_m: Box | None,
    crs: str | None,
    clouds: CloudOptions,
    overwrite: bool,
) -> None:
    """Write a map into files; all names are checked before the first is written.

    Raises:
        InputError: the source is no map, a target cannot be, the box is none or has nothing of the map in it, or there
            is no such coordinate system.
        CompanionError: a file cannot be written; those before it are there.
    """
    for target in targets:
        _refuse_suffix(target, mesh=mesh)
        refuse_target(target, [source], overwrite=overwrite)
    if len({target.resolve() for target in targets}) < len(targets):
        raise InputError("the same target is given twice")
    clouds.refuse_if_no_use([source], targets)
    where = georeference(source, targets, crs, clouds.offset_m)
    with opened(source, clouds.reading()) as whole:
        part = whole if box_m is None else _inside(whole, box_m)
        most = _most(part)
        if box_m is not None and most == NOTHING:
            corners = " ".join(f"{bound:g}" for bound in box_m)
            raise InputError(
                f"--box {corners}: nothing of the map is in this box; `companion map info` says how far the map reaches"
            )
        if most < part.threshold:
            typer.echo("no voxel is occupied: there are no points and no surface to write", err=True)
        for target in targets:
            with write_errors(target), Progress(f"writing {target.name}") as progress:
                if _is_mesh(target, mesh=mesh):
                    write_mesh(part, target, progress)
                else:
                    write(part, target, progress, georeference=where)
            typer.echo(f"{target}: {target.stat().st_size:,} bytes")


def _inside(whole: MapSource, box_m: Box) -> ClippedMap:
    try:
        return ClippedMap(whole, box_m)
    except ValueError as error:
        raise InputError(f"--box {error}") from None


def _most(source: MapSource) -> int:
    """The largest value of a voxel; looks no further than the first piece in which one is occupied."""
    most = int(NOTHING)
    for piece in source.pieces():
        most = max(most, int(piece.values.max(initial=NOTHING)))
        if most >= source.threshold:
            break
    return most


def _is_mesh(target: Path, *, mesh: bool) -> bool:
    suffix = target.suffix.lower()
    return suffix == ".obj" or (mesh and suffix == ".ply")


def _refuse_suffix(target: Path, *, mesh: bool) -> None:
    suffix = target.suffix.lower()
    if mesh and suffix not in MESH_FORMATS:
        raise InputError(f"{target}: a mesh is written as {' or '.join(MESH_FORMATS)}")
    if suffix != ".obj" and suffix.removeprefix(".") not in FORMATS:
        known = " ".join(f".{name}" for name in FORMATS)
        raise InputError(f"{target}: the suffix {suffix!r} names no format; known are {known} .obj")
