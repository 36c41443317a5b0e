"""Worlds from mesh files, and what can be wrong with those."""

from __future__ import annotations

import contextlib
import json
import math
import os
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import numpy as np

from companion.errors import InputError
from companion.model import Pose
from sitl.mines.model import World

SUFFIXES = (".ply", ".stl", ".obj", ".off", ".glb")
"""The mesh formats that are read."""

_Z_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
_COMPLAINT = "RPly:"

Start = tuple[float, float, float, float]
"""x, y, z in m and yaw in rad."""


def mesh_world(path: Path, start: Start | None) -> World:
    """The world in a mesh file: metres, z up (GLB, whose standard is y up, is turned).

    Args:
        path: a file with one of `SUFFIXES`.
        start: where the vehicle starts; ``None`` takes it from the JSON file beside the mesh, key ``start`` with ``x``,
            ``y``, ``z`` and ``yaw``.

    Raises:
        InputError: no such file, not a mesh that can be used, or no start for it.
    """
    if not path.is_file():
        raise InputError(f"world {path}: there is no such file")
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"world {path}: not a mesh file that can be read; give one of {', '.join(SUFFIXES)}")
    where = start if start is not None else _start_beside(path)

    import open3d  # takes 3 s: only those wait who read meshes

    with _silenced(open3d) as said:
        mesh = open3d.io.read_triangle_mesh(path)
    vertices, triangles = np.asarray(mesh.vertices), np.asarray(mesh.triangles)
    if said:
        raise InputError(f"world {path}: the file is damaged or not what its name says: {said[0]}")
    if len(vertices) == 0:
        raise InputError(f"world {path}: no mesh can be read: empty, damaged or not what its name says")
    if len(triangles) == 0:
        raise InputError(f"world {path}: holds no triangles ({len(vertices)} points); a world must be a surface mesh")
    if triangles.min() < 0 or triangles.max() >= len(vertices):
        raise InputError(f"world {path}: a triangle names vertex {triangles.max()} of only {len(vertices)}")
    broken = np.flatnonzero(~np.isfinite(vertices).all(axis=1))
    if len(broken) > 0:
        raise InputError(
            f"world {path}: {len(broken)} of {len(vertices)} vertices are not finite, the first is number {broken[0]}"
        )
    if path.suffix.lower() == ".glb":
        vertices = vertices @ _Z_UP.T
    return World(
        path.stem,
        np.ascontiguousarray(vertices, dtype=np.float32),
        np.ascontiguousarray(triangles, dtype=np.int32),
        start_pose(where),
        np.empty((0, 3)),
        f"mesh file {path.name}",
    )


def start_pose(start: Start) -> Pose:
    """The pose at rest at ``start``.

    Raises:
        InputError: a number is not finite.
    """
    if not all(map(math.isfinite, start)):
        raise InputError(f"start {start}: x, y, z and yaw must be finite numbers")
    x_m, y_m, z_m, yaw_rad = start
    return Pose(t_s=0.0, x_m=x_m, y_m=y_m, z_m=z_m, yaw_rad=yaw_rad)


def _start_beside(path: Path) -> Start:
    """The start that the JSON file beside a mesh names."""
    beside = path.with_suffix(".json")
    if not beside.is_file():
        raise InputError(
            f"world {path}: where does the vehicle start? Give a start (x, y, z in m, yaw in rad), or put it into "
            f'{beside.name} beside the mesh: {{"start": {{"x": 0, "y": 0, "z": 1.5, "yaw": 0}}}}'
        )
    try:
        start = json.loads(beside.read_text(encoding="utf-8"))["start"]
        return float(start["x"]), float(start["y"]), float(start["z"]), float(start["yaw"])
    except (ValueError, OSError) as error:
        raise InputError(f"start in {beside}: cannot be read: {error}") from error
    except (KeyError, TypeError) as error:
        raise InputError(
            f'start in {beside}: expected {{"start": {{"x": m, "y": m, "z": m, "yaw": rad}}}}, all numbers'
        ) from error


@contextlib.contextmanager
def _silenced(open3d: ModuleType) -> Iterator[list[str]]:
    """Keeps the mesh readers from writing to the terminal.

    Open3D has its own level of verbosity; the PLY reader under it writes straight to the standard error stream, and
    returns what it had read so far as if nothing had happened.

    Yields:
        a list that holds what the PLY reader complained of, once the block is left.
    """
    said: list[str] = []
    sys.stderr.flush()
    kept = os.dup(2)
    with tempfile.TemporaryFile() as scratch:
        os.dup2(scratch.fileno(), 2)
        try:
            with open3d.utility.VerbosityContextManager(open3d.utility.VerbosityLevel.Error):
                yield said
        finally:
            os.dup2(kept, 2)
            os.close(kept)
            scratch.seek(0)
            lines = scratch.read().decode(errors="replace").splitlines()
            said += [line.removeprefix(_COMPLAINT).strip() for line in lines if line.startswith(_COMPLAINT)]
