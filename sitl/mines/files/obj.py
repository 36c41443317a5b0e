"""Wavefront OBJ, in double precision, with faces of any number of corners."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sitl.mines.files.geometry import NO_TRIANGLES, Geometry, UnreadableError
from sitl.mines.files.polygons import triangulated
from sitl.mines.files.text import integers

_SILENT = frozenset({b"vn", b"vt", b"vp", b"g", b"o", b"s", b"mg", b"usemtl", b"mtllib", b"usemap", b"maplib"})
"""Statements that say nothing of where the surface is."""

_SHAPES = {b"l": "lines", b"p": "points"}


def read_obj(path: Path) -> Geometry:
    """The vertices and faces of all objects and groups in an OBJ file.

    Raises:
        UnreadableError: a line cannot be read, or a face names a vertex that is not there.
    """
    text = re.sub(rb"\\\r?\n", b" ", path.read_bytes())
    lines = [line.strip() for line in re.split(rb"[\r\n]+", text)]
    vertex_lines = [line for line in lines if line.startswith((b"v ", b"v\t"))]
    face_lines = [line for line in lines if line.startswith((b"f ", b"f\t"))]
    if not vertex_lines:
        raise UnreadableError("no mesh can be read: empty, damaged or not what its name says")
    vertices = _vertices(vertex_lines)
    if not face_lines:
        return Geometry(vertices, NO_TRIANGLES, remarks=_left_out(lines))
    corners, counts = _corners(face_lines)
    if (corners < 0).any():
        # A negative index counts back from the vertex that was read last.
        is_face = np.array([line[:1] == b"f" for line in lines])
        read = np.cumsum([line[:2] in (b"v ", b"v\t") for line in lines])[is_face]
        corners = np.where(corners < 0, corners + np.repeat(read, counts), corners - 1)
    else:
        corners = corners - 1
    if corners.min() < 0 or corners.max() >= len(vertices):
        wrong = corners.min() if corners.min() < 0 else corners.max()
        raise UnreadableError(
            f"a face names vertex {wrong + 1} of only {len(vertices)}: the file is damaged, or its end is missing"
        )
    triangles, remarks = triangulated(vertices, corners, counts)
    return Geometry(vertices, triangles, remarks=(*remarks, *_left_out(lines)))


def _vertices(lines: list[bytes]) -> NDArray[np.float64]:
    try:
        return np.loadtxt(lines, usecols=(1, 2, 3), dtype=np.float64, ndmin=2, encoding="latin-1")
    except ValueError as error:
        raise UnreadableError(f"the file is damaged: the line of a vertex cannot be read: {error}") from None


def _corners(lines: list[bytes]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The vertices that faces name, as they stand there, and how many each names."""
    # 0 is no index, so it can stand between the faces.
    joined = b" 0 ".join([line[1:] for line in lines]) + b" 0"
    # Of vertex/texture/normal only the first says where the surface is.
    joined = re.sub(rb"/[^ \t]*", b"", joined) if b"/" in joined else joined
    try:
        numbers = integers(joined)
    except ValueError as error:
        raise UnreadableError(f"the file is damaged: the line of a face cannot be read: {error}") from None
    ends = np.flatnonzero(numbers == 0)
    if len(ends) != len(lines):
        raise UnreadableError("a face names vertex 0, and the first one is number 1")
    return numbers[numbers != 0], np.diff(ends, prepend=-1) - 1


def _left_out(lines: list[bytes]) -> tuple[str, ...]:
    others = Counter(line.split(maxsplit=1)[0] for line in lines if line[:1] not in (b"v", b"f", b"#", b""))
    others.update(
        word
        for word in (line.split(maxsplit=1)[0] for line in lines if line[:1] in (b"v", b"f"))
        if word not in (b"v", b"f")
    )
    return tuple(
        f"{count} {_SHAPES.get(word, 'statements ' + repr(word.decode(errors='replace')))} are left out"
        for word, count in sorted(others.items())
        if word not in _SILENT
    )
