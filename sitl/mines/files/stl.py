"""STL, binary and as text."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sitl.mines.files.geometry import Geometry, UnreadableError, single_step
from sitl.mines.files.text import reals

_HEADER_BYTES = 84
_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def read_stl(path: Path) -> Geometry:
    """The triangles of an STL file, in their order, with three vertices of their own each.

    Raises:
        UnreadableError: the file ends before its triangles do.
    """
    data = path.read_bytes()
    begin = data[:4096].lower()
    # Binary files may begin with the word "solid" as well.
    if begin.lstrip().startswith(b"solid") and (b"facet" in begin or b"endsolid" in begin) and b"\0" not in begin:
        return _of_text(data)
    return _of_binary(data)


def _of_binary(data: bytes) -> Geometry:
    if len(data) < _HEADER_BYTES:
        raise UnreadableError("no mesh can be read: empty, damaged or not what its name says")
    said = int.from_bytes(data[_HEADER_BYTES - 4 : _HEADER_BYTES], "little")
    there, rest = divmod(len(data) - _HEADER_BYTES, _TRIANGLE.itemsize)
    remarks = []
    if said == 0 and there > 0 and rest == 0:
        remarks.append(f"the file says that it holds no triangles, and holds {there}: they are read")
        said = there
    if said > there:
        raise UnreadableError(f"damaged: it should hold {said} triangles and ends after {there}")
    if extra := len(data) - _HEADER_BYTES - said * _TRIANGLE.itemsize:
        remarks.append(f"{extra} bytes after the last triangle are left out")
    triangles = np.frombuffer(data, _TRIANGLE, said, _HEADER_BYTES)
    vertices = triangles["corners"].reshape(-1, 3).astype(np.float64)
    return Geometry(vertices, _in_threes(vertices), step=single_step(vertices), remarks=tuple(remarks))


def _of_text(data: bytes) -> Geometry:
    lower = data.lower().rstrip()
    last = lower[max(lower.rfind(b"\n"), lower.rfind(b"\r")) + 1 :].lstrip()
    if not last.startswith(b"endsolid"):
        raise UnreadableError("damaged: the text ends without 'endsolid', so its end is missing")
    facets = lower.count(b"endfacet")
    corners = re.findall(rb"(?<=\s)vertex(\s[^\r\n]+)", lower)
    try:
        numbers = reals(b"".join(corners))
    except ValueError:
        raise UnreadableError("damaged: a vertex is not three numbers") from None
    if len(corners) != 3 * facets or len(numbers) != 9 * facets:
        raise UnreadableError(f"damaged: {facets} triangles with {len(corners)} corners of {len(numbers)} numbers")
    vertices = numbers.reshape(-1, 3)
    return Geometry(vertices, _in_threes(vertices))


def _in_threes(vertices: NDArray[np.float64]) -> NDArray[np.int64]:
    return np.arange(len(vertices), dtype=np.int64).reshape(-1, 3)
