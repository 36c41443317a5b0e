"""Exact depth images of a few planes, from the conventions of `companion.model` alone and from no code under test.

The planes stand in the world; a vehicle at the origin looks along x. What a test expects of an image can then be
worked out by hand, and an error in the rotations that the code under test uses cannot hide in the picture too.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from companion.config.sensors import CameraSettings
from companion.model import HIT, Camera, DepthFrame, Pose
from companion.perception.look import Look, bin_bearings

Array = NDArray[np.float64]

CAMERA = CameraSettings().model()
"""The default: 86° x 57°, 160 x 120 pixels, 10 m, 10 cm before the middle of the body."""

FINE_CAMERA = CameraSettings(width_px=640, height_px=480).model()

H_M = 1.5
"""Height of the test vehicle above its floor; the floor is at z = 0."""

ROOF_M = 3.0
BINS = 360
AT_START = Pose(0.0, 0.0, 0.0, H_M, 0.0)


@dataclass(frozen=True, slots=True)
class Surface:
    """A plane through a point, or the part of it where ``within`` of its points (..., 3) is true."""

    point_m: tuple[float, float, float]
    normal: tuple[float, float, float]
    within: Callable[[Array], NDArray[np.bool_]] | None = None


FLOOR = Surface((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
ROOF = Surface((0.0, 0.0, ROOF_M), (0.0, 0.0, 1.0))


def wall_ahead(x_m: float) -> Surface:
    """Across the way."""
    return Surface((x_m, 0.0, 0.0), (1.0, 0.0, 0.0))


def wall_beside(y_m: float) -> Surface:
    """Along the way, on the left where ``y_m`` > 0."""
    return Surface((0.0, y_m, 0.0), (0.0, 1.0, 0.0))


def board(x_m: float, y_m: float, width_m: float, low_m: float = -math.inf, high_m: float = math.inf) -> Surface:
    """A thin board across the way, seen from in front: a pole when it is narrow, a beam when it is flat."""

    def within(points_m: Array) -> NDArray[np.bool_]:
        inside: NDArray[np.bool_] = (
            (np.abs(points_m[..., 1] - y_m) <= width_m / 2.0)
            & (points_m[..., 2] >= low_m)
            & (points_m[..., 2] <= high_m)
        )
        return inside

    return Surface((x_m, 0.0, 0.0), (1.0, 0.0, 0.0), within)


def ramp(starts_at_m: float, slope: float, half_width_m: float = 2.0) -> list[Surface]:
    """A drift with level floor and roof up to an x, and from there with both at a slope (rise over run)."""
    surfaces = [wall_beside(half_width_m), wall_beside(-half_width_m)]
    for height_m in (0.0, ROOF_M):
        surfaces.append(
            Surface((0.0, 0.0, height_m), (0.0, 0.0, 1.0), lambda points_m: points_m[..., 0] <= starts_at_m)
        )
        surfaces.append(
            Surface((starts_at_m, 0.0, height_m), (-slope, 0.0, 1.0), lambda points_m: points_m[..., 0] >= starts_at_m)
        )
    return surfaces


def turned(yaw_rad: float, pitch_rad: float, roll_rad: float) -> Array:
    """Rz(yaw) Ry(pitch) Rx(roll), as three elementary rotations multiplied."""
    (cy, cp, cr), (sy, sp, sr) = np.cos([yaw_rad, pitch_rad, roll_rad]), np.sin([yaw_rad, pitch_rad, roll_rad])
    about_z = np.array([[cy, -sy, 0.0], [sy, cy, 0.0], [0.0, 0.0, 1.0]])
    about_y = np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    product: Array = about_z @ about_y @ about_x
    return product


def render(surfaces: Iterable[Surface], camera: Camera, pose: Pose) -> NDArray[np.float32]:
    """The (height, width) depth along the optical axis; inf where nothing is, NaN nearer than the camera measures."""
    u, v = np.meshgrid(np.arange(camera.width_px), np.arange(camera.height_px))
    rays = np.stack([np.ones(u.shape), -(u - camera.cx_px) / camera.fx_px, -(v - camera.cy_px) / camera.fy_px], axis=-1)
    body = turned(pose.yaw_rad, pose.pitch_rad, pose.roll_rad)
    eye = np.array([pose.x_m, pose.y_m, pose.z_m]) + body @ [camera.mount_x_m, camera.mount_y_m, camera.mount_z_m]
    ways = rays @ (body @ turned(camera.mount_yaw_rad, camera.mount_pitch_rad, 0.0)).T
    depth = np.full(u.shape, np.inf)
    for surface in surfaces:
        normal = np.array(surface.normal)
        towards = ways @ normal
        with np.errstate(divide="ignore", invalid="ignore"):
            z = normal @ (np.array(surface.point_m) - eye) / towards
            met = np.isfinite(z) & (z > 0.0) & (z < depth)
        if surface.within is not None:
            met &= surface.within(eye + np.where(met, z, 1.0)[..., None] * ways)
        depth[met] = z[met]
    depth[depth < camera.min_range_m] = np.nan
    return depth.astype(np.float32)


def frame(surfaces: Iterable[Surface], pose: Pose = AT_START, camera: Camera = CAMERA) -> DepthFrame:
    """The image that the camera takes of the surfaces, with the pose it is taken from."""
    return DepthFrame(pose.t_s, render(surfaces, camera, pose), camera, pose)


def tilted(pitch_deg: float, roll_deg: float) -> Pose:
    """At the start, with the nose down by ``pitch_deg`` and the left side up by ``roll_deg``."""
    return replace(AT_START, pitch_rad=math.radians(pitch_deg), roll_rad=math.radians(roll_deg))


def between(low_deg: float, high_deg: float) -> NDArray[np.bool_]:
    """The bins of a scan whose middles lie between two bearings."""
    bearings_deg = np.degrees(bin_bearings(BINS))
    inside: NDArray[np.bool_] = (bearings_deg > low_deg) & (bearings_deg < high_deg)
    return inside


def hit_points(look: Look) -> Array:
    """The (n, 2) obstacles of a look, forward and left of the vehicle, in m."""
    hit = look.state == HIT
    bearing, r = bin_bearings(look.state.size)[hit], look.ranges_m[hit]
    return np.column_stack([r * np.cos(bearing), r * np.sin(bearing)])
