"""Where a map lies in surveyed coordinates: from the command line, or from the summary of the run that made it."""

from __future__ import annotations

import json
import math
from pathlib import Path

import typer

from companion.cli.maps.clouds import holds_place, place_text
from companion.cli.maps.extra import of_the_extra
from companion.cli.maps.sources import map_at
from companion.errors import InputError
from companion.mapping.files import GEOREFERENCED, Georeference
from companion.mapping.files.georeference import CoordinateSystem, Place

SUMMARY_NAME = "summary.json"


def georeference(source: Path, targets: list[Path], crs: str | None, offset_m: Place | None) -> Georeference:
    """Where the map lies of which files are to be written.

    Args:
        source: the map. A run in a mesh far from the origin says in its summary beside the map by how much the mesh was
            moved: where nothing else is said, the map goes back there.
        targets: the files.
        crs: name of the coordinate system.
        offset_m: the map's origin in it.

    Raises:
        InputError: there is no such system, or no target that could hold it.
        CompanionError: what knows the systems is not installed.
    """
    holds = any(map(holds_place, targets))
    if crs is not None and not holds:
        formats = " and ".join(f".{format_}" for format_ in GEOREFERENCED)
        raise InputError(f"--crs {crs}: only {formats} hold a coordinate system; write one of these")
    with of_the_extra("companion map export --crs"):
        system = None if crs is None else CoordinateSystem.of(crs)
    if not holds:
        return Georeference()
    place_m = offset_m
    if place_m is None and (place_m := _origin_in_summary(map_at(source).parent / SUMMARY_NAME)) is not None:
        typer.echo(f"the map's origin is at {place_text(place_m)} m (origin_m in {SUMMARY_NAME} beside it)", err=True)
    found = Georeference(place_m or (0.0, 0.0, 0.0), system)
    if system is not None and (problem := system.problem_at(found.place_m)) is not None:
        typer.echo(problem, err=True)
    return found


def _origin_in_summary(path: Path) -> Place | None:
    """``origin_m`` of a run's summary; None where that is not said, or nothing was moved."""
    try:
        said = json.loads(path.read_text(encoding="utf-8"))["origin_m"]
        x_m, y_m, z_m = map(float, said)
    except (OSError, ValueError, LookupError, TypeError):
        return None
    return (x_m, y_m, z_m) if all(map(math.isfinite, (x_m, y_m, z_m))) and any((x_m, y_m, z_m)) else None
