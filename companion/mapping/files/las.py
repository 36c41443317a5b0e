"""LAS: the point cloud format of surveying."""

from __future__ import annotations

from pathlib import Path

import laspy
import numpy as np

from companion.mapping.files.colours import height_colours
from companion.mapping.files.whole import whole_file
from companion.model import FloatArray

_SCALE_M = 0.001
_COLOURED_POINT = 7


def write_las(points_m: FloatArray, path: Path) -> None:
    """Write ``points_m`` (n, 3) as LAS 1.4, point format 7, in whole mm, coloured by height."""
    header = laspy.LasHeader(version="1.4", point_format=_COLOURED_POINT)
    header.scales = np.full(3, _SCALE_M)
    header.offsets = np.floor(points_m.min(axis=0)) if len(points_m) else np.zeros(3)
    # The format demands it of points with this layout, though there is no coordinate system to describe underground.
    header.global_encoding.wkt = True
    cloud = laspy.LasData(header)
    cloud.x, cloud.y, cloud.z = points_m.T
    # Colours have 16 bits there; 255 becomes 65535.
    cloud.red, cloud.green, cloud.blue = height_colours(points_m[:, 2]).astype(np.uint16).T * 257
    with whole_file(path) as file:
        cloud.write(file)
