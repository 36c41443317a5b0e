"""Cameras, rooms and maps for the tests of the map, made without the code under test."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from companion.config.mapping import MapSettings
from companion.mapping import MapSnapshot, VoxelMap
from companion.model import Camera, DepthFrame, FloatArray, Pose

EXACT = MapSettings(voxel_m=0.1, max_range_m=5.0, depth_noise_per_m=0.0, occupied_probability=0.5)
"""OctoMap's sensor model for a camera without noise: one hit is enough, and counts the same at every depth."""


def camera(
    width_px: int = 80,
    height_px: int = 60,
    *,
    max_range_m: float = 10.0,
    min_range_m: float = 0.2,
    mount_m: tuple[float, float, float] = (0.0, 0.0, 0.0),
    mount_yaw_rad: float = 0.0,
    mount_pitch_rad: float = 0.0,
) -> Camera:
    """A camera with 90° horizontally, so that fx is half the width."""
    return Camera(
        width_px=width_px,
        height_px=height_px,
        fx_px=width_px / 2,
        fy_px=width_px / 2,
        cx_px=(width_px - 1) / 2,
        cy_px=(height_px - 1) / 2,
        min_range_m=min_range_m,
        max_range_m=max_range_m,
        mount_x_m=mount_m[0],
        mount_y_m=mount_m[1],
        mount_z_m=mount_m[2],
        mount_yaw_rad=mount_yaw_rad,
        mount_pitch_rad=mount_pitch_rad,
    )


def pose(
    x_m: float = 0.0, y_m: float = 0.0, z_m: float = 0.0, *, yaw: float = 0.0, pitch: float = 0.0, roll: float = 0.0
) -> Pose:
    """A pose at time 0; angles in rad."""
    return Pose(t_s=0.0, x_m=x_m, y_m=y_m, z_m=z_m, yaw_rad=yaw, pitch_rad=pitch, roll_rad=roll)


def frame(cam: Camera, at: Pose, depth_m: FloatArray | float) -> DepthFrame:
    """A frame with this depth, (height, width) or the same everywhere."""
    depth = np.broadcast_to(np.asarray(depth_m, np.float32), (cam.height_px, cam.width_px)).copy()
    return DepthFrame(t_s=0.0, depth_m=depth, camera=cam, pose=at)


def one_pixel(cam: Camera, at: Pose, u: int, v: int, depth_m: float) -> DepthFrame:
    """A frame in which only pixel (u, v) measured anything."""
    depth = np.full((cam.height_px, cam.width_px), np.nan)
    depth[v, u] = depth_m
    return frame(cam, at, depth)


def turned(vector: FloatArray, axis: int, angle_rad: float) -> FloatArray:
    """``vector`` (..., 3) turned about one of the axes by the right-hand rule."""
    a, b = (axis + 1) % 3, (axis + 2) % 3
    out = vector.copy()
    out[..., a] = math.cos(angle_rad) * vector[..., a] - math.sin(angle_rad) * vector[..., b]
    out[..., b] = math.sin(angle_rad) * vector[..., a] + math.cos(angle_rad) * vector[..., b]
    return out


def to_world(cam: Camera, at: Pose, points_m: FloatArray) -> FloatArray:
    """Points (..., 3) from the camera's forward-left-up frame to the world, one turn after the other."""
    on_body = turned(turned(points_m, 1, cam.mount_pitch_rad), 2, cam.mount_yaw_rad)
    on_body = on_body + np.array([cam.mount_x_m, cam.mount_y_m, cam.mount_z_m])
    level = turned(turned(on_body, 0, at.roll_rad), 1, at.pitch_rad)
    return np.asarray(turned(level, 2, at.yaw_rad) + np.array([at.x_m, at.y_m, at.z_m]))


def rays(cam: Camera) -> FloatArray:
    """(height, width, 3) the ray of each pixel at depth 1, in the camera's frame."""
    u, v = np.meshgrid(np.arange(cam.width_px), np.arange(cam.height_px))
    return np.stack([np.ones(u.shape), -(u - cam.cx_px) / cam.fx_px, -(v - cam.cy_px) / cam.fy_px], axis=-1)


def room_depth(cam: Camera, at: Pose, low_m: FloatArray, high_m: FloatArray) -> FloatArray:
    """(height, width) exact depth seen from inside a box."""
    origin = to_world(cam, at, np.zeros(3))
    directions = to_world(cam, at, rays(cam)) - origin
    with np.errstate(divide="ignore"):
        ahead: FloatArray = np.where(directions > 0.0, (high_m - origin) / directions, (low_m - origin) / directions)
    # Along the ray at depth 1 the parameter is the depth itself.
    return np.asarray(ahead.min(axis=-1))


def contents(voxels: VoxelMap | MapSnapshot) -> dict[tuple[int, ...], bytes]:
    """The states of a map by chunk: equal if and only if the maps say the same, in whatever order."""
    snapshot = voxels.snapshot() if isinstance(voxels, VoxelMap) else voxels
    return {
        tuple(int(c) for c in chunk): states.tobytes()
        for chunk, states in zip(snapshot.chunks, snapshot.states, strict=True)
        if states.any()
    }


def voxel_numbers(points_m: FloatArray, voxel_m: float) -> NDArray[np.int64]:
    """(n, 3) integer coordinates of the voxels that hold these points."""
    return np.floor(points_m / voxel_m).astype(np.int64)
