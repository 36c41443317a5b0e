"""`companion map merge`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path

import typer

from companion.cli.maps.clouds import CloudOptions
from companion.cli.maps.fleet_frame import FLEET_FRAME, fleet_frame
from companion.cli.maps.new_journal import put_in_place, refuse_no_journal
from companion.cli.maps.progress import Progress
from companion.cli.maps.sources import map_at, opened, refuse_target, write_errors
from companion.cli.maps.surveyed import SUMMARY_NAME
from companion.config.mapping import MapSettings
from companion.control.sharing import Frame
from companion.errors import InputError
from companion.mapping.files import PointCloudFile, is_point_cloud, write
from companion.mapping.files.merge import IndexedMap, MergedMap
from companion.mapping.files.moved import MovedMap
from companion.mapping.files.whole import workshop
from companion.mapping.journal import JOURNAL_SUFFIX, Header, Journal
from companion.mapping.voxels.piece import MapSource

TREE_SUFFIX = ".ot"


def merge_maps(sources: list[Path], out: Path, clouds: CloudOptions, *, overwrite: bool) -> None:
    """Add maps into a new journal or .ot file; those of the vehicles of a fleet in the frame that it shares.

    Raises:
        InputError: fewer than two maps, one that is none or given twice, maps that do not go together, or a target that
            cannot be.
        CompanionError: the target cannot be written.
    """
    if len(sources) < 2:
        raise InputError("give at least two maps to merge")
    if out.suffix.lower() not in (JOURNAL_SUFFIX, TREE_SUFFIX):
        raise InputError(f"{out}: a merged map is a folder NAME{JOURNAL_SUFFIX} or a file NAME{TREE_SUFFIX}")
    places = [map_at(source).resolve() for source in sources]
    if len(set(places)) < len(places):
        raise InputError("the same map is given twice: what it says would count twice")
    refuse_target(out, sources, overwrite=overwrite)
    clouds.refuse_if_no_use(sources)
    refuse_no_journal(out)
    with ExitStack() as stack:
        found = {path: stack.enter_context(opened(path)) for path in sources if not is_point_cloud(path)}
        # Points go into the voxels of the maps that they come to.
        reading = clouds.reading(next((source.voxel_m for source in found.values()), None))
        found |= {path: stack.enter_context(opened(path, reading)) for path in sources if is_point_cloud(path)}
        maps = {str(path): found[path] for path in sources}
        lies = {str(path): frame for path in sources if (frame := fleet_frame(path)) is not None}
        header = common_header(maps, lies)
        stack.enter_context(write_errors(out))
        room = stack.enter_context(workshop(out))
        indexed = [
            _in_place(stack.enter_context(_indexed(source, header, room / str(number), name)), lies.get(name), name)
            for number, (name, source) in enumerate(maps.items())
        ]
        merged = MergedMap(indexed, header.threshold, header.lowest, header.highest)
        with Progress(f"writing {out.name}") as progress:
            if out.suffix.lower() == TREE_SUFFIX:
                write(merged, out, progress)
            else:
                _write_journal(merged, header, room / "merged", out, progress)
    typer.echo(f"{out}: {len(merged.chunks):,} chunks from {len(maps)} maps")


def common_header(maps: dict[str, MapSource], lies: dict[str, Frame]) -> Header:
    """What the sum of these maps is.

    An OctoMap file or a point cloud says nothing of its frame and its clamps: it goes with any map of its voxel size,
    and takes theirs.

    Args:
        maps: by what the user called them.
        lies: where the maps of vehicles of a fleet lie, by the same.

    Raises:
        InputError: they do not go together; the message names the two that differ.
    """
    (first, source), *others = maps.items()
    for name, other in others:
        if other.voxel_m != source.voxel_m:
            raise InputError(
                f"{name} has voxels of {other.voxel_m:g} m, {first} of {source.voxel_m:g} m: only maps with voxels of "
                "one size can be merged"
            )
    journals = {
        name: replace(one.header, frame=FLEET_FRAME) if name in lies else one.header
        for name, one in maps.items()
        if isinstance(one, Journal)
    }
    if not journals:
        defaults = Header.of(MapSettings())
        only_points = all(isinstance(one, PointCloudFile) for one in maps.values())
        frame = "of point clouds" if only_points else "of OctoMap files"
        return replace(defaults, voxel_m=source.voxel_m, threshold=source.threshold, frame=frame, settings={})
    (first, header), *more = journals.items()
    for name, other_header in more:
        if differences := other_header.differences(header):
            what_to_do = "map both with the same settings"
            if FLEET_FRAME in (header.frame, other_header.frame):
                what_to_do += f"; where a vehicle's map lies is in the {SUMMARY_NAME} beside it, as fleet.frame"
            raise InputError(
                f"{name} and {first} do not go together: in the first, {'; '.join(differences)}; {what_to_do}"
            )
    return replace(header, settings={})


@contextmanager
def _indexed(source: MapSource, header: Header, folder: Path, name: str) -> Iterator[IndexedMap]:
    """The same map, so that its chunks can be asked for; one that cannot is copied into a journal."""
    if isinstance(source, Journal):
        yield source
        return
    with Journal.open(folder, replace(header, threshold=source.threshold)) as copy:
        with Progress(f"reading {Path(name).name}") as progress:
            copy.append_all(source, lambda _: progress(None))
        yield copy


def _in_place(source: IndexedMap, lies: Frame | None, name: str) -> IndexedMap:
    """The same map in the frame of the result."""
    if lies is None or lies == Frame():
        return source
    try:
        return MovedMap(source, lies)
    except ValueError as error:
        raise InputError(f"{name}: {error}; look at fleet.frame in the {SUMMARY_NAME} beside it") from None


def _write_journal(merged: MergedMap, header: Header, folder: Path, out: Path, progress: Progress) -> None:
    """Write a journal beside its place, and move it there when it is whole."""
    with Journal.open(folder, header) as journal:
        journal.append_all(merged, lambda taken: progress(taken / len(merged.chunks)))
    put_in_place(folder, out)
