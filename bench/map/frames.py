"""Flights that the benches of the map share: an exact tunnel, worlds of the simulator, and what spoils the images."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from companion.config.mapping import MapSettings
from companion.geometry import camera_to_world, pixel_tangents
from companion.model import Camera, DepthFrame, Pose
from sitl.mines import World, load_world
from sitl.scene.raycast import RayCaster
from sitl.scene.render import DepthRenderer

RANGE_M = 10.0
"""Of the camera and of every map."""

STEP_M, STEP_S = 0.2, 0.2
"""From image to image: 1 m/s, five images a second."""

TUNNEL = "tunnel"
CLEAN, ROUGH = "clean", "rough"
VARIANTS = (CLEAN, "noise", "speckle", "blocks", ROUGH)
"""Exact depth; noise of 0.002 z²; 2 % of the pixels missing; 5 % missing in blocks; all of these together."""

NOISE_PER_M, SPECKLE_SHARE, BLOCK_SHARE, BLOCK_PX = 0.002, 0.02, 0.05, 24

_LOW_M, _HIGH_M = np.array([-5.0, -2.013, -0.017]), np.array([60.0, 1.987, 2.983])
"""Walls, floor and roof lie inside voxels: on the border of two of them rounding would choose."""

_BOXES_M = (
    ((4.03, -2.1, -0.1), (4.83, -1.06, 1.14)),
    ((6.52, 0.87, -0.1), (7.31, 2.1, 0.93)),
    ((8.04, -1.27, -0.1), (8.36, -0.92, 3.1)),
    ((9.57, 0.23, 2.31), (10.46, 2.1, 3.1)),
    ((12.11, -2.1, -0.1), (12.94, -0.34, 0.62)),
)
"""Lowest and highest corner of what stands in the tunnel: blocks, a pillar, something that hangs from the roof."""


def octomap_model(voxel_m: float) -> MapSettings:
    """OctoMap's defaults, so that results compare: nothing else of the sensor is modelled."""
    return MapSettings(
        voxel_m=voxel_m,
        max_range_m=RANGE_M,
        hit_probability=0.7,
        miss_probability=0.4,
        clamp_min_probability=0.1192,
        clamp_max_probability=0.971,
        occupied_probability=0.5,
        depth_noise_per_m=0.0,
        margin_m=0.0,
    )


def camera_of(width_px: int, height_px: int) -> Camera:
    """A camera with 86° x 57°."""
    return Camera(
        width_px=width_px,
        height_px=height_px,
        fx_px=width_px / 2.0 / math.tan(math.radians(43.0)),
        fy_px=height_px / 2.0 / math.tan(math.radians(28.5)),
        cx_px=(width_px - 1) / 2.0,
        cy_px=(height_px - 1) / 2.0,
        min_range_m=0.3,
        max_range_m=RANGE_M,
    )


def rays_of(camera: Camera) -> NDArray[np.float64]:
    """(height, width, 3) of each pixel in the camera's forward-left-up frame, as long as makes the depth 1."""
    left, up = pixel_tangents(camera)
    return np.stack(np.broadcast_arrays(1.0, left[np.newaxis, :], up[:, np.newaxis]), axis=-1)


def flight(place: str, count: int, camera: Camera) -> list[DepthFrame]:
    """``count`` exact images from a flight through the `TUNNEL` or a world that the simulator knows by this name.

    Raises:
        InputError: there is no such world.
    """
    if place != TUNNEL:
        return _world_flight(load_world(place, seed=0), count, camera)
    rays = rays_of(camera)
    return [_tunnel_frame(pose, camera, rays) for pose in _tunnel_poses(count)]


def spoilt(frames: Sequence[DepthFrame], variant: str) -> list[DepthFrame]:
    """The same frames as a camera that is not perfect gives them: one of `VARIANTS`."""
    random = np.random.default_rng(0)
    return [replace(frame, depth_m=_spoilt_depth(frame.depth_m, variant, random)) for frame in frames]


def save(frames: Sequence[DepthFrame], file: Path) -> None:
    """Write frames of one camera for another process."""
    poses = np.array([list(asdict(frame.pose).values()) for frame in frames])
    camera = np.array(list(asdict(frames[0].camera).values()))
    np.savez(file, depth_m=np.stack([frame.depth_m for frame in frames]), poses=poses, camera=camera)


def load(file: Path) -> list[DepthFrame]:
    """What `save` wrote."""
    with np.load(file) as stored:
        depth_m, poses, numbers = stored["depth_m"], stored["poses"].tolist(), stored["camera"].tolist()
    camera = Camera(int(numbers[0]), int(numbers[1]), *numbers[2:])
    return [DepthFrame(pose[0], image, camera, Pose(*pose)) for image, pose in zip(depth_m, poses, strict=True)]


