"""PLY as Open3D reads it: in double precision, if the file has it."""

from __future__ import annotations

import contextlib
import io
import os
import re
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np

from sitl.mines.files.geometry import Geometry, UnreadableError, single_step

_COMPLAINT = re.compile(r"^(?:\x1b\[[0-9;]*m)*(?:RPly: *|\[Open3D WARNING\] *)(.*?)(?:\x1b\[[0-9;]*m)*$")
_NO_COMPLAINT = re.compile("appears to be a geometry::PointCloud")
_NO_REASON = re.compile("Aborted by user|unable to read file")
"""What is said beside the reason."""

_HEADER_BYTES = 65536


def read_ply(path: Path) -> Geometry:
    """The surface in a PLY file, or its points where it has no faces.

    Raises:
        UnreadableError: damaged, or faces of a kind that is not read.
    """
    with path.open("rb") as file:
        header = file.read(_HEADER_BYTES).partition(b"end_header")[0]
    if re.search(rb"^element\s+tristrips\s+[1-9]", header, re.MULTILINE):
        raise UnreadableError(
            "its triangles are in strips (tristrips), which are not read: open and save it with MeshLab, which "
            "writes triangles"
        )
    said = re.search(rb"^element\s+face\s+(\d+)", header, re.MULTILINE)
    geometry = _triangle_mesh(path, 0 if said is None else int(said[1]))
    single = re.search(rb"^format\s+binary", header, re.MULTILINE) and re.search(
        rb"^property\s+float(32)?\s+x\b", header, re.MULTILINE
    )
    return replace(geometry, step=single_step(geometry.vertices)) if single else geometry


def _triangle_mesh(path: Path, faces: int) -> Geometry:
    """What Open3D reads of a file that says that it has so many faces."""
    import open3d  # takes 3 s: only those wait who read meshes

    with _silenced(open3d) as said:
        mesh = open3d.io.read_triangle_mesh(path)
    vertices, triangles = np.asarray(mesh.vertices), np.asarray(mesh.triangles).astype(np.int64)
    if said:
        raise UnreadableError(f"the file is damaged or not what its name says: {said[0]}")
    remarks: tuple[str, ...] = ()
    if len(triangles) < faces:
        if len(triangles) == 0:
            raise UnreadableError(f"none of its {faces} faces can be read: damaged or not what its name says")
        remarks = (f"{faces - len(triangles)} of {faces} faces are left out: they enclose nothing",)
    return Geometry(vertices, triangles, remarks=remarks)


@contextlib.contextmanager
def _silenced(open3d: ModuleType) -> Iterator[list[str]]:
    """Keeps the readers from writing to the terminal.

    Open3D prints as Python does; the PLY reader under it writes straight to the standard error stream. Both return what
    they had read so far as if nothing had happened.

    Yields:
        a list that holds what they complained of, once the block is left: what says why comes first.
    """
    said: list[str] = []
    sys.stderr.flush()
    kept = os.dup(2)
    printed = io.StringIO()
    with tempfile.TemporaryFile() as scratch:
        os.dup2(scratch.fileno(), 2)
        try:
            with (
                contextlib.redirect_stdout(printed),
                open3d.utility.VerbosityContextManager(open3d.utility.VerbosityLevel.Warning),
            ):
                yield said
        finally:
            os.dup2(kept, 2)
            os.close(kept)
            scratch.seek(0)
            lines = [*scratch.read().decode(errors="replace").splitlines(), *printed.getvalue().splitlines()]
            found = [match[1].strip() for line in lines if (match := _COMPLAINT.match(line))]
            found = [text for text in found if not _NO_COMPLAINT.search(text)]
            said += sorted(found, key=lambda text: _NO_REASON.search(text) is not None)
