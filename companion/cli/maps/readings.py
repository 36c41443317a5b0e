"""What a map can be built of: the depth images of a data set, and the images and scans of a recorded flight."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Protocol

from pydantic import ValidationError

from companion.config.load import load_settings
from companion.config.mapping import MapSettings
from companion.config.settings import Settings
from companion.errors import InputError
from companion.mapping.datasets import FORMATS, WITHIN_S, Intrinsics, PosedImages
from companion.model import DepthFrame, PlanarScan
from companion.recording import Recording, open_recording
from companion.recording.flown import flown_settings

Reading = tuple[str, DepthFrame | PlanarScan]
"""What is to go into a map, and what it is called where that is refused."""


@dataclass(frozen=True, slots=True)
class DatasetOptions:
    """What the command line says of a data set; None: as its format has it.

    Attributes:
        format_: name of the format.
        up: the axis of its world that points up.
        intrinsics: fx, fy, cx and cy of its camera, in px.
        units_per_m: what its images count in.
        within_s: largest time between an image and its pose.
    """

    format_: str | None = None
    up: str | None = None
    intrinsics: tuple[float, float, float, float] | None = None
    units_per_m: float | None = None
    within_s: float | None = None


class Readings(Protocol):
    """Something to build a map of.

    Attributes:
        source: where it is from.
        settings: of the map.
        frame: what the axes of the map are called.
        share: how much was given, 0 to 1.
    """

    source: Path
    settings: MapSettings
    frame: str
    share: float

    def each(self) -> Iterator[Reading]:
        """One after the other."""
        ...

    def notes(self) -> list[str]:
        """What was left out, for the user; known at the end."""
        ...

    def used_text(self) -> str:
        """What went into the map, in words."""
        ...


class DatasetReadings:
    """The images of a data set.

    Args:
        source: its folder.
        images: what it holds.
        left_out: why images were left out, and how many.
        settings: of the map.
        frame: what its axes are called.
    """

    def __init__(
        self, source: Path, images: PosedImages, left_out: dict[str, int], settings: MapSettings, frame: str
    ) -> None:
        self.source, self.settings, self.frame = source, settings, frame
        self.share = 0.0
        self._images, self._left_out = images, left_out

    def each(self) -> Iterator[Reading]:
        """Each image.

        Raises:
            InputError: one cannot be used; it is named.
        """
        listed = self._images.images
        for number, (image, frame) in enumerate(zip(listed, self._images.frames(), strict=True), start=1):
            self.share = number / len(listed)
            yield str(image.path), frame

    def notes(self) -> list[str]:
        """What was left out."""
        return [f"{count:,} depth images are left out: they {reason}" for reason, count in self._left_out.items()]

    def used_text(self) -> str:
        """How many images."""
        return f"{len(self._images.images):,} depth images"


class RecordingReadings:
    """The images and scans of a recorded flight, with the poses that the map was given in flight.

    Args:
        recording: the flight.
        settings: of the map.
    """

    frame = "east-north-up"

    def __init__(self, recording: Recording, settings: MapSettings) -> None:
        self.source, self.settings = recording.path, settings
        self.share = 0.0
        self._recording = recording
        self._images = self._scans = self._not_recorded = self._refused = 0

    def each(self) -> Iterator[Reading]:
        """Each image and each turn of a scanner; what a flight's map would have refused is left out and counted."""
        for tick, observation in self._recording.observations():
            self.share = self._recording.share_read
            if observation is None:
                self._not_recorded += 1
                continue
            for reading in (observation.frame, observation.planar):
                if reading is None:
                    continue
                if not reading.pose.is_finite:
                    self._refused += 1
                    continue
                self._images += isinstance(reading, DepthFrame)
                self._scans += isinstance(reading, PlanarScan)
                yield f"{self.source}, t = {tick['t_s']} s", reading

    def notes(self) -> list[str]:
        """What is not in the map."""
        found = []
        if self._not_recorded:
            found.append(f"{self._not_recorded:,} depth images are not in the recording, so the map has not seen them")
        if self._refused:
            found.append(f"{self._refused:,} images and scans are left out: their pose is no number")
        if self._recording.damage is not None:
            found.append(f"ends early ({self._recording.damage}): what came before is in the map")
        return found

    def used_text(self) -> str:
        """How many images and scans."""
        scans = f" and {self._scans:,} planar scans" if self._scans else ""
        return f"{self._images:,} depth images{scans}"


def dataset_readings(
    source: Path,
    options: DatasetOptions,
    config: Path | None,
    preset: str | None,
    voxel_m: float | None,
    max_range_m: float | None,
) -> DatasetReadings:
    """The readings of a data set.

    Raises:
        InputError: it cannot be read, or what was said of it cannot be.
    """
    if options.format_ is None:
        raise InputError(f"{source}: of which format is this folder? Give --format {' or --format '.join(FORMATS)}")
    format_ = FORMATS[options.format_]
    intrinsics = format_.intrinsics
    if options.intrinsics is not None:
        if not all(map(math.isfinite, options.intrinsics)) or min(options.intrinsics[:2]) <= 0.0:
            given = " ".join(f"{number:g}" for number in options.intrinsics)
            raise InputError(f"--intrinsics {given}: must be finite numbers, in px, and FX and FY above 0")
        intrinsics = Intrinsics(intrinsics.width, intrinsics.height, *options.intrinsics)
    settings = _mapping(load_settings(config, preset), voxel_m, max_range_m)
    images, left_out = format_.listing(source, WITHIN_S if options.within_s is None else options.within_s)
    up = options.up or format_.up
    posed = PosedImages(
        images,
        intrinsics,
        options.intrinsics is not None,
        options.units_per_m or format_.units_per_m,
        format_.no_return,
        settings.max_range_m,
        up,
    )
    return DatasetReadings(source, posed, left_out, settings, f"{format_.title}, {up} up")


def recording_readings(
    source: Path,
    options: DatasetOptions,
    config: Path | None,
    preset: str | None,
    voxel_m: float | None,
    max_range_m: float | None,
) -> RecordingReadings:
    """The readings of a recording; its own settings hold where the command line has no others.

    Raises:
        InputError: it is no recording, or something was said that is known of a recording.
    """
    names = {"format_": "--format", "units_per_m": "--depth-scale", "within_s": "--within"}
    for field in fields(options):
        if getattr(options, field.name) is not None:
            raise InputError(
                f"{names.get(field.name, f'--{field.name}')}: is for folders of data sets; a recording, as {source} "
                "must be, says all that by itself"
            )
    recording = open_recording(source)
    flown = flown_settings(recording) if config is None and preset is None else load_settings(config, preset)
    return RecordingReadings(recording, _mapping(flown, voxel_m, max_range_m))


def _mapping(settings: Settings, voxel_m: float | None, max_range_m: float | None) -> MapSettings:
    """The section `mapping` with what the command line says over it."""
    given = {"voxel_m": voxel_m, "max_range_m": max_range_m}
    over = {name: value for name, value in given.items() if value is not None}
    try:
        return MapSettings.model_validate(settings.mapping.model_dump() | over)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        options = " ".join(f"{_OPTIONS[name]} {value:g}" for name, value in over.items())
        at = ".".join(map(str, first["loc"]))
        raise InputError(f"{options}: {f'mapping.{at}: ' if at else ''}{first['msg']}; choose another") from None


_OPTIONS = {"voxel_m": "--voxel", "max_range_m": "--max-range"}
