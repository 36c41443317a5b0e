"""Worlds from files with a surface, or with points of one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from companion.errors import InputError
from sitl.mines.closing import CLOSED_VOXELS, TooManyVoxelsError, closed_surface
from sitl.mines.files import read
from sitl.mines.model import World
from sitl.mines.placing import Placed, Reading, placed
from sitl.mines.start_beside import Start, start_beside, start_pose

LEAST_POINTS = 1_000
"""A cloud of fewer is none of a mine."""

THIN_POINTS = 3.0
"""Where the median voxel holds fewer points than this, the voxels are too small for the cloud."""


def mesh_world(path: Path, start: Start | None, reading: Reading | None = None) -> World:
    """The world in a file: a surface, or points whose surface is closed with voxels.

    Args:
        path: a file with one of `sitl.mines.files.SUFFIXES`.
        start: where the vehicle starts, in the file's unit and from its origin, z up; ``None`` takes it from the JSON
            file beside the mesh.
        reading: unit, axes and voxels, where they are not as the file says.

    Raises:
        InputError: no such file, not one that can be used, no size of a mine, or no start for it.
    """
    reading = Reading() if reading is None else reading
    geometry = read(path)
    if len(geometry.triangles) == 0 and len(geometry.vertices) < LEAST_POINTS:
        raise InputError(
            f"world {path}: holds no triangles ({len(geometry.vertices)} points); a world must be a surface mesh, or a "
            f"cloud of at least {LEAST_POINTS} points"
        )
    x, y, z, yaw_rad = start_beside(path) if start is None else start
    place = placed(path, geometry, reading)
    at = np.array([x, y, z]) * place.scale - place.origin_m
    vertices, triangles, remarks = place.vertices_m, geometry.triangles, [*place.remarks, *geometry.remarks]
    if len(triangles) == 0:
        vertices, triangles, told = _of_cloud(path, place, reading.cloud_voxel_m)
        remarks += told
    elif edges := open_edges(vertices, triangles):
        remarks.append(f"the surface is open: {edges} of its edges have a triangle on one side only")
    return World(
        path.stem,
        np.ascontiguousarray(vertices, dtype=np.float32),
        np.ascontiguousarray(triangles, dtype=np.int32),
        start_pose((float(at[0]), float(at[1]), float(at[2]), yaw_rad)),
        np.empty((0, 3)),
        f"mesh file {path.name}",
        (float(place.origin_m[0]), float(place.origin_m[1]), float(place.origin_m[2])),
        tuple(remarks),
        place.scale,
    )


def _of_cloud(path: Path, place: Placed, voxel_m: float) -> tuple[NDArray[np.float64], NDArray[np.int64], list[str]]:
    try:
        closed = closed_surface(place.vertices_m, voxel_m)
    except TooManyVoxelsError as error:
        raise InputError(
            f"world {path}: with --cloud-voxel {voxel_m:g}: {error}; give larger ones, or cut out a part"
        ) from None
    remarks = [
        f"points without a surface: {closed.voxels} voxels of {voxel_m:g} m hold some, {closed.filled} more are filled "
        f"to close gaps of up to {CLOSED_VOXELS * voxel_m:g} m (--cloud-voxel); walls are up to {voxel_m:g} m nearer"
    ]
    if closed.points_per_voxel < THIN_POINTS:
        remarks.append(
            f"half of the voxels hold {closed.points_per_voxel:g} points or fewer: walls may have holes, larger voxels "
            "close them"
        )
    return closed.vertices_m, closed.triangles, remarks


def open_edges(vertices_m: NDArray[np.float64], triangles: NDArray[np.int64]) -> int:
    """How many edges have an odd number of triangles at them: none where the surface is closed.

    Corners at the same place are one, whatever their number in the file.
    """
    # As bits: -0 and 0 are the same place. Two places or edges get the same number once in 2^64.
    bits = np.ascontiguousarray(vertices_m + 0.0).view(np.uint64)
    places = bits @ np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9], np.uint64)
    places = (places ^ places >> np.uint64(29)) * np.uint64(0xBF58476D1CE4E5B9)
    places ^= places >> np.uint64(32)
    corners = places[triangles]
    edges = np.concatenate([corners[:, k] + corners[:, k - 1] for k in range(3)])
    edges = np.sort(edges[np.concatenate([corners[:, k] != corners[:, k - 1] for k in range(3)])])
    first = np.flatnonzero(np.diff(edges, prepend=edges[:1] + np.uint64(1)))
    return int(np.sum(np.diff(first, append=len(edges)) % 2))
