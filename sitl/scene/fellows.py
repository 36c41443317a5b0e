"""The other vehicles, as the sensors of one of them see them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from companion.model import Camera, Pose
from sitl.mines.conditions import NONE
from sitl.mines.model import World
from sitl.scene.raycast import RayCaster
from sitl.scene.render import FAR_SHARE, DepthRenderer

Array = NDArray[np.float64]

CORNERS = 12
"""Of the prism that a body is: from any side it is as wide to 2 %."""

FARTHEST_M = 60.0
"""No beam looks further."""


@dataclass(frozen=True, slots=True)
class Body:
    """What of a vehicle may not be touched: an upright cylinder about its middle."""

    radius_m: float
    height_m: float

    def touches(self, one: Pose, other: Pose) -> bool:
        """Whether two of them are where each other's body is."""
        beside_m = math.hypot(one.x_m - other.x_m, one.y_m - other.y_m)
        return beside_m <= 2.0 * self.radius_m and abs(one.z_m - other.z_m) <= self.height_m

    def mesh(self) -> World:
        """The surface, about the origin."""
        angles_rad = np.arange(CORNERS) * 2.0 * math.pi / CORNERS
        rim_m = self.radius_m * np.stack([np.cos(angles_rad), np.sin(angles_rad)], axis=1)
        half_m = self.height_m / 2.0
        rims_m = [np.column_stack([rim_m, np.full(CORNERS, z_m)]) for z_m in (-half_m, half_m)]
        vertices_m = np.vstack([*rims_m, [[0.0, 0.0, -half_m], [0.0, 0.0, half_m]]]).astype(np.float32)
        triangles = []
        for k in range(CORNERS):
            after = (k + 1) % CORNERS
            triangles += [
                (k, after, CORNERS + k),
                (after, CORNERS + after, CORNERS + k),
                (2 * CORNERS, after, k),
                (2 * CORNERS + 1, CORNERS + k, CORNERS + after),
            ]
        return World("", vertices_m, np.array(triangles, np.int32), None, np.empty((0, 3)), "", conditions=NONE)


class Fellows:
    """Where all vehicles of a mine are, and how they look to each other: one body, at as many places.

    Args:
        body: of each.
        camera: of each.
    """

    def __init__(self, body: Body, camera: Camera) -> None:
        self._caster = RayCaster(body.mesh())
        self._renderer = DepthRenderer(body.mesh(), camera)
        self._sight_m = FAR_SHARE * camera.max_range_m * math.hypot(
            1.0, max(camera.cx_px, camera.width_px - camera.cx_px) / camera.fx_px
        ) + max(body.radius_m, body.height_m)
        self._poses: dict[int, Pose] = {}  # may be written by another thread than that which renders

    def restart(self) -> None:
        """Nobody is there."""
        self._poses.clear()

    def look(self, number: int, pose: Pose) -> None:
        """A vehicle truly is there now."""
        self._poses[number] = pose

    def image(self, number: int, pose: Pose, depth_m: NDArray[np.float32]) -> NDArray[np.float32]:
        """The depth image (height, width) of a vehicle, where without the others it would be ``depth_m``."""
        for x_m, y_m, z_m in self._others(number, pose, self._sight_m):
            seen_m = self._renderer.render(replace(pose, x_m=pose.x_m - x_m, y_m=pose.y_m - y_m, z_m=pose.z_m - z_m))
            depth_m = np.fmin(depth_m, seen_m)
        return depth_m

    def ranges(self, number: int, pose: Pose, origins_m: Array, directions: Array, ranges_m: Array) -> Array:
        """Ranges (n,) of a vehicle's beams, where without the others they would be ``ranges_m``."""
        for at_m in self._others(number, pose, FARTHEST_M):
            ranges_m = np.fmin(ranges_m, self._caster.cast(origins_m - np.array(at_m), directions))
        return ranges_m

    def _others(self, number: int, pose: Pose, within_m: float) -> list[tuple[float, float, float]]:
        here = (pose.x_m, pose.y_m, pose.z_m)
        places = [(one.x_m, one.y_m, one.z_m) for other, one in list(self._poses.items()) if other != number]
        return [there for there in places if math.dist(here, there) <= within_m]
