"""PCD: the point cloud format of PCL and ROS."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from companion.mapping.files.colours import height_colours
from companion.mapping.files.whole import whole_file
from companion.model import FloatArray

_POINT = np.dtype([("position", "<f4", 3), ("colour", "<u4")])


def write_pcd(points_m: FloatArray, path: Path) -> None:
    """Write ``points_m`` (n, 3) as binary PCD v0.7, coloured by height."""
    n = len(points_m)
    # The colour is three bytes in a word, 0x00RRGGBB, which by PCL's convention is declared to be a float.
    header = (
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x y z rgb\nSIZE 4 4 4 4\nTYPE F F F F\n"
        f"COUNT 1 1 1 1\nWIDTH {n}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {n}\nDATA binary\n"
    )
    red, green, blue = height_colours(points_m[:, 2]).astype(np.uint32).T
    points = np.empty(n, _POINT)
    points["position"] = points_m
    points["colour"] = red << 16 | green << 8 | blue
    with whole_file(path) as file:
        file.write(header.encode("ascii"))
        file.write(points.tobytes())
