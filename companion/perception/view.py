"""A depth image with what places its pixels about the vehicle: levelled, and reduced to what a scan can use."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled
from companion.geometry import camera_to_level, pixel_tangents
from companion.model import DepthFrame

POOLED_WIDTH_PX = 160
"""Images wider than twice this are reduced by taking the nearest pixel of each block: the bins are a degree wide, so
finer pixels cost time and tell nothing, and the nearest of a block never overlooks an obstacle."""


class View(NamedTuple):
    """A depth image, and what places its pixels about the vehicle.

    Attributes:
        depth_m: (height, width) along the optical axis, NaN where not measured.
        left: (width,) left component of the pixel rays per unit of depth.
        up: (height,) their up component.
        to_level: (3, 3) rotation from the camera to the levelled body frame.
        offset_m: (3,) position of the camera in that frame.
        min_range_m: depth below this was not measured.
        max_range_m: depth at or beyond this is free space.
    """

    depth_m: NDArray[np.float32]
    left: NDArray[np.float64]
    up: NDArray[np.float64]
    to_level: NDArray[np.float64]
    offset_m: NDArray[np.float64]
    min_range_m: float
    max_range_m: float


LEAST_SHOWN_SHARE = 0.02
"""Of the pixels: an image with fewer measured ones is none. Its lamp has failed, its lens is covered, or all that it
looks at is black; flying on with what is remembered would be flying blind."""


def shows_anything(frame: DepthFrame) -> bool:
    """Whether enough of an image is measured to be a look at all; what is out of range is measured."""
    return float(np.mean(frame.depth_m >= frame.camera.min_range_m)) >= LEAST_SHOWN_SHARE


def view_of(frame: DepthFrame) -> View:
    """The image, levelled by the pose at its exposure."""
    camera = frame.camera
    pool = max(1, camera.width_px // POOLED_WIDTH_PX)
    return View(
        pool_nearest(frame.depth_m, pool),
        *pixel_tangents(camera, pool),
        *camera_to_level(camera, frame.pose),
        camera.min_range_m,
        camera.max_range_m,
    )


def pool_nearest(depth_m: NDArray[np.float32], pool: int) -> NDArray[np.float32]:
    """The nearest measured depth of each pool x pool block; NaN where the whole block is NaN."""
    if pool == 1:
        return depth_m
    return np.asarray(_pool_nearest(depth_m, pool))


@compiled
def _pool_nearest(depth: NDArray[np.float32], pool: int) -> NDArray[np.float32]:
    height, width = depth.shape[0] // pool, depth.shape[1] // pool
    out = np.full((height, width), np.float32(np.inf), np.float32)
    for v in range(height * pool):
        row = out[v // pool]
        for u in range(width * pool):
            z = depth[v, u]
            # A NaN compares false, so it never replaces a measurement.
            if z < row[u // pool]:
                row[u // pool] = z
    for v in range(height):
        for u in range(width):
            if out[v, u] == np.inf:
                block = depth[v * pool : (v + 1) * pool, u * pool : (u + 1) * pool]
                if not np.any(block == np.inf):
                    out[v, u] = np.nan
    return out
