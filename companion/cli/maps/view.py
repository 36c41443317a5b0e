"""`companion map view`."""

from __future__ import annotations

from pathlib import Path

import typer

from companion.cli.maps.clouds import CloudOptions
from companion.cli.maps.extra import of_the_extra
from companion.cli.maps.progress import Progress
from companion.cli.maps.sources import chunks_seen, map_at, opened, refuse_target, write_errors
from companion.errors import InputError
from companion.model import FloatArray
from companion.viewer.graphs import GraphLines, graph_lines, graphs_in
from companion.viewer.voxels import PackedVoxels, packed, trajectories


def draw_picture(source: Path, picture: Path, clouds: CloudOptions, *, overwrite: bool) -> None:
    """Draw plan and sections into a PNG.

    Raises:
        InputError: the source is no map, or the target cannot be.
        CompanionError: the extra is not installed, or the file cannot be written.
    """
    if picture.suffix.lower() != ".png":
        raise InputError(f"{picture}: a picture is a .png")
    refuse_target(picture, [source], overwrite=overwrite)
    with of_the_extra("companion map view"):
        from companion.viewer.picture import write_picture
    bits, ways, lines = _read(source, clouds)
    with write_errors(picture), Progress(f"drawing {picture.name}") as progress:
        write_picture(bits, _name(source), list(ways.values()), picture, progress, lines)
    typer.echo(f"{picture}: {picture.stat().st_size:,} bytes")


def show_in_browser(source: Path, host: str, port: int, most_points: int, clouds: CloudOptions) -> None:
    """Serve the map as a page until Ctrl-C.

    Raises:
        InputError: the source is no map, or the port cannot be had.
        CompanionError: the extra is not installed.
    """
    with of_the_extra("companion map view"):
        from companion.viewer.page import serve
        from companion.viewer.serving import reached_at
    bits, ways, lines = _read(source, clouds)
    with serve(bits, _name(source), ways, host, port, most_points, lines) as page:
        typer.echo(f"{source}: open http://{reached_at(host)}:{page.port}; Ctrl-C ends it")
        if page.note:
            typer.echo(page.note)
        page.wait()


def _read(source: Path, clouds: CloudOptions) -> tuple[PackedVoxels, dict[str, FloatArray], list[GraphLines]]:
    """A map, and the ways flown and the navigation graphs that lie beside it."""
    clouds.refuse_if_no_use([source])
    with opened(source, clouds.reading()) as voxels, Progress("reading the map") as progress:
        bits = packed(voxels, chunks_seen(voxels, progress))
    folder = map_at(source).parent
    return bits, trajectories(folder), graph_lines(graphs_in(folder).values())


def _name(source: Path) -> str:
    place = map_at(source).resolve()
    return f"{place.parent.name}/{place.name}"
