"""The map against two slow references: marching along each ray, and looking at each voxel's whole neighbourhood."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from companion.config.mapping import MapSettings
from companion.mapping import OCCUPIED, VoxelMap
from companion.model import Camera, FloatArray, Pose
from tests.mapping.voxels.scenes import camera, frame, pose, rays, room_depth, to_world, turned, voxel_numbers

VOXEL_M, LIMIT_M = 0.2, 4.0
ROUNDED_VOXELS = 4.0 * float(np.spacing(np.float32(128.0)))
"""What 32 bits leave open in an end point: it is counted from the corner of the view, which is 20 voxels of range each
way and up to a chunk more, fewer than 128 in all, and is rounded four times."""
NEAR_M = ROUNDED_VOXELS * VOXEL_M
SETTINGS = MapSettings(voxel_m=VOXEL_M, max_range_m=LIMIT_M, depth_noise_per_m=0.0, occupied_probability=0.5)
"""At 4 m a pixel is 4 / 40 = 0.1 m wide, so its ray passes any point that it stands for within 0.071 m: less than the
0.1 m from a voxel's centre to its sides. So a ray enters each voxel whose centre lies in its pixel."""

LOW, HIGH = np.array([-2.13, -1.57, -0.91]), np.array([3.29, 1.83, 1.17])

angle = st.floats(-math.pi, math.pi)
poses = st.builds(
    lambda x, y, z, yaw, pitch, roll: pose(x, y, z, yaw=yaw, pitch=pitch, roll=roll),
    st.floats(-1.5, 2.5),
    st.floats(-1.0, 1.2),
    st.floats(-0.5, 0.8),
    angle,
    angle,
    angle,
)
dropouts = st.sampled_from([0.0, 0.02, 0.5])


def _scene(at: Pose, share: float) -> tuple[Camera, FloatArray]:
    """A room with a ball in it, and a share of the pixels without a reading."""
    cam = camera(80, 60, mount_m=(0.1, 0.0, -0.05), mount_yaw_rad=0.3, mount_pitch_rad=0.2)
    depth = room_depth(cam, at, LOW, HIGH)
    origin = to_world(cam, at, np.zeros(3))
    directions = to_world(cam, at, rays(cam)) - origin
    to_ball = np.array([0.9, 0.5, 0.1]) - origin
    a, b = (directions**2).sum(axis=-1), directions @ to_ball
    root = b**2 - a * (to_ball @ to_ball - 0.35**2)
    with np.errstate(invalid="ignore"):
        ball = (b - np.sqrt(root)) / a
    depth = np.where((root > 0.0) & (ball > 0.0), np.minimum(depth, ball), depth)
    depth[np.random.default_rng(0).random(depth.shape) < share] = np.nan
    return cam, depth.astype(np.float32)


def _looked_through(cam: Camera, at: Pose, depth: FloatArray) -> set[tuple[int, ...]]:
    """All voxels that some ray enters before it ends, in steps of a tenth of a voxel."""
    said = depth >= cam.min_range_m
    steps = np.arange(0.0, LIMIT_M, VOXEL_M / 10)
    passed = steps < np.minimum(depth[said], LIMIT_M)[:, np.newaxis]
    points = (rays(cam)[said][:, np.newaxis] * steps[np.newaxis, :, np.newaxis])[passed]
    return _set(voxel_numbers(to_world(cam, at, points), VOXEL_M))


def _set(numbers: NDArray[np.int64]) -> set[tuple[int, ...]]:
    """Voxels as a set. One number for each makes them much faster to tell apart."""
    _, first = np.unique(numbers @ np.array([1, 1000, 1000_000]), return_index=True)
    return set(map(tuple, numbers[first].tolist()))


@settings(max_examples=10, deadline=None)
@given(poses, dropouts)
def test_free_is_only_what_a_ray_passed(at: Pose, share: float) -> None:
    """Protects "free never where nothing looked", behind surfaces above all, for any pose and with dropouts."""
    cam, depth = _scene(at, share)
    voxels = VoxelMap(SETTINGS)
    voxels.integrate(frame(cam, at, depth))
    free = _set(voxel_numbers(voxels.free(), VOXEL_M))
    assert free <= _looked_through(cam, at, depth)


