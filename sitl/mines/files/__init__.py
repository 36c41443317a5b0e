"""Files with the surface of a mine, as programs write them: one module for each kind of reader."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from companion.errors import InputError
from sitl.mines.files.collada import read_collada
from sitl.mines.files.geometry import Geometry, UnreadableError
from sitl.mines.files.gltf import read_gltf
from sitl.mines.files.obj import read_obj
from sitl.mines.files.off import read_off
from sitl.mines.files.points import read_points
from sitl.mines.files.stl import read_stl
from sitl.mines.files.through_open3d import read_ply

_READERS: dict[str, Callable[[Path], Geometry]] = {
    ".ply": read_ply,
    ".stl": read_stl,
    ".obj": read_obj,
    ".off": read_off,
    ".glb": read_gltf,
    ".gltf": read_gltf,
    ".dae": read_collada,
    ".pcd": read_points,
    ".las": read_points,
    ".laz": read_points,
}

SUFFIXES = tuple(_READERS)
"""The formats that are read; PCD, LAS and LAZ, and PLY without faces, are clouds of points."""


def read(path: Path) -> Geometry:
    """What a file holds: finite vertices, and triangles that name only them.

    Raises:
        InputError: no such file, not one that can be used, or nothing in it.
    """
    if not path.is_file():
        raise InputError(f"world {path}: there is no such file")
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"world {path}: not a mesh file that can be read; give one of {', '.join(SUFFIXES)}")
    try:
        geometry = _READERS[path.suffix.lower()](path)
    except UnreadableError as error:
        raise InputError(f"world {path}: {error}") from error
    except MemoryError:
        raise InputError(f"world {path}: too large for the memory of this computer") from None
    if len(geometry.triangles) == 0:
        geometry = _of_points(geometry)
    _check(path, geometry)
    return geometry


def _of_points(cloud: Geometry) -> Geometry:
    """A cloud without the points that have no place: scanners write what did not come back as NaN."""
    finite = np.isfinite(cloud.vertices).all(axis=1)
    if finite.all():
        return cloud
    told = f"{np.sum(~finite)} points without finite coordinates are left out"
    return replace(cloud, vertices=cloud.vertices[finite], remarks=(*cloud.remarks, told))


def _check(path: Path, geometry: Geometry) -> None:
    vertices, triangles = geometry.vertices, geometry.triangles
    if len(vertices) == 0:
        raise InputError(f"world {path}: no mesh can be read: empty, damaged or not what its name says")
    if len(triangles) > 0 and (triangles.min() < 0 or triangles.max() >= len(vertices)):
        wrong = triangles.min() if triangles.min() < 0 else triangles.max()
        raise InputError(f"world {path}: a triangle names vertex {wrong} of only {len(vertices)}")
    broken = np.flatnonzero(~np.isfinite(vertices).all(axis=1))
    if len(broken) > 0:
        raise InputError(
            f"world {path}: {len(broken)} of {len(vertices)} vertices are not finite, the first is number {broken[0]}"
        )


__all__ = ["SUFFIXES", "Geometry", "read"]
