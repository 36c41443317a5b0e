"""The place of the flights: a dead end, which the vehicle faces."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

LENGTH_M, WIDTH_M, HEIGHT_M = 14.0, 4.0, 3.0
TO_WALL_M = 4.0
"""From the start to the wall ahead: 2.5 m at full speed before the fault, and little time lost on the way."""
START_X_M = LENGTH_M / 2.0 - TO_WALL_M
_CORNERS_OF_TRIANGLES = (
    (0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1), (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4),
    (1, 5, 7), (1, 7, 3),
)  # fmt: skip


def corridor(folder: Path) -> Path:
    """A dead end along x."""
    start = {"x": START_X_M, "y": 0.0, "z": 1.5, "yaw": 0.0}
    return write_box(folder / "corridor.ply", (LENGTH_M, WIDTH_M, HEIGHT_M), start)


def write_box(file: Path, size_m: tuple[float, float, float], start: Mapping[str, float]) -> Path:
    """Write a box as a mesh file, its floor in the middle of the plan at height 0, and a JSON file with the start."""
    length_m, width_m, height_m = size_m
    corners = [
        (x, y, z) for x in (-length_m / 2, length_m / 2) for y in (-width_m / 2, width_m / 2) for z in (0.0, height_m)
    ]
    header = [
        *("ply", "format ascii 1.0", f"element vertex {len(corners)}"),
        *(f"property float {axis}" for axis in "xyz"),
        *(f"element face {len(_CORNERS_OF_TRIANGLES)}", "property list uchar int vertex_indices", "end_header"),
    ]
    rows = [" ".join(map(str, corner)) for corner in corners]
    rows += [" ".join(map(str, (3, *triangle))) for triangle in _CORNERS_OF_TRIANGLES]
    file.write_text("\n".join([*header, *rows, ""]), encoding="ascii")
    file.with_suffix(".json").write_text(json.dumps({"start": start}), encoding="utf-8")
    return file
