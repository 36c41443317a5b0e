"""Point clouds as maps: a voxel that holds a point is occupied, and of all others nothing is known."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from companion.config.mapping import MapSettings
from companion.mapping.files.export import MapFileError
from companion.mapping.files.georeference import Place
from companion.mapping.files.octree_walk import BINARY_OCCUPIED
from companion.mapping.files.point_readers import las_points, pcd_points, ply_points
from companion.mapping.voxels.chunks import MASK, NOTHING, SHIFT, VOLUME, place_of
from companion.mapping.voxels.piece import MOST_CHUNKS, MapPiece, Progress, silent
from companion.model import FloatArray

READERS: dict[str, Callable[[Path, Progress], Iterator[FloatArray]]] = {
    ".ply": ply_points,
    ".pcd": pcd_points,
    ".las": las_points,
    ".laz": las_points,
}
"""What reads the points of each format."""

_REACH = 1 << 20
"""Voxels from the origin: beyond it, other formats could not hold the map in single precision to a voxel's tenth."""

_MOST_CLOUD_CHUNKS = 1 << 20
"""As of an OctoMap: ten times a tunnel of 10 km. More are points in mm, or voxels that are much too small."""

_PLACE_BITS = 3 * SHIFT
_CHUNK_BITS = 17
_CHUNK_OFFSET = 1 << _CHUNK_BITS - 1
_PENDING = 1 << 22
"""Keys that wait at least, until they are put together: each time costs a sort of all."""


@dataclass(frozen=True, slots=True)
class CloudReading:
    """How points become voxels.

    Attributes:
        voxel_m: edge of a voxel.
        place_m: where the map's origin is in the coordinates of the file; it is taken from every point.
    """

    voxel_m: float = MapSettings().voxel_m
    place_m: Place = (0.0, 0.0, 0.0)


class PointCloudFile:
    """The map of a point cloud; a `MapSource`. In memory are eight bytes for each occupied voxel, and no points.

    Its voxels count as certain, like those of a ``.bt``: they have OctoMap's greatest log-odds.

    Attributes:
        points: finite points that were read.
        left_out: points with a coordinate that is no number, such as cameras send where they measured nothing.
    """

    def __init__(self, voxel_m: float, keys: NDArray[np.int64], points: int, left_out: int) -> None:
        self.voxel_m = voxel_m
        self.threshold = 0
        self.points = points
        self.left_out = left_out
        self._keys = keys
        self._starts = np.flatnonzero(np.diff(keys >> _PLACE_BITS, prepend=-1))

    @property
    def occupied(self) -> int:
        """How many voxels hold a point."""
        return len(self._keys)

    def pieces(self, most_chunks: int = MOST_CHUNKS) -> Iterator[MapPiece]:
        """Every chunk once, ``most_chunks`` at a time."""
        ends = np.append(self._starts[1:], len(self._keys))
        for first in range(0, len(self._starts), most_chunks):
            starts = self._starts[first : first + most_chunks]
            keys = self._keys[starts[0] : ends[first + len(starts) - 1]]
            numbers = keys >> _PLACE_BITS
            rows = np.cumsum(np.diff(numbers, prepend=numbers[:1]) != 0)
            values = np.full((len(starts), VOLUME), NOTHING)
            values[rows, keys & VOLUME - 1] = BINARY_OCCUPIED
            yield MapPiece(_chunks_of(self._keys[starts]), values)


def is_point_cloud(path: Path) -> bool:
    """Whether the suffix says that a file holds a point cloud."""
    return path.suffix.lower() in READERS


def open_point_cloud(path: Path, reading: CloudReading, progress: Progress = silent) -> PointCloudFile:
    """The map of a point cloud. Its points are read once, a block at a time.

    Args:
        path: the file; its suffix is one of `READERS`.
        reading: how points become voxels.
        progress: takes the share of the points that was read, 0 to 1, from time to time.

    Raises:
        MapFileError: the file is damaged or no point cloud, or its points are too far away or too far apart.
        ModuleNotFoundError: the library for the format is not installed.
        OSError: it cannot be read.
    """
    known = np.empty(0, np.int64)
    waiting: list[NDArray[np.int64]] = []
    points = left_out = 0
    for block in READERS[path.suffix.lower()](path, progress):
        finite = block[np.isfinite(block).all(axis=1)]
        points += len(finite)
        left_out += len(block) - len(finite)
        waiting.append(_keys_of(path, finite, reading))
        if sum(map(len, waiting)) > max(_PENDING, len(known)):
            known, waiting = _together(path, known, waiting, reading), []
    known = _together(path, known, waiting, reading)
    return PointCloudFile(reading.voxel_m, known, points, left_out)


def _keys_of(path: Path, points: FloatArray, reading: CloudReading) -> NDArray[np.int64]:
    """The voxels of some points, each once, as numbers in whose order those of a chunk come together."""
    voxels = np.floor((points - reading.place_m) / reading.voxel_m)
    far = np.flatnonzero((np.abs(voxels) >= _REACH).any(axis=1))
    if len(far):
        where = ", ".join(f"{part:.15g}" for part in points[far[0]])
        place = " ".join(f"{part:.0f}" for part in np.floor(np.median(points, axis=0)))
        raise MapFileError(
            f"{path}: a point at ({where}) m is further than {_REACH * reading.voxel_m:g} m from the origin, which is "
            f"all that a map of voxels of {reading.voxel_m:g} m holds: say where the map's origin is in the file's "
            f"coordinates, for instance --offset {place}"
        )
    whole = voxels.astype(np.int64)
    places = np.asarray(place_of.py_func(*(whole & MASK).T))
    keys = np.zeros(len(whole), np.int64)
    for part in (whole >> SHIFT).T:
        keys = keys << _CHUNK_BITS | part + _CHUNK_OFFSET
    return np.unique(keys << _PLACE_BITS | places)


def _together(
    path: Path, known: NDArray[np.int64], waiting: list[NDArray[np.int64]], reading: CloudReading
) -> NDArray[np.int64]:
    keys = np.unique(np.concatenate([known, *waiting]))
    chunks = int(np.count_nonzero(np.diff(keys >> _PLACE_BITS)))
    if chunks > _MOST_CLOUD_CHUNKS:
        size = " x ".join(f"{part:,.0f}" for part in np.ptp(_chunks_of(keys), axis=0) * 16 * reading.voxel_m)
        raise MapFileError(
            f"{path}: its points lie in more than {_MOST_CLOUD_CHUNKS:,} cubes of 16 voxels, over {size} m: too many "
            "for a map. They are in mm, or the voxels are too small: give points in m, or a larger --voxel"
        )
    return keys


def _chunks_of(keys: NDArray[np.int64]) -> NDArray[np.int32]:
    """(n, 3) the chunks of these keys (n,)."""
    part = (1 << _CHUNK_BITS) - 1
    numbers = keys >> _PLACE_BITS
    chunks = np.stack([numbers >> 2 * _CHUNK_BITS, numbers >> _CHUNK_BITS & part, numbers & part], axis=-1)
    return (chunks - _CHUNK_OFFSET).astype(np.int32)
