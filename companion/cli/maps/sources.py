"""Opening the maps that a command is given, and refusing what is none before anything is done."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import typer

from companion.cli.maps.clouds import cloud_text
from companion.cli.maps.extra import ExtraMissingError, of_the_extra
from companion.cli.maps.progress import Progress
from companion.errors import CompanionError, InputError
from companion.mapping.files import CloudReading, MapFileError, PointCloudFile, open_map
from companion.mapping.journal import JOURNAL_NAME, JOURNAL_SUFFIX, Journal, JournalError
from companion.mapping.voxels.piece import MapSource


class MapCommandError(CompanionError):
    """A map could not be written."""


def map_at(path: Path) -> Path:
    """Where the map is that ``path`` means: the journal in a mission's folder, else ``path`` itself.

    Raises:
        InputError: there is nothing, or nothing that may be read.
    """
    try:
        if not path.exists():
            raise InputError(f"{path}: there is no such file or folder")
        if not os.access(path, os.R_OK | (os.X_OK if path.is_dir() else 0)):
            raise InputError(f"{path}: permission denied; read permission is needed")
        if not path.is_dir():
            return path
        if (path / JOURNAL_NAME).is_dir():
            return path / JOURNAL_NAME
        if not any(path.iterdir()):
            raise InputError(f"{path}: is an empty folder; give a {JOURNAL_NAME}, or the folder that holds one")
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}") from None
    return path


@contextmanager
def opened(path: Path, reading: CloudReading | None = None, *, tells: bool = True) -> Iterator[MapSource]:
    """A map to read from.

    Args:
        path: what the user gave.
        reading: how the points of a cloud become voxels.
        tells: say on stderr what became of a cloud's points, and in the end what of a map was damaged: some of that
            shows only when it is read.

    Raises:
        InputError: it is no map.
        CompanionError: what reads it is not installed.
    """
    place = map_at(path)
    try:
        with Progress(f"opening {place.name}") as progress, of_the_extra(f"companion map ... {place.name}"):
            source = open_map(place, progress, reading)
    except ExtraMissingError:
        raise
    except OSError as error:
        raise InputError(f"{place}: {error.strerror}") from None
    except CompanionError as error:
        # To whoever opens a map for a mission it is a failure; here it is what the user handed in.
        raise InputError(str(error)) from None
    try:
        if tells and isinstance(source, PointCloudFile):
            typer.echo(f"{place}: {cloud_text(source)}", err=True)
        yield source
        if tells and isinstance(source, Journal):
            lost = [loss.size_bytes for loss in source.losses if not loss.torn]
            if lost:
                typer.echo(f"{place}: {losses_text(len(lost), sum(lost))}", err=True)
    finally:
        if isinstance(source, Journal):
            source.close()


def refuse_target(target: Path, sources: list[Path], *, overwrite: bool) -> None:
    """Make sure that a target can be written, before an hour of work and not after it.

    Raises:
        InputError: it is one of the sources, is there already, its folder is missing or closed, or no file can have
            that name.
    """
    try:
        _refuse_target(target, sources, overwrite=overwrite)
    except OSError as error:
        raise InputError(f"{target}: {error.strerror}; give another name") from None


def _refuse_target(target: Path, sources: list[Path], *, overwrite: bool) -> None:
    for source in sources:
        place = map_at(source)
        if target.resolve() in (place.resolve(), source.resolve()) or place.resolve() in target.resolve().parents:
            raise InputError(f"{target}: is the map that is read; give another name")
    folder = target.parent
    if not folder.is_dir():
        raise InputError(f"{target}: there is no folder {folder}; make it first")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise InputError(f"{target}: permission denied; the folder {folder} may not be written")
    if target.is_dir() and target.suffix.lower() != JOURNAL_SUFFIX:
        raise InputError(f"{target}: is a folder; give the name of a file")
    if target.exists() and not overwrite:
        raise InputError(f"{target}: exists already; give another name, or --overwrite")


@contextmanager
def write_errors(target: Path) -> Iterator[None]:
    """Turn whatever keeps a map from being written into one line that names the target."""
    try:
        yield
    except MapFileError as error:
        raise InputError(f"{target}: {error}") from None
    except (OSError, JournalError) as error:
        # The journal that cannot be made is a temporary one, of which the user knows nothing.
        cause = error.__cause__ if isinstance(error, JournalError) else error
        if not isinstance(cause, OSError):
            raise
        raise MapCommandError(f"{target}: {cause.strerror or cause}; nothing was written there") from None


def chunks_seen(source: MapSource, progress: Progress) -> Callable[[int], None]:
    """Tells ``progress`` how many chunks of a map were seen; of an OctoMap file nobody knows how many there are."""
    chunks = max(len(source.chunks), 1) if isinstance(source, Journal) else None
    return lambda seen: progress(None if chunks is None else seen / chunks)


def losses_text(places: int, size_bytes: int) -> str:
    """What of a map was damaged."""
    return f"{places} place{'s' if places > 1 else ''} cannot be read: {size_text(size_bytes)} of the map are lost"


def size_text(size_bytes: int) -> str:
    """A size as people say it."""
    for unit, large in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if size_bytes >= large:
            return f"{size_bytes / large:.1f} {unit}"
    return f"{size_bytes} bytes"
