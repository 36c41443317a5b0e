"""Compile everything that a flight needs, into numba's cache: nothing may compile when it should fly.

Flies a small cross of tunnels, computed right here, with the code of the vehicle alone: neither Open3D nor `sitl` is
needed. The flight is no test of anything; it only passes through every compiled function with the types that a real
one has. `scripts/check-docker --run` looks whether one was left out.

    NUMBA_CACHE_DIR=/some/where python -m companion.flight.warm_up
"""

from __future__ import annotations

import math
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from companion.config.load import load_settings
from companion.config.settings import Settings
from companion.control.decisions import Choice
from companion.control.dogleg import dogleg
from companion.control.edges import Edge, corridor_is_free, lies_along_boundary, open_direction
from companion.control.informed import WallFollowing, find_ways
from companion.control.known_ground import KnownGround, Place
from companion.control.narrow import width_m
from companion.control.sharing import Frame, Sharing
from companion.geometry import pixel_tangents, rotation
from companion.mapping import VoxelMap
from companion.mapping.files import write_map
from companion.mapping.frontiers.frontier import Reach
from companion.mapping.frontiers.surveyor import survey
from companion.mapping.process.server import compile_ahead
from companion.model import (
    BEAM_AXES,
    Camera,
    DepthFrame,
    Measurement,
    Observation,
    Pose,
    RangeReading,
    Setpoint,
    wrap_rad,
)
from companion.pipeline import Explorer, Order

FLIGHT_S = 150.0
WARM_S = 2.0
HOMING_S = 1.0
LARGE_PX = (640, 480)  # larger images are reduced first, which is one more compiled function
FLOOR_M, ROOF_M = 0.0, 3.0

# Corners of a cross, counter-clockwise: arms 4 m wide that reach 12 m to each side.
CORNERS = (
    (2, -12), (2, -2), (12, -2), (12, 2), (2, 2), (2, 12), (-2, 12), (-2, 2), (-12, 2), (-12, -2), (-2, -2), (-2, -12),
)  # fmt: skip
Floats = NDArray[np.float64]


def distances_m(origin_m: Floats, directions: Floats) -> Floats:
    """(n,) how far it is from a point inside along each of ``directions`` (n, 3), in lengths of the direction."""
    starts = np.array(CORNERS, np.float64)
    along = np.roll(starts, -1, axis=0) - starts
    to_start = starts - origin_m[:2]
    with np.errstate(divide="ignore", invalid="ignore"):
        across = directions[:, None, 0] * along[:, 1] - directions[:, None, 1] * along[:, 0]
        t = (to_start[:, 0] * along[:, 1] - to_start[:, 1] * along[:, 0]) / across
        share = (to_start[:, 0] * directions[:, None, 1] - to_start[:, 1] * directions[:, None, 0]) / across
        walls = np.where((t > 0.0) & (share >= 0.0) & (share <= 1.0), t, np.inf).min(axis=1)
        planes = np.where(directions[:, 2] > 0.0, ROOF_M - origin_m[2], FLOOR_M - origin_m[2]) / directions[:, 2]
    return np.asarray(np.fmin(walls, np.where(np.isfinite(planes), planes, np.inf)), np.float64)


class Eyes:
    """What the camera and the beams of the vehicle see in the cross."""

    def __init__(self, settings: Settings) -> None:
        self._beams = settings.sensors.beams
        self._camera = settings.sensors.camera.model()
        self._rays = pixel_rays(self._camera)

    def frame(self, pose: Pose, read_only: bool) -> DepthFrame:
        """A depth image. Those that came over a socket are read-only, which numba compiles anew."""
        camera = self._camera
        turned = rotation(pose.yaw_rad, pose.pitch_rad, pose.roll_rad)
        depth_m = distances_m(place(pose), self._rays @ turned.T).astype(np.float32)
        depth_m[depth_m < camera.min_range_m] = np.nan
        depth_m = depth_m.reshape(camera.height_px, camera.width_px)
        depth_m.setflags(write=not read_only)
        return DepthFrame(pose.t_s, depth_m, camera, pose)

    def ranges(self, pose: Pose) -> tuple[RangeReading, ...]:
        """One reading of each beam."""
        axes = np.array([BEAM_AXES[beam] for beam in self._beams.directions])
        ranges_m = distances_m(place(pose), axes @ rotation(pose.yaw_rad, 0.0, 0.0).T)
        limit_m = self._beams.max_range_m
        return tuple(
            RangeReading(beam, pose.t_s, min(float(range_m), limit_m), limit_m)
            for beam, range_m in zip(self._beams.directions, ranges_m, strict=True)
        )


def pixel_rays(camera: Camera) -> Floats:
    """(n, 3) the ray of each pixel in the body's frame, as long as its depth along the optical axis is 1."""
    left, up = np.meshgrid(*pixel_tangents(camera))
    return np.stack([np.ones_like(left), left, up], axis=-1).reshape(-1, 3)


def place(pose: Pose) -> Floats:
    """(3,) where the vehicle is."""
    return np.array([pose.x_m, pose.y_m, pose.z_m])


