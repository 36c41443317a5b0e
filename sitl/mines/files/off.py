"""OFF, in double precision, with faces of any number of corners."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from sitl.mines.files.geometry import Geometry, UnreadableError
from sitl.mines.files.polygons import triangulated
from sitl.mines.files.text import reals

_KINDS = (b"OFF", b"COFF", b"NOFF", b"CNOFF", b"STOFF")
"""Of three coordinates a vertex; what stands behind those is not read."""


def read_off(path: Path) -> Geometry:
    """The surface in an OFF file, a line for each vertex and for each face.

    Raises:
        UnreadableError: damaged, cut off, or no faces.
    """
    lines = [
        line for line in (line.partition(b"#")[0].strip() for line in re.split(rb"[\r\n]+", path.read_bytes())) if line
    ]
    kind, *counts = lines[0].split() if lines else [b""]
    if kind not in _KINDS:
        raise UnreadableError("no mesh can be read: empty, damaged or not what its name says")
    try:
        if not counts:
            counts = lines.pop(1).split()
        vertices_said, faces_said = int(counts[0]), int(counts[1])
        if len(lines) - 1 < vertices_said + faces_said:
            raise UnreadableError(
                f"damaged: it should hold {vertices_said} vertices and {faces_said} faces and ends after "
                f"{len(lines) - 1} lines"
            )
        if vertices_said <= 0 or faces_said <= 0:
            raise UnreadableError(f"holds no triangles ({vertices_said} points); a world must be a surface mesh")
        of_vertices = lines[1 : 1 + vertices_said]
        vertices = np.loadtxt(of_vertices, usecols=(0, 1, 2), dtype=np.float64, ndmin=2, encoding="latin-1")
        # No count, index or colour is negative: it can stand between the faces.
        numbers = reals(b" -1 ".join(lines[1 + vertices_said : 1 + vertices_said + faces_said]) + b" -1")
    except (ValueError, IndexError) as error:
        raise UnreadableError(f"the file is damaged: a line cannot be read: {error}") from None
    ends = np.flatnonzero(numbers == -1)
    first = np.concatenate([[0], ends[:-1] + 1])
    corner_counts = numbers[first].astype(np.int64)
    if len(ends) != faces_said or (corner_counts < 0).any() or (first + corner_counts >= ends).any():
        raise UnreadableError("the file is damaged: a face names fewer vertices than it says, or a negative one")
    within = np.arange(corner_counts.sum()) - np.repeat(np.cumsum(corner_counts) - corner_counts, corner_counts)
    corners = numbers[np.repeat(first + 1, corner_counts) + within].astype(np.int64)
    if corners.max(initial=0) >= vertices_said:
        raise UnreadableError(f"a triangle names vertex {corners.max()} of only {vertices_said}")
    triangles, remarks = triangulated(vertices, corners, corner_counts)
    return Geometry(vertices, triangles, remarks=remarks)
