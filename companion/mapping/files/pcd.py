"""PCD: the point cloud format of PCL and ROS."""

from __future__ import annotations

from typing import BinaryIO

import numpy as np

from companion.mapping.files.colours import height_colours
from companion.mapping.files.export import Export, Progress

_POINT = np.dtype([("position", "<f4", 3), ("colour", "<u4"), ("probability", "<f4")])


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
        points = np.empty(len(some.centres_m), _POINT)
        points["position"] = some.centres_m
        points["colour"] = red << 16 | green << 8 | blue
        points["probability"] = some.probabilities
        file.write(points.tobytes())
