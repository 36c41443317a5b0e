"""PLY: the polygon file format, here with points only."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from companion.mapping.files.colours import height_colours
from companion.mapping.files.whole import whole_file
from companion.model import FloatArray

_POINT = np.dtype([("position", "<f4", 3), ("colour", "u1", 3)])


def write_ply(points_m: FloatArray, path: Path) -> None:
    """Write ``points_m`` (n, 3) as binary little-endian PLY, coloured by height."""
    header = (
        "ply\nformat binary_little_endian 1.0\ncomment map of occupied voxels, east north up in m\n"
        f"element vertex {len(points_m)}\n"
        "property float x\nproperty float y\nproperty float z\n"
        "property uchar red\nproperty uchar green\nproperty uchar blue\n"
        "end_header\n"
    )
    points = np.empty(len(points_m), _POINT)
    points["position"] = points_m
    points["colour"] = height_colours(points_m[:, 2])
    with whole_file(path) as file:
        file.write(header.encode("ascii"))
        file.write(points.tobytes())
