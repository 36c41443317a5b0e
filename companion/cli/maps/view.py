"""`companion map view`."""

from __future__ import annotations

import socket
from pathlib import Path

import typer

from companion.cli.maps.progress import Progress
from companion.cli.maps.sources import chunks_seen, map_at, opened, refuse_target, write_errors
from companion.errors import CompanionError, InputError
from companion.model import FloatArray
from companion.viewer.voxels import PackedVoxels, packed, trajectories

EXTRA = "mine-companion[ground]"
_OF_THE_EXTRA = ("viser", "matplotlib")


class ExtraMissingError(CompanionError):
    """What draws maps is not installed."""


def draw_picture(source: Path, picture: Path, *, overwrite: bool) -> None:
    """Draw plan and sections into a PNG.

    Raises:
        InputError: the source is no map, or the target cannot be.
        CompanionError: the extra is not installed, or the file cannot be written.
    """
    if picture.suffix.lower() != ".png":
        raise InputError(f"{picture}: a picture is a .png")
    refuse_target(picture, [source], overwrite=overwrite)
    try:
        from companion.viewer.picture import write_picture
    except ModuleNotFoundError as error:
        raise _missing(error) from None
    bits, ways = _read(source)
    with write_errors(picture), Progress(f"drawing {picture.name}") as progress:
        write_picture(bits, _name(source), list(ways.values()), picture, progress)
    typer.echo(f"{picture}: {picture.stat().st_size:,} bytes")


def show_in_browser(source: Path, host: str, port: int, most_points: int) -> None:
    """Serve the map as a page until Ctrl-C.

    Raises:
        InputError: the source is no map, or the port cannot be had.
        CompanionError: the extra is not installed.
    """
    try:
        from companion.viewer.page import serve
    except ModuleNotFoundError as error:
        raise _missing(error) from None
    bits, ways = _read(source)
    with serve(bits, _name(source), ways, host, port, most_points) as page:
        typer.echo(f"{source}: open http://{_reached_at(host)}:{page.port}; Ctrl-C ends it")
        if page.note:
            typer.echo(page.note)
        page.wait()


def _reached_at(host: str) -> str:
    """What to type into a browser for the address that is listened at: 0.0.0.0 is no place to go to."""
    return {"127.0.0.1": "localhost", "0.0.0.0": socket.gethostname()}.get(host, host)  # noqa: S104 - the user asks


def _read(source: Path) -> tuple[PackedVoxels, dict[str, FloatArray]]:
    """A map, and the ways flown that lie beside it."""
    with opened(source) as voxels, Progress("reading the map") as progress:
        bits = packed(voxels, chunks_seen(voxels, progress))
    return bits, trajectories(map_at(source).parent)


def _name(source: Path) -> str:
    place = map_at(source).resolve()
    return f"{place.parent.name}/{place.name}"


def _missing(error: ModuleNotFoundError) -> Exception:
    """The error to raise: a missing module of ours is a bug and keeps its own."""
    if (error.name or "").partition(".")[0] not in _OF_THE_EXTRA:
        return error
    return ExtraMissingError(
        f"the module {error.name} is not installed; `companion map view` needs pip install '{EXTRA}'"
    )
