"""LAS and its compressed form LAZ: the point cloud formats of surveying."""

from __future__ import annotations

import struct
from datetime import date
from typing import BinaryIO

import laspy
import numpy as np

from companion import __version__
from companion.mapping.files.colours import height_colours
from companion.mapping.files.export import Export, Progress

_SCALE_M = 0.001
_DAY_AND_YEAR_AT = 90
"""Where LAS keeps the day of the year and the year."""


def write_las(export: Export, file: BinaryIO, progress: Progress) -> None:
    """Write LAS 1.2: the centres of occupied voxels in whole mm.

    Points have format 2, which all surveying software reads: colours by height, and as intensity the probability that
    the voxel is occupied, 65535 being certain.
    """
    _write(export, file, progress, compressed=False)


def write_laz(export: Export, file: BinaryIO, progress: Progress) -> None:
    """Write what `write_las` writes, compressed."""
    _write(export, file, progress, compressed=True)


def _write(export: Export, file: BinaryIO, progress: Progress, *, compressed: bool) -> None:
    header = laspy.LasHeader(version="1.2", point_format=2)
    header.system_identifier = "EXTRACTION"  # the standard's word for what was drawn from other data
    header.generating_software = f"companion {__version__}"
    header.creation_date = export.created or date.min
    header.scales = np.full(3, _SCALE_M)
    header.offsets = np.floor(export.lowest * export.source.voxel_m)
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
            points.x, points.y, points.z = some.centres_m.T
            points.intensity = np.round(some.probabilities * 65535).astype(np.uint16)
            points.return_number = points.number_of_returns = np.ones(len(some.centres_m), np.uint8)
            # Colours have 16 bits there; 255 becomes 65535.
            colours = height_colours(some.centres_m[:, 2], export).astype(np.uint16) * 257
            points.red, points.green, points.blue = colours.T
            writer.write_points(points)
