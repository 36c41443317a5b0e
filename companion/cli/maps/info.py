"""`companion map info`."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path

from companion.cli.maps.clouds import CloudOptions
from companion.cli.maps.progress import Progress
from companion.cli.maps.sources import chunks_seen, losses_text, map_at, opened, size_text
from companion.mapping.files import PointCloudFile
from companion.mapping.files.facts import MapFacts, facts_of
from companion.mapping.journal import Header, Journal
from companion.mapping.voxels.piece import MapSource
from companion.text_table import columns


@dataclass(frozen=True, slots=True)
class MapInfo:
    """All that is said of a map.

    Attributes:
        path: where it is.
        bytes_on_disk: of all its files.
        written: when one of its files was last changed, as ISO 8601 in UTC.
        occupied_from: probability from which a voxel counts as occupied.
        header: what the map says of itself; None for an OctoMap file, which says nothing more.
        facts: what it holds.
        losses: places in its files that are damaged: what they held is lost.
        lost_bytes: bytes of these.
        torn_bytes: the unfinished end that a crash left: nothing that was committed.
        points: of a point cloud, those that were read; None: it is none.
        points_left_out: of a point cloud, those with a coordinate that is no number.
    """

    path: str
    bytes_on_disk: int
    written: str
    occupied_from: float
    header: Header | None
    facts: MapFacts
    losses: int
    lost_bytes: int
    torn_bytes: int
    points: int | None
    points_left_out: int


def show_info(path: Path, clouds: CloudOptions, *, as_json: bool) -> str:
    """What `companion map info MAP [--json]` prints.

    Raises:
        InputError: it is no map.
    """
    place = map_at(path)
    clouds.refuse_if_no_use([path])
    with opened(path, clouds.reading(), tells=False) as source, Progress("reading the map") as progress:
        info = _info(place, source, progress)
    if as_json:
        return json.dumps(asdict(info) | {"extent_m": info.facts.extent_m}, indent=2)
    return _render(info)


def _info(place: Path, source: MapSource, progress: Progress) -> MapInfo:
    journal = source if isinstance(source, Journal) else None
    facts = facts_of(source, chunks_seen(source, progress))
    files = [place] if journal is None else [file for file in place.iterdir() if file.is_file()]
    # Damage inside a record shows only when it is read, so this is asked last.
    losses = () if journal is None else journal.losses
    lost = [loss.size_bytes for loss in losses if not loss.torn]
    return MapInfo(
        path=str(place),
        bytes_on_disk=sum(file.stat().st_size for file in files),
        written=datetime.fromtimestamp(max(file.stat().st_mtime for file in files), UTC).isoformat(timespec="seconds"),
        occupied_from=_probability(source.threshold),
        header=None if journal is None else journal.header,
        facts=facts,
        losses=len(lost),
        lost_bytes=sum(lost),
        torn_bytes=sum(loss.size_bytes for loss in losses if loss.torn),
        points=source.points if isinstance(source, PointCloudFile) else None,
        points_left_out=source.left_out if isinstance(source, PointCloudFile) else 0,
    )


def _render(info: MapInfo) -> str:
    facts, header = info.facts, info.header
    rows = [
        ("map", f"{info.path}, {size_text(info.bytes_on_disk)}, written {info.written}"),
        ("voxel", f"{facts.voxel_m:g} m"),
        ("frame", "not said in the file" if header is None else header.frame),
        ("sensor model", _model(info)),
    ]
    if info.points is not None:
        left_out = f", {info.points_left_out:,} more are not finite" if info.points_left_out else ""
        rows.append(("points", f"{info.points:,}{left_out}; what holds one is occupied, and what is free is not known"))
    if facts.low_m is None or facts.high_m is None:
        rows.append(("bounds", "nothing is known"))
    else:
        spans = zip("xyz", facts.low_m, facts.high_m, strict=True)
        rows.append(("bounds", ", ".join(f"{axis} {low:.2f} to {high:.2f}" for axis, low, high in spans) + " m"))
        rows.append(("extent", " x ".join(f"{size:.2f}" for size in facts.extent_m) + " m"))
    rows += [
        ("voxels", f"{facts.occupied:,} occupied, {facts.free:,} free, {facts.undecided:,} undecided"),
        ("free space", f"{facts.free_m3:,.1f} m³"),
        ("surface", f"about {facts.surface_m2:,.0f} m² between free and occupied"),
        ("chunks", f"{facts.chunks:,} of 16 x 16 x 16 voxels"),
        ("damage", _damage(info)),
    ]
    return "\n".join(columns(rows, left=(0, 1)))


def _model(info: MapInfo) -> str:
    words = [f"occupied from {info.occupied_from:.2f} on"]
    if info.header is not None:
        settings = info.header.settings
        lowest, highest = _probability(info.header.lowest), _probability(info.header.highest)
        words.append(f"clamps {lowest:.2f} and {highest:.2f}")
        known = [(name, settings.get(f"{name}_probability")) for name in ("hit", "miss")]
        words += [f"{name} {value:.2f}" for name, value in known if isinstance(value, float)]
        if isinstance(settings.get("model"), str):
            words.insert(0, str(settings["model"]))
    return ", ".join(words)


def _damage(info: MapInfo) -> str:
    words = []
    if info.losses:
        words.append(losses_text(info.losses, info.lost_bytes))
    if info.torn_bytes:
        words.append(
            f"its end is missing ({size_text(info.torn_bytes)} do not make a record): its writer was stopped in "
            "mid-write, by which nothing committed is lost, or it was not copied whole"
        )
    return "; ".join(words) or "none found"


def _probability(milli_log_odds: int) -> float:
    return 1.0 / (1.0 + math.exp(-milli_log_odds / 1000.0))
