"""Bodies that move in a mine. They only shift, so rays and images are taken from shifted places: nothing is rebuilt."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from companion.model import Camera, Pose
from sitl.mines.conditions import NONE, Mover
from sitl.mines.model import World
from sitl.scene.raycast import RayCaster
from sitl.scene.render import DepthRenderer
from sitl.scene.visibility import horizontal_clearance

Array = NDArray[np.float64]


class Moving:
    """One body, as far as it has gone.

    Args:
        mover: the body.
        camera: takes the images.
    """

    def __init__(self, mover: Mover, camera: Camera) -> None:
        self._mover = mover
        world = World("", mover.vertices_m, mover.triangles, None, np.empty((0, 3)), "", conditions=NONE)
        self._caster = RayCaster(world)
        self._renderer = DepthRenderer(world, camera)
        self._way_m = np.array(mover.way_m)
        self._takes_s = float(np.linalg.norm(self._way_m)) / mover.speed_mps
        self._began_s = np.inf

    def restart(self) -> None:
        """It stands where it first stood."""
        self._began_s = np.inf

    def look(self, pose: Pose) -> None:
        """A vehicle is there now."""
        if pose.t_s < self._began_s and self._mover.trigger.is_met(pose):
            self._began_s = pose.t_s

    def is_moving(self, t_s: float) -> bool:
        """Whether it is on its way, or has just arrived."""
        return self._began_s <= t_s <= self._began_s + self._takes_s + 1.0

    def image(self, pose: Pose) -> NDArray[np.float32]:
        """The depth image of it alone."""
        x_m, y_m, z_m = self._gone_m(np.array([pose.t_s]))[0].tolist()
        return self._renderer.render(replace(pose, x_m=pose.x_m - x_m, y_m=pose.y_m - y_m, z_m=pose.z_m - z_m))

    def cast(self, t_s: float, origins_m: Array, directions: Array) -> NDArray[np.float32]:
        """How far each ray flies before it meets the body, as for `RayCaster.cast`."""
        return self._caster.cast(origins_m - self._gone_m(np.array([t_s])), directions)

    def distance(self, t_s: Array, points_m: Array) -> NDArray[np.float32]:
        """(n,) distances to it of points (n, 3), each at its time (n,)."""
        return self._caster.distance(points_m - self._gone_m(t_s))

    def horizontal_clearance(self, t_s: Array, points_m: Array, half_height_m: float) -> NDArray[np.float32]:
        """(n,) as `horizontal_clearance`, of points (n, 3), each at its time (n,)."""
        return horizontal_clearance(self._caster, points_m - self._gone_m(t_s), half_height_m)

    def _gone_m(self, t_s: Array) -> Array:
        """(n, 3) how far it has gone at times (n,)."""
        share = np.clip((t_s - self._began_s) / self._takes_s, 0.0, 1.0)
        return np.asarray(share[:, None] * self._way_m)
