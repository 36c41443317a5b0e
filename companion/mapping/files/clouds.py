"""Point clouds, the occupied voxels alone: PLY, PCD of PCL and ROS, and LAS and LAZ of surveying."""

from __future__ import annotations

import struct
from datetime import date
from typing import BinaryIO

import laspy
import numpy as np
from laspy.vlrs.known import WktCoordinateSystemVlr
from numpy.typing import NDArray

from companion import __version__
from companion.mapping.files.export import Export
from companion.mapping.voxels.piece import Progress
from companion.model import FloatArray

_STOPS = np.array([[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]], np.float64)
"""Viridis at even steps: dark is low; it reads in grey and with any colour vision."""


def height_colours(heights_m: FloatArray, export: Export) -> NDArray[np.uint8]:
    """(n, 3) red, green and blue for ``heights_m`` (n,), from the lowest occupied voxel of the map to the highest."""
    lowest_m, highest_m = ((float(at[2]) + 0.5) * export.source.voxel_m for at in (export.lowest, export.highest))
    # All at one height are all the lowest.
    share = (heights_m - lowest_m) / max(highest_m - lowest_m, np.finfo(np.float64).tiny)
    return viridis(share)


def viridis(shares: FloatArray) -> NDArray[np.uint8]:
    """(..., 3) red, green and blue for ``shares`` (...), from 0, the lowest, to 1."""
    at = np.linspace(0.0, 1.0, len(_STOPS))
    return np.stack([np.interp(shares, at, stops) for stops in _STOPS.T], axis=-1).round().astype(np.uint8)


_PLY_POINT = np.dtype([("position", "<f4", 3), ("colour", "u1", 3), ("probability", "<f4")])


def write_ply(export: Export, file: BinaryIO, progress: Progress) -> None:
    """Write binary little-endian PLY: the centres of occupied voxels, coloured by height, with their probability."""
    header = (
        "ply\nformat binary_little_endian 1.0\ncomment map of occupied voxels, east north up in m\n"
        f"element vertex {export.occupied}\n"
        "property float x\nproperty float y\nproperty float z\n"
        "property uchar red\nproperty uchar green\nproperty uchar blue\n"
        "property float probability\n"
        "end_header\n"
    )
    file.write(header.encode("ascii"))
    for some in export.points(progress):
        points = np.empty(len(some.centres_m), _PLY_POINT)
        points["position"] = some.centres_m
        points["colour"] = height_colours(some.centres_m[:, 2], export)
        points["probability"] = some.probabilities
        file.write(points.tobytes())


_PCD_POINT = np.dtype([("position", "<f4", 3), ("colour", "<u4"), ("probability", "<f4")])


def write_pcd(export: Export, file: BinaryIO, progress: Progress) -> None:
    """Write binary PCD v0.7: the centres of occupied voxels, coloured by height, with their probability."""
    n = export.occupied
    # The colour is three bytes in a word, 0x00RRGGBB, which by PCL's convention is declared to be a float.
    header = (
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x y z rgb probability\nSIZE 4 4 4 4 4\n"
        f"TYPE F F F F F\nCOUNT 1 1 1 1 1\nWIDTH {n}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {n}\nDATA binary\n"
    )
    file.write(header.encode("ascii"))
    for some in export.points(progress):
        red, green, blue = height_colours(some.centres_m[:, 2], export).astype(np.uint32).T
        points = np.empty(len(some.centres_m), _PCD_POINT)
        points["position"] = some.centres_m
        points["colour"] = red << 16 | green << 8 | blue
        points["probability"] = some.probabilities
        file.write(points.tobytes())


_FINEST_M = 0.001
_MOST_STEPS = 2**31 - 1
"""LAS counts in 32 bits from its offset on."""

_DAY_AND_YEAR_AT = 90
"""Where LAS keeps the day of the year and the year."""


def write_las(export: Export, file: BinaryIO, progress: Progress) -> None:
    """Write LAS: the centres of occupied voxels, in whole mm where the map is no larger than 2147 km.

    The offset in the header is a whole number of m below the lowest point, in surveyed coordinates where the map has
    them, so that nothing is lost of a place thousands of kilometres from their origin. Points have colours by height,
    and as intensity the probability that the voxel is occupied, 65535 being certain. They are of format 2 in LAS 1.2,
    which all surveying software reads; with a coordinate system of format 7 in LAS 1.4, which has it as text.
    """
    _write_las(export, file, progress, compressed=False)


def write_laz(export: Export, file: BinaryIO, progress: Progress) -> None:
    """Write what `write_las` writes, compressed."""
    _write_las(export, file, progress, compressed=True)


def _write_las(export: Export, file: BinaryIO, progress: Progress, *, compressed: bool) -> None:
    header = _header(export)
    header.system_identifier = "EXTRACTION"  # the standard's word for what was drawn from other data
    header.generating_software = f"companion {__version__}"
    header.creation_date = export.created or date.min
    target = _Remembering(file)
    try:
        _write_points(export, target, header, progress, compressed=compressed)
    except Exception:
        # The compressor has an error of its own for all that happens to the file.
        if target.error is not None:
            raise target.error from None
        raise
    if export.created is None:
        # laspy would put today's date; zeros are the standard's "not said".
        file.seek(_DAY_AND_YEAR_AT)
        file.write(struct.pack("<HH", 0, 0))


def _header(export: Export) -> laspy.LasHeader:
    """A header whose offset and scale fit the map where it lies, and what its coordinates are."""
    system = export.georeference.system
    if system is None:
        header = laspy.LasHeader(version="1.2", point_format=2)
    else:
        header = laspy.LasHeader(version="1.4", point_format=7)
        header.vlrs.append(WktCoordinateSystemVlr(system.wkt))
        header.global_encoding.wkt = True
    voxel_m = export.source.voxel_m
    header.offsets = np.floor(np.add(export.georeference.place_m, export.lowest * voxel_m))
    scale_m, size_m = _FINEST_M, float((export.highest - export.lowest + 1).max()) * voxel_m + 1.0
    while size_m > _MOST_STEPS * scale_m:
        scale_m *= 10.0
    header.scales = np.full(3, scale_m)
    return header


class _Remembering:
    """A file that remembers why it could not be written: the compressor says only that it could not."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self.error: OSError | None = None
        self.seek, self.tell, self.flush = file.seek, file.tell, file.flush

    def write(self, data: bytes) -> int:
        try:
            return self._file.write(data)
        except OSError as error:
            self.error = error
            raise


def _write_points(
    export: Export, target: _Remembering, header: laspy.LasHeader, progress: Progress, *, compressed: bool
) -> None:
    with laspy.LasWriter(target, header, do_compress=compressed, closefd=False) as writer:
        for some in export.points(progress):
            points = laspy.ScaleAwarePointRecord.zeros(len(some.centres_m), header=header)
            points.x, points.y, points.z = (some.centres_m + export.georeference.place_m).T
            points.intensity = np.round(some.probabilities * 65535).astype(np.uint16)
            points.return_number = points.number_of_returns = np.ones(len(some.centres_m), np.uint8)
            # Colours have 16 bits there; 255 becomes 65535.
            colours = height_colours(some.centres_m[:, 2], export).astype(np.uint16) * 257
            points.red, points.green, points.blue = colours.T
            writer.write_points(points)
