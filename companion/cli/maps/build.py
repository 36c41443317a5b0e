"""`companion map build`."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

import typer

from companion.cli.maps.extra import of_the_extra
from companion.cli.maps.new_journal import put_in_place, refuse_no_journal
from companion.cli.maps.progress import Progress
from companion.cli.maps.readings import DatasetOptions, Readings, dataset_readings, recording_readings
from companion.cli.maps.sources import refuse_target, write_errors
from companion.config.mapping import MapSettings
from companion.errors import InputError
from companion.mapping.files import FORMATS, write
from companion.mapping.files.whole import workshop
from companion.mapping.journal import JOURNAL_SUFFIX, Header, Journal
from companion.mapping.journal.paging import PagedMap
from companion.mapping.process.journaled_map import BYTES_PER_MB
from companion.model import DepthFrame
from companion.recording import RECORDING_NAME

FLUSH_FRAMES = 50
"""What changed goes into the journal after so many images: only what is there may leave the memory."""


def build_map(
    out: Path,
    source: Path,
    options: DatasetOptions,
    config: Path | None,
    preset: str | None,
    voxel_m: float | None,
    max_range_m: float | None,
    *,
    overwrite: bool,
) -> None:
    """Make a map of depth images and poses.

    The folder of a flight means the recording in it, as it means the journal in it to the other commands.

    Raises:
        InputError: the source cannot be read or used, or a target or a setting cannot be.
        CompanionError: the target cannot be written, or a library is not installed.
    """
    suffix = out.suffix.lower()
    if suffix != JOURNAL_SUFFIX and suffix.removeprefix(".") not in FORMATS:
        known = " ".join(f".{name}" for name in FORMATS)
        raise InputError(f"{out}: a map is a folder NAME{JOURNAL_SUFFIX}, or a file that ends in one of {known}")
    refuse_target(out, [], overwrite=overwrite)
    refuse_no_journal(out)
    if not source.exists():
        raise InputError(f"{source}: there is no such file or folder")
    if source.is_dir() and options.format_ is None and (source / RECORDING_NAME).is_file():
        source /= RECORDING_NAME
    find = dataset_readings if source.is_dir() else recording_readings
    readings = find(source, options, config, preset, voxel_m, max_range_m)
    with ExitStack() as stack:
        stack.enter_context(write_errors(out))
        stack.enter_context(of_the_extra("companion map build"))
        room = stack.enter_context(workshop(out))
        chunks = _build(readings, room / "map", out)
    for note in readings.notes():
        typer.echo(f"{source}: {note}", err=True)
    typer.echo(f"{out}: {chunks:,} chunks from {readings.used_text()}")


def _build(readings: Readings, folder: Path, out: Path) -> int:
    """Put everything into a map in ``folder``, and that where it goes; how many chunks it has."""
    settings = readings.settings
    with Journal.open(folder, Header.of(settings, readings.frame)) as journal:
        voxels = PagedMap(settings, journal, settings.memory_mb * BYTES_PER_MB)
        with Progress(f"building {out.name}") as progress:
            pixels_hit = _fill(voxels, readings, progress)
        voxels.flush()
        _refuse_nothing(readings, settings, pixels_hit)
        chunks = voxels.chunks
        if out.suffix.lower() != JOURNAL_SUFFIX:
            with Progress(f"writing {out.name}") as progress:
                write(voxels, out, progress)
            return chunks
    put_in_place(folder, out)
    return chunks


def _fill(voxels: PagedMap, readings: Readings, progress: Progress) -> int:
    """Put every image and scan into the map; how many pixels and beams met a surface."""
    pixels_hit = 0
    for number, (name, reading) in enumerate(readings.each(), start=1):
        try:
            put = voxels.integrate(reading) if isinstance(reading, DepthFrame) else voxels.integrate_scan(reading)
        except ValueError as error:
            raise InputError(f"{name}: cannot be put into the map: {error}; correct its pose") from None
        pixels_hit += put.pixels_hit
        if number % FLUSH_FRAMES == 0:
            voxels.flush()
        progress(readings.share)
    return pixels_hit


def _refuse_nothing(readings: Readings, settings: MapSettings, pixels_hit: int) -> None:
    """An empty map is no result: it says that what was given means something else."""
    if pixels_hit == 0:
        raise InputError(
            f"{readings.source}: nothing is nearer than mapping.max_range_m = {settings.max_range_m:g} m in "
            f"{readings.used_text()}, so there is no map: is the unit of the images right (--depth-scale), are there "
            "depth images in the recording (record.depth)?"
        )
