"""What is around the simulated vehicle: the ground that it stands on, and how far the nearest surface is."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:  # level ground needs no worlds, which take a second to import
    from sitl.scene.raycast import RayCaster


@dataclass(frozen=True, slots=True)
class Surroundings:
    """The world as the vehicle's body meets it.

    Attributes:
        ground_z_m: (x, y, z) -> height at which the vehicle stands when it comes down from that point, in the world
            frame; NaN or infinite where there is no ground.
        clearance_m: (x, y, z) -> distance to the nearest surface, or ``None`` where nothing can be touched.
        body_radius_m: within this of a surface the vehicle touches it.
    """

    ground_z_m: Callable[[float, float, float], float]
    clearance_m: Callable[[float, float, float], float] | None = None
    body_radius_m: float = 0.3


def flat(ground_z_m: float) -> Surroundings:
    """Level ground without end, and nothing else."""
    return Surroundings(lambda _x, _y, _z: ground_z_m)


def inside(caster: RayCaster, body_radius_m: float, stand_m: float) -> Surroundings:
    """The mine that ``caster`` knows, for a body whose middle is ``stand_m`` above the floor when it stands."""
    down = np.array([[0.0, 0.0, -1.0]])

    def ground_z_m(x_m: float, y_m: float, z_m: float) -> float:
        # From a little above: the vehicle may stand on the surface, or a hair below it.
        above_m = z_m + 0.2
        range_m = float(caster.cast(np.array([x_m, y_m, above_m]), down)[0])
        return above_m - range_m + stand_m if math.isfinite(range_m) else math.nan

    def clearance_m(x_m: float, y_m: float, z_m: float) -> float:
        return float(caster.distance(np.array([[x_m, y_m, z_m]]))[0])

    return Surroundings(ground_z_m, clearance_m, body_radius_m)
