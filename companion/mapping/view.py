"""Where the camera was when it took a frame, over the voxel grid, as plain numbers for the compiled functions."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from companion.geometry import camera_to_world
from companion.mapping.chunks import CHUNK_LIMIT, EDGE
from companion.model import Camera, DepthFrame, FloatArray, Pose


class Box(NamedTuple):
    """The chunks around what a camera can see: chunk coordinates of the lowest, and how many along each axis."""

    x: int
    y: int
    z: int
    size_x: int
    size_y: int
    size_z: int


class Projection(NamedTuple):
    """From voxels to pixels.

    The centre of voxel (i, j, k), counted from the lowest voxel of the box, has

        depth = depth_0 + i depth_i + j depth_j + k depth_k    in m
        right = depth (u - cx), linear in the same way          in m px
        down  = depth (v - cy), likewise                        in m px

    so that one division by the depth gives its pixel.

    Attributes:
        edge_u: cx + 1/2, so that the truncated right / depth + edge_u is the pixel's column.
        edge_v: cy + 1/2, for the row.
        width: of the image, in px.
        height: of the image, in px.
        limit_m: nothing is seen at this depth or beyond.
    """

    depth_0: float
    depth_i: float
    depth_j: float
    depth_k: float
    right_0: float
    right_i: float
    right_j: float
    right_k: float
    down_0: float
    down_i: float
    down_j: float
    down_k: float
    edge_u: float
    edge_v: float
    width: int
    height: int
    limit_m: float


class Rays(NamedTuple):
    """From pixels to voxels.

    The reading ``depth`` of pixel (u, v) ends in the box at i = i_0 + depth (i_d + u i_u + v i_v), in voxels from its
    lowest corner, and at j and k in the same way.

    Attributes:
        lowest_m: readings below it say nothing.
        limit_m: readings at or beyond it say "free up to here".
    """

    i_0: float
    i_d: float
    i_u: float
    i_v: float
    j_0: float
    j_d: float
    j_u: float
    j_v: float
    k_0: float
    k_d: float
    k_u: float
    k_v: float
    lowest_m: float
    limit_m: float


@dataclass(frozen=True, slots=True)
class View:
    """One camera position over the voxel grid."""

    box: Box
    projection: Projection
    rays: Rays


def view_of(frame: DepthFrame, voxel_m: float, max_range_m: float) -> View:
    """The view of a frame on a grid of ``voxel_m``, up to the nearer of the map's and the camera's range limit.

    Raises:
        ValueError: the pose or the camera has a value that is not finite, or lies outside the grid; it is named.
    """
    pose, camera = frame.pose, frame.camera
    _refuse_not_finite("pose", pose, _POSE_FIELDS)
    _refuse_not_finite("camera", camera, _CAMERA_FIELDS)
    axes, origin_m = camera_to_world(camera, pose)
    limit_m = float(min(max_range_m, camera.max_range_m))

    # The ray of pixel (u, v) at depth 1 is base + u per_u + v per_v, in the world.
    per_u, per_v = axes[:, 1] / -camera.fx_px, axes[:, 2] / -camera.fy_px
    base = axes[:, 0] - camera.cx_px * per_u - camera.cy_px * per_v
    box = _box_around(origin_m, base, per_u, per_v, camera, limit_m, voxel_m)

    # The camera from the lowest corner of the box, and from the centre of the lowest voxel.
    camera_m = origin_m - np.array([box.x, box.y, box.z]) * (EDGE * voxel_m)
    centre_m = 0.5 * voxel_m - camera_m
    forms: list[float] = []
    for axis, scale in ((axes[:, 0], 1.0), (axes[:, 1], -camera.fx_px), (axes[:, 2], -camera.fy_px)):
        forms += [float(scale * (axis @ centre_m)), *(float(scale * voxel_m * part) for part in axis)]
    ends: list[float] = []
    for axis_number in range(3):
        vectors = (camera_m, base, per_u, per_v)
        ends += [float(vector[axis_number]) / voxel_m for vector in vectors]
    # Plain float and int throughout: for any other kind of number everything would be compiled once more, in flight.
    edges = float(camera.cx_px) + 0.5, float(camera.cy_px) + 0.5
    # A depth of zero is no measurement, whatever the camera's least range is.
    lowest_m = float(max(camera.min_range_m, _LEAST_DEPTH_M))
    return View(
        box=box,
        projection=Projection._make((*forms, *edges, int(camera.width_px), int(camera.height_px), limit_m)),
        rays=Rays._make((*ends, lowest_m, limit_m)),
    )


_LEAST_DEPTH_M = 0.001
_POSE_FIELDS = ("x_m", "y_m", "z_m", "yaw_rad", "pitch_rad", "roll_rad")
_CAMERA_FIELDS = (
    *("fx_px", "fy_px", "cx_px", "cy_px", "min_range_m", "max_range_m"),
    *("mount_x_m", "mount_y_m", "mount_z_m", "mount_yaw_rad", "mount_pitch_rad"),
)


def _refuse_not_finite(name: str, value: Pose | Camera, fields: tuple[str, ...]) -> None:
    for field in fields:
        number = getattr(value, field)
        if not math.isfinite(number):
            raise ValueError(f"{name}.{field} is {number}: it must be finite")


def _box_around(
    origin_m: FloatArray,
    base: FloatArray,
    per_u: FloatArray,
    per_v: FloatArray,
    camera: Camera,
    limit_m: float,
    voxel_m: float,
) -> Box:
    """The chunks around the pyramid from the optical centre to the outer corners of the image at ``limit_m``."""
    corners_m = [
        origin_m + limit_m * (base + u * per_u + v * per_v)
        for u in (-0.5, camera.width_px - 0.5)
        for v in (-0.5, camera.height_px - 0.5)
    ]
    return box_of(np.array([*corners_m, origin_m]), voxel_m)


def box_of(corners_m: FloatArray, voxel_m: float) -> Box:
    """The chunks around points (n, 3), in m.

    Raises:
        ValueError: one of them lies outside the grid.
    """
    # One voxel around, so that a reading which rounding puts just outside still has its chunk.
    low = np.floor((np.min(corners_m, axis=0) - voxel_m) / (voxel_m * EDGE))
    high = np.floor((np.max(corners_m, axis=0) + voxel_m) / (voxel_m * EDGE))
    if max(np.abs(low).max(), np.abs(high).max()) >= CHUNK_LIMIT:
        reach_m = CHUNK_LIMIT * EDGE * voxel_m
        raise ValueError(f"{corners_m[-1]} m is outside the map, which ends {reach_m:.0f} m from its origin")
    sizes = high - low + 1
    return Box(int(low[0]), int(low[1]), int(low[2]), int(sizes[0]), int(sizes[1]), int(sizes[2]))