def ends_m(frame: DepthFrame) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(n, 3) where the ray of each pixel that says something ends, at the range limit at most, and where all begin."""
    camera = frame.camera
    axes, origin_m = camera_to_world(camera, frame.pose)
    says = frame.depth_m >= camera.min_range_m
    depth_m = np.minimum(frame.depth_m[says].astype(np.float64), RANGE_M)
    return (rays_of(camera)[says] * depth_m[:, np.newaxis]) @ axes.T + origin_m, origin_m


def hits_of(frame: DepthFrame) -> NDArray[np.bool_]:
    """(n,) whether each of `ends_m` is a surface."""
    says = frame.depth_m >= frame.camera.min_range_m
    return np.asarray(frame.depth_m[says] < RANGE_M)


def _tunnel_poses(count: int) -> list[Pose]:
    """Along the tunnel, swaying and looking left and right."""
    poses: list[Pose] = []
    for number in range(count):
        x_m = STEP_M * number
        y_m, z_m, yaw_rad = 0.4 * math.sin(0.5 * x_m), 1.5 + 0.1 * math.sin(x_m), 0.6 * math.sin(0.8 * x_m)
        roll_rad, pitch_rad = 0.05 * math.sin(1.7 * x_m), 0.08 * math.sin(1.1 * x_m)
        poses.append(Pose(STEP_S * number, x_m, y_m, z_m, yaw_rad, roll_rad, pitch_rad))
    return poses


def _tunnel_frame(pose: Pose, camera: Camera, rays: NDArray[np.float64]) -> DepthFrame:
    axes, origin_m = camera_to_world(camera, pose)
    directions = rays @ axes.T
    with np.errstate(divide="ignore"):
        inverse = 1.0 / directions
    depth_m = np.where(directions > 0.0, (_HIGH_M - origin_m) * inverse, (_LOW_M - origin_m) * inverse).min(axis=-1)
    for low_m, high_m in _BOXES_M:
        one, other = (np.array(low_m) - origin_m) * inverse, (np.array(high_m) - origin_m) * inverse
        enters, leaves = np.minimum(one, other).max(axis=-1), np.maximum(one, other).min(axis=-1)
        depth_m = np.where((enters > 0.0) & (enters < leaves), np.minimum(depth_m, enters), depth_m)
    return DepthFrame(pose.t_s, depth_m.astype(np.float32), camera, pose)


def _world_flight(world: World, count: int, camera: Camera) -> list[DepthFrame]:
    renderer = DepthRenderer(world, camera)
    poses = _world_poses(world, count)
    return [DepthFrame(pose.t_s, renderer.render(pose), camera, pose) for pose in poses]


def _world_poses(world: World, count: int) -> list[Pose]:
    """From the world's start to where there is most room ahead, between floor and roof, turning no faster than it can.

    Nobody controls this flight: it is there to see walls as a flight sees them.
    """
    caster = RayCaster(world)
    if world.start is not None:
        place, yaw_rad = np.array([world.start.x_m, world.start.y_m, world.start.z_m]), world.start.yaw_rad
    else:
        place, yaw_rad = world.start_area_m[0] + np.array([0.0, 0.0, 1.5]), 0.0
    bearings = np.radians(np.arange(-60.0, 61.0, 10.0))
    poses: list[Pose] = []
    for number in range(count):
        sway = 0.4 * math.sin(0.16 * number)
        x_m, y_m, z_m = place.tolist()
        poses.append(Pose(STEP_S * number, x_m, y_m, z_m, yaw_rad + sway, 0.05 * sway, 0.2 * sway))
        towards = yaw_rad + bearings
        level = np.stack([np.cos(towards), np.sin(towards), np.zeros(len(towards))], axis=-1)
        room_m = np.minimum(caster.cast(place, level), 15.0)
        # A bearing has as much room as it and its neighbours; straight on is a little better than a turn.
        score = np.convolve(np.pad(room_m, 1, "edge"), [0.5, 1.0, 0.5], "valid") * np.cos(0.7 * bearings)
        yaw_rad += float(np.clip(bearings[int(np.argmax(score))], -0.1, 0.1))
        below_m, above_m = caster.cast(place, np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]])).tolist()
        height_m = min(1.5, 0.5 * (below_m + above_m))
        climb_m = float(np.clip(height_m - below_m, -0.1, 0.1))
        if room_m[len(bearings) // 2] > 1.5:
            place = place + np.array([STEP_M * math.cos(yaw_rad), STEP_M * math.sin(yaw_rad), climb_m])
    return poses


def _spoilt_depth(depth_m: NDArray[np.float32], variant: str, random: np.random.Generator) -> NDArray[np.float32]:
    made = depth_m.astype(np.float32)
    if variant in ("noise", ROUGH):
        seen = np.isfinite(made)
        made[seen] += (random.normal(size=int(seen.sum())) * NOISE_PER_M * made[seen] ** 2).astype(np.float32)
    if variant in ("speckle", ROUGH):
        made[random.random(made.shape) < SPECKLE_SHARE] = np.nan
    if variant in ("blocks", ROUGH):
        rows, columns = (math.ceil(edge / BLOCK_PX) for edge in made.shape)
        holes = random.random((rows, columns)) < BLOCK_SHARE
        made[holes.repeat(BLOCK_PX, 0).repeat(BLOCK_PX, 1)[: made.shape[0], : made.shape[1]]] = np.nan
    return made