@settings(max_examples=40, deadline=None)
@given(poses, dropouts)
def test_occupied_is_exactly_where_rays_end(at: Pose, share: float) -> None:
    """Protects completeness: each end point marks its voxel, and nothing else is marked."""
    cam, depth = _scene(at, share)
    voxels = VoxelMap(SETTINGS)
    voxels.integrate(frame(cam, at, depth))
    ended = (depth >= cam.min_range_m) & (depth < LIMIT_M)
    ends = to_world(cam, at, rays(cam)[ended] * depth[ended][:, np.newaxis].astype(np.float64))
    # The map computes end points with 32 bits: one that is nearer to a border than that rounds may be on either side.
    inside = np.abs(ends / VOXEL_M - np.round(ends / VOXEL_M)).min(axis=1) > ROUNDED_VOXELS
    assert (voxels.classify(ends[inside]) == OCCUPIED).all()
    marked = _set(voxel_numbers(voxels.occupied(), VOXEL_M))
    around = _set(np.concatenate([voxel_numbers(ends + d, VOXEL_M) for d in (-NEAR_M, NEAR_M)]))
    assert marked <= around


@settings(max_examples=40, deadline=None)
@given(poses, dropouts)
def test_free_is_exactly_what_the_pixels_around_saw_past(at: Pose, share: float) -> None:
    """Protects the early decisions about whole blocks: they must be the same as looking at every voxel.

    Each voxel centre is projected, and compared with the least reading among the nine pixels around; where the pixel
    itself says nothing and the one above or below does, only as far as that one's ray passes through the voxel.
    """
    cam, depth = _scene(at, share)
    voxels = VoxelMap(SETTINGS)
    voxels.integrate(frame(cam, at, depth))
    marked = _set(voxel_numbers(voxels.occupied(), VOXEL_M))
    free = _set(voxel_numbers(voxels.free(), VOXEL_M))

    # All voxels of the closed room and two around it: nothing outside can have been seen.
    bounds = zip(voxel_numbers(LOW, VOXEL_M) - 2, voxel_numbers(HIGH, VOXEL_M) + 3, strict=True)
    numbers = np.stack(np.meshgrid(*[np.arange(*bound) for bound in bounds], indexing="ij"), axis=-1).reshape(-1, 3)
    points = _to_camera(cam, at, (numbers + 0.5) * VOXEL_M)
    points, numbers = points[points[:, 0] > 1e-6], numbers[points[:, 0] > 1e-6]
    forward = points[:, 0]
    u = cam.cx_px - cam.fx_px * points[:, 1] / forward
    v = cam.cy_px - cam.fy_px * points[:, 2] / forward
    column, row = np.floor(u + 0.5).astype(int), np.floor(v + 0.5).astype(int)
    in_image = (column >= 0) & (row >= 0) & (column < cam.width_px) & (row < cam.height_px)
    readings = np.where(depth >= cam.min_range_m, np.minimum(depth, LIMIT_M), np.inf)
    padded = np.pad(readings, 1, constant_values=np.inf)
    least = np.min([padded[i : i + 60, j : j + 80] for i in range(3) for j in range(3)], axis=0)
    beside = np.isfinite(np.minimum(padded[:-2, 1:-1], padded[2:, 1:-1]))
    hole_m = VOXEL_M / 2 * cam.fx_px / math.sqrt(2.5)
    clear = np.where(np.isfinite(readings), least, np.where(beside, np.minimum(least, hole_m), 0.0))
    seen = np.zeros(len(numbers))
    seen[in_image] = clear[row[in_image], column[in_image]]

    # Rounding may decide otherwise within 1e-6 of a pixel's border or of the reading.
    at_border = np.minimum(np.abs(u - 0.5 - np.round(u - 0.5)), np.abs(v - 0.5 - np.round(v - 0.5))) < 1e-6
    surely = (forward < seen - 1e-6) & ~at_border
    perhaps = (forward < seen + 1e-6) | at_border
    assert _set(numbers[surely]) - marked <= free
    assert free <= _set(numbers[perhaps])


def _to_camera(cam: Camera, at: Pose, points_m: FloatArray) -> FloatArray:
    """The inverse of `to_world`."""
    level = turned(points_m - np.array([at.x_m, at.y_m, at.z_m]), 2, -at.yaw_rad)
    on_body = turned(turned(level, 1, -at.pitch_rad), 0, -at.roll_rad)
    on_body = on_body - np.array([cam.mount_x_m, cam.mount_y_m, cam.mount_z_m])
    return turned(turned(on_body, 2, -cam.mount_yaw_rad), 1, -cam.mount_pitch_rad)
