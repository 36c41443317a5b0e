"""Where the camera was when it took a frame, over the voxel grid, as plain numbers for the compiled functions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from companion.geometry import camera_to_world
from companion.mapping.voxels.chunks import CHUNK_LIMIT, EDGE
from companion.model import Camera, DepthFrame, Pose


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


def view_of(frame: DepthFrame, voxel_m: float, max_range_m: float) -> tuple[Box, Projection, Rays]:
    """A frame's camera over a grid of ``voxel_m``, up to the nearer of the map's and the camera's range limit.

    Raises:
        ValueError: the pose or the camera has a value that is not finite, or lies outside the grid; it is named.
    """
    pose, camera = frame.pose, frame.camera
    _refuse_not_finite("pose", pose, _POSE_FIELDS)
    _refuse_not_finite("camera", camera, _CAMERA_FIELDS)
    axes, origin = camera_to_world(camera, pose)
    # From here on plain floats: for a handful of numbers numpy takes longer than the image does.
    (ax, ay, az), origin_m = axes.T.tolist(), origin.tolist()
    limit_m = float(min(max_range_m, camera.max_range_m))

    # The ray of pixel (u, v) at depth 1 is base + u per_u + v per_v, in the world.
    per_u = [part / -camera.fx_px for part in ay]
    per_v = [part / -camera.fy_px for part in az]
    base = [
        forward - camera.cx_px * right - camera.cy_px * down
        for forward, right, down in zip(ax, per_u, per_v, strict=True)
    ]
    corners_m = [
        [o + limit_m * (b + u * r + v * d) for o, b, r, d in zip(origin_m, base, per_u, per_v, strict=True)]
        for u in (-0.5, camera.width_px - 0.5)
        for v in (-0.5, camera.height_px - 0.5)
    ]
    along = list(zip(*corners_m, origin_m, strict=True))
    box = box_of([min(part) for part in along], [max(part) for part in along], voxel_m)

    # The camera from the lowest corner of the box, and from the centre of the lowest voxel.
    camera_m = [o - EDGE * voxel_m * low for o, low in zip(origin_m, box[:3], strict=True)]
    centre_m = [0.5 * voxel_m - part for part in camera_m]
    forms: list[float] = []
    for axis, scale in ((ax, 1.0), (ay, -camera.fx_px), (az, -camera.fy_px)):
        offset = sum(part * centre for part, centre in zip(axis, centre_m, strict=True))
        forms += [scale * offset, *(scale * voxel_m * part for part in axis)]
    ends: list[float] = []
    for vector in zip(camera_m, base, per_u, per_v, strict=True):
        ends += [part / voxel_m for part in vector]
    # Plain float and int throughout: for any other kind of number everything would be compiled once more, in flight.
    edges = float(camera.cx_px) + 0.5, float(camera.cy_px) + 0.5
    # A depth of zero is no measurement, whatever the camera's least range is.
    lowest_m = float(max(camera.min_range_m, _LEAST_DEPTH_M))
    projection = Projection._make((*map(float, forms), *edges, int(camera.width_px), int(camera.height_px), limit_m))
    return box, projection, Rays._make((*map(float, ends), lowest_m, limit_m))


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


def box_of(low_m: Sequence[float], high_m: Sequence[float], voxel_m: float) -> Box:
    """The chunks between two corners, in m.

    Raises:
        ValueError: one of them lies outside the grid.
    """
    # One voxel around, so that a reading which rounding puts just outside still has its chunk.
    edge_m = voxel_m * EDGE
    low = [math.floor((part - voxel_m) / edge_m) for part in low_m]
    high = [math.floor((part + voxel_m) / edge_m) for part in high_m]
    if max(map(abs, (*low, *high))) >= CHUNK_LIMIT:
        raise ValueError(
            f"what is seen from {low_m[0]:.0f}, {low_m[1]:.0f}, {low_m[2]:.0f} m is outside the map, which ends "
            f"{CHUNK_LIMIT * edge_m:.0f} m from its origin"
        )
    return Box(low[0], low[1], low[2], high[0] - low[0] + 1, high[1] - low[1] + 1, high[2] - low[2] + 1)
