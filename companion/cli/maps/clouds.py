"""Point clouds among the maps that a command is given: how they are read, and what is said of it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from companion.errors import InputError
from companion.mapping.files import GEOREFERENCED, CloudReading, PointCloudFile, is_point_cloud
from companion.mapping.files.georeference import Place


@dataclass(frozen=True, slots=True)
class CloudOptions:
    """What the command line says of point clouds; None: nothing.

    Attributes:
        voxel_m: edge of the voxels that the points are put into.
        offset_m: where the map's origin is in the coordinates of clouds, those that are read and that are written.
    """

    voxel_m: float | None = None
    offset_m: Place | None = None

    def refuse_if_no_use(self, sources: Sequence[Path], targets: Sequence[Path] = ()) -> None:
        """Make sure that what was given means something: an option that is passed over is a mistake that is not seen.

        Raises:
            InputError: it does not, or is no place.
        """
        reads_cloud = any(map(is_point_cloud, sources))
        if self.voxel_m is not None and not reads_cloud:
            raise InputError(
                f"--voxel {self.voxel_m:g}: only point clouds are put into voxels; the maps here have their own already"
            )
        if self.offset_m is None:
            return
        where = place_text(self.offset_m)
        if not all(map(math.isfinite, self.offset_m)):
            raise InputError(f"--offset {where}: must be three finite numbers, in m")
        if not reads_cloud and not any(holds_place(target) for target in targets):
            formats = " or ".join(f".{format_}" for format_ in GEOREFERENCED)
            raise InputError(
                f"--offset {where}: no point cloud is read and no {formats} is written; all else is in the map's own "
                "coordinates"
            )

    def reading(self, voxel_m: float | None = None) -> CloudReading:
        """How clouds are read, in voxels of ``voxel_m`` where the command line says nothing."""
        plain = CloudReading()
        return CloudReading(self.voxel_m or voxel_m or plain.voxel_m, self.offset_m or plain.place_m)


def holds_place(target: Path) -> bool:
    """Whether a file can say where the map was surveyed."""
    return target.suffix.lower().removeprefix(".") in GEOREFERENCED


def place_text(place_m: Place) -> str:
    """A place as it is typed on the command line, to the last digit."""
    return " ".join(f"{part:.15g}" for part in place_m)


def cloud_text(cloud: PointCloudFile) -> str:
    """What became of the points."""
    left_out = f" ({cloud.left_out:,} more are not finite)" if cloud.left_out else ""
    voxels = f"{cloud.occupied:,} voxels of {cloud.voxel_m:g} m"
    return f"{cloud.points:,} points{left_out} in {voxels}; what is free is not known"
