"""What earlier sorties in the same mine have left to the next one."""

from __future__ import annotations

from dataclasses import dataclass

from companion.control.known_ground import Window
from companion.mapping.voxels.piece import MapSource


@dataclass(frozen=True, slots=True)
class Earlier:
    """The known ground and the map, in the coordinates in which the next vehicle takes itself to be.

    Attributes:
        ground: what has been seen of the plan.
        voxels: the map.
    """

    ground: Window
    voxels: MapSource
