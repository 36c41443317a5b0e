"""The numbers of a plan, and how they follow from the size of the voxels and from what the vehicle can do."""

from __future__ import annotations

import math
from typing import NamedTuple

from companion.mapping.frontiers.frontier import Reach

CELL_M = 0.1
"""Edge of a cell of the plan, or the edge of a voxel where that is more."""

_SURFACE_SHARE = 0.75
"""Floor and roof count where the camera can see them from this share of its range."""

_GAP_M = 0.2
"""So much of which the looks did not decide may lie before a floor or a roof."""

_DROP_M = 1.0
"""How far below where it should be the ground is still looked for."""


class Shape(NamedTuple):
    """The numbers of a plan. Those without a unit are voxels.

    Attributes:
        voxel_mm: edge of a voxel.
        stride: voxels along one edge of a cell.
        height_mm: H.
        most_mm: so much higher or lower than the node before it a node is at most.
        level_mm: nodes of one cell within this height are the same.
        half: what is this much above or below the centre of the vehicle is in its way.
        gap: so many unknown voxels may lie before a floor or a roof.
        below: voxels of a column that are read below the vehicle.
        above: and above it.
        up: the roof counts up to so far above the slab.
        down: the floor counts down to so far below it.
    """

    voxel_mm: float
    stride: int
    height_mm: int
    most_mm: int
    level_mm: int
    half: int
    gap: int
    below: int
    above: int
    up: int
    down: int


def shape_of(voxel_m: float, reach: Reach) -> Shape:
    """The numbers of a plan over voxels with edges of ``voxel_m``, for a vehicle that can do this."""
    stride = max(1, round(CELL_M / voxel_m))
    half = max(1, round(reach.half_slab_m / voxel_m))
    gap = max(1, round(_GAP_M / voxel_m))
    up_m = max(_SURFACE_SHARE * reach.look_m * math.tan(reach.up_rad), 0.0)
    down_m = max(_SURFACE_SHARE * reach.look_m * math.tan(reach.down_rad), 0.0)
    return Shape(
        voxel_mm=1000.0 * voxel_m,
        stride=stride,
        height_mm=round(1000.0 * reach.height_m),
        most_mm=round(1000.0 * reach.max_slope * stride * voxel_m),
        level_mm=round(500.0 * reach.height_m),
        half=half,
        gap=gap,
        below=math.ceil((max(reach.height_m + _DROP_M, down_m) + reach.half_slab_m) / voxel_m),
        above=math.ceil((up_m + reach.half_slab_m) / voxel_m) + gap + 1,
        up=math.floor(up_m / voxel_m) - half + gap,
        down=math.floor(down_m / voxel_m) - half + gap,
    )
