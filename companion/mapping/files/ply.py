"""PLY: the polygon file format, here with points only."""

from __future__ import annotations

from typing import BinaryIO

import numpy as np

from companion.mapping.files.colours import height_colours
from companion.mapping.files.export import Export, Progress

_POINT = np.dtype([("position", "<f4", 3), ("colour", "u1", 3), ("probability", "<f4")])


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
        points = np.empty(len(some.centres_m), _POINT)
        points["position"] = some.centres_m
        points["colour"] = height_colours(some.centres_m[:, 2], export)
        points["probability"] = some.probabilities
        file.write(points.tobytes())