def moved(pose: Pose, setpoint: Setpoint, dt_s: float) -> Pose:
    """Where an ideal vehicle is one sampling period later."""
    vx_mps, vy_mps = setpoint.speed_mps * math.cos(pose.yaw_rad), setpoint.speed_mps * math.sin(pose.yaw_rad)
    return Pose(
        t_s=pose.t_s + dt_s,
        x_m=pose.x_m + vx_mps * dt_s,
        y_m=pose.y_m + vy_mps * dt_s,
        z_m=min(max(pose.z_m + setpoint.climb_mps * dt_s, FLOOR_M + 0.5), ROOF_M - 0.5),
        yaw_rad=wrap_rad(pose.yaw_rad + setpoint.yaw_rate_radps * dt_s),
        vx_mps=vx_mps,
        vy_mps=vy_mps,
        vz_mps=setpoint.climb_mps,
        yaw_rate_radps=setpoint.yaw_rate_radps,
    )


def with_large_images(settings: Settings) -> Settings:
    """The same with a camera of `LARGE_PX`."""
    camera = settings.sensors.camera.model_copy(update={"width_px": LARGE_PX[0], "height_px": LARGE_PX[1]})
    return settings.model_copy(update={"sensors": settings.sensors.model_copy(update={"camera": camera})})


def fly(settings: Settings, flight_s: float) -> tuple[VoxelMap, Floats]:
    """The map that a flight through the cross makes, and (n, 3) where the images were taken."""
    explorer = Explorer(settings, np.random.default_rng(1))
    voxels = VoxelMap(settings.mapping)
    eyes = Eyes(settings)
    period_s = settings.control.period_s
    ticks_per_frame = max(1, round(1.0 / (settings.sensors.camera.rate_hz * period_s)))
    flown = []
    pose = Pose(0.0, -8.0, 0.3, settings.control.height_m, 0.2)
    for tick in range(round(flight_s / period_s)):
        frame = eyes.frame(pose, read_only=tick % (2 * ticks_per_frame) == 0) if tick % ticks_per_frame == 0 else None
        steering = explorer.step(Observation(pose.t_s, pose, frame, eyes.ranges(pose)))
        if frame is not None:
            voxels.integrate(frame)
            flown.append(place(pose))
        if tick == 0:
            _decide(steering.measurement, pose, settings)
        pose = moved(pose, steering.setpoint, period_s)
    come_home(explorer, eyes, pose, period_s)
    return voxels, np.array(flown)


def come_home(explorer: Explorer, eyes: Eyes, pose: Pose, period_s: float) -> int:
    """Ask how far home is and begin to fly there; how often the vehicle recognised where it is."""
    navigator = explorer.navigator
    for _ in range(round(HOMING_S / period_s)):
        steering = explorer.step(
            Observation(pose.t_s, pose, eyes.frame(pose, read_only=False), eyes.ranges(pose)), Order.HOME
        )
        navigator.way_home(steering.measurement, pose)
        pose = moved(pose, steering.setpoint, period_s)
    return navigator.homing.matches


def _decide(measurement: Measurement, pose: Pose, settings: Settings) -> None:
    """What the law asks at tangents, at walls and in dead ends: whether a short flight meets any is left to chance."""
    scan = measurement.scan
    if scan is None:
        return
    margin_m, critical_margin_m = settings.control.margin_m, settings.control.critical_margin_m
    edge = Edge(0.1, 4.0, 0.3, 4.1, -1)
    corridor_is_free(scan, edge.target_bearing_rad, edge.target_range_m, margin_m)
    lies_along_boundary(scan, edge, margin_m)
    open_direction(scan, critical_margin_m)
    width_m(scan, 1, settings.control)
    dogleg(scan, edge.target_bearing_rad, edge.target_range_m, critical_margin_m)
    ground = KnownGround()
    for x_m in (-8.0, -6.0, -4.0, -2.0):
        ground.see(measurement, replace(pose, x_m=x_m))
    here = Place(-4.0, 0.0, 0.0)
    ground.block(here)
    ground.give_up(here, 1.0)
    other = KnownGround()
    other.see(measurement, pose)
    choice = Choice(settings.control, other)
    news = Sharing(1, Frame(), ground, choice).news()
    if news is not None:
        Sharing(2, Frame(), other, choice).learn(news)
    ways = find_ways(ground, here)
    if ways is not None:
        ways.way(here, 0.0, 1.0)
        ways.along_m(WallFollowing(here, 0.0, 1))


def warm_up(settings: Settings) -> None:
    """Load or compile what a tick needs, with these settings' images.

    Seconds when it is in the cache, else about a minute; in flight it would be a minute without a setpoint.
    """
    fly(settings, WARM_S)


def reach(settings: Settings) -> Reach:
    """Where the vehicle can be, as the process of the map is told."""
    scan = settings.sensors.scan
    camera = settings.sensors.camera.model()
    return Reach.of(settings.mapping, camera, settings.control, settings.half_slab_m, scan.max_ground_slope)


def main() -> None:
    """Fly, then do with the map what is done with one."""
    settings = load_settings(None, "flight")
    fly(with_large_images(settings), flight_s=1.0)
    voxels, flown_m = fly(settings, FLIGHT_S)
    compile_ahead(settings.mapping, (settings.sensors.camera.model(),), reach(settings))
    survey(voxels.snapshot(), flown_m, reach(settings))
    points_m = voxels.occupied()
    voxels.free()
    voxels.counts()
    voxels.classify(points_m)
    voxels.occupied_near(points_m)
    other = VoxelMap(settings.mapping)
    other.merge(voxels)
    with tempfile.TemporaryDirectory() as folder:
        write_map(voxels, Path(folder))


if __name__ == "__main__":
    main()
