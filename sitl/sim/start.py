"""Whether a vehicle can be where it is told to start."""

from __future__ import annotations

import numpy as np

from companion.errors import InputError
from companion.model import Pose
from sitl.mines.model import World
from sitl.scene.raycast import RayCaster


def check_start(world: World, caster: RayCaster, pose: Pose, radius_m: float) -> None:
    """Checks that a vehicle of ``radius_m`` fits at ``pose`` and is inside the world.

    Raises:
        InputError: it touches the surface, or there is no floor below or no roof above it.
    """
    where = f"start ({pose.x_m:.2f}, {pose.y_m:.2f}, {pose.z_m:.2f}) in world {world.name}"
    point = np.array([pose.x_m, pose.y_m, pose.z_m])
    down_m, up_m = caster.cast(point, np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]]))
    if not np.isfinite(down_m):
        raise InputError(f"{where}: outside, there is no floor below it")
    if not np.isfinite(up_m):
        raise InputError(f"{where}: outside, there is no roof above it")
    distance_m = float(caster.distance(point[None])[0])
    if distance_m < radius_m:
        raise InputError(f"{where}: the nearest surface is {distance_m:.2f} m away, the vehicle needs {radius_m:.2f} m")
