"""Why two maps of the same images say different things of a voxel: what the frames saw of it, by the images alone."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bench.map import frames as map_frames
from bench.map.octomap import Floats, Integers, packed, voxels_of
from companion.compiled import compiled_unchecked
from companion.geometry import camera_to_world
from companion.model import DepthFrame

NO_BEAM, HIDDEN, BORDER, LIMIT, NO_READING, BESIDE, LAST, BETWEEN, THROUGH = range(9)
REASONS = {
    NO_BEAM: "UNEXPLAINED",
    HIDDEN: "its centre is behind a surface, a beam past the edge touches it",
    BORDER: "its centre is outside the image, a beam touches it",
    LIMIT: "its centre is beyond the range limit, a beam touches it",
    NO_READING: "the pixel at its centre has no reading, one beside it has",
    BESIDE: "a pixel beside the centre's ends in front of it: ours frees less",
    LAST: "looked through, and the limit is in it: OctoMap does not free the last voxel of a ray",
    BETWEEN: "looked through, but pixels are wider than the voxel there: beams may miss it",
    THROUGH: "the centre is looked through",
}


class Observed(NamedTuple):
    """What the frames saw of n voxels.

    Attributes:
        why: (n,) the best of `REASONS` over all frames.
        hits: (n,) the frames with an end in it.
        looks: (n,) the frames that looked through its centre.
        lasts: (n,) those of them in which the range limit was in it.
        slack_m: (n,) how deep inside it the deepest end lies, -inf where there is none.
    """

    why: Integers
    hits: Integers
    looks: Integers
    lasts: Integers
    slack_m: Floats


def observed(voxels: Integers, frames: list[DepthFrame], voxel_m: float) -> Observed:
    """What the frames saw of some voxels (n, 3), worked out for each by itself from the images."""
    why, hits, looks, lasts = (np.zeros(len(voxels), np.int64) for _ in range(4))
    slack_m = np.full(len(voxels), -np.inf)
    if not len(voxels):
        return Observed(why, hits, looks, lasts, slack_m)
    order = np.argsort(packed(voxels))
    keys = packed(voxels)[order]
    for frame in frames:
        axes, origin_m = camera_to_world(frame.camera, frame.pose)
        centres_m = ((voxels + 0.5) * voxel_m - origin_m) @ axes
        camera = frame.camera
        lens = (camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px)
        seen = _seen(frame.depth_m, centres_m, lens, camera.min_range_m, map_frames.RANGE_M, voxel_m)
        why = np.maximum(why, seen)
        looks += seen >= LAST
        lasts += seen == LAST

        points_m = map_frames.ends_m(frame)[0][map_frames.hits_of(frame)]
        ends = voxels_of(points_m, voxel_m)
        at = np.minimum(np.searchsorted(keys, packed(ends)), len(keys) - 1)
        found = keys[at] == packed(ends)
        rows = order[at[found]]
        inside_m = 0.5 * voxel_m - np.abs(points_m[found] - (ends[found] + 0.5) * voxel_m).max(axis=1)
        np.maximum.at(slack_m, rows, inside_m)
        hits[np.unique(rows)] += 1
    return Observed(why, hits, looks, lasts, slack_m)


@compiled_unchecked
def _seen(
    depth_m: NDArray[np.float32],
    centres_m: Floats,
    lens: tuple[float, float, float, float],
    lowest_m: float,
    limit_m: float,
    voxel_m: float,
) -> Integers:
    """One of `REASONS` for each voxel centre (n, 3), in the camera's forward-left-up frame."""
    height, width = depth_m.shape
    fx, fy, cx, cy = lens
    half_m = 0.5 * np.sqrt(3.0) * voxel_m
    why = np.full(len(centres_m), NO_BEAM, np.int64)
    for n in range(len(centres_m)):
        z = centres_m[n, 0]
        if z < -half_m or z > limit_m + half_m:
            continue
        nearest_m = max(z - half_m, 0.01)
        u, v = cx - fx * centres_m[n, 1] / max(z, 0.01), cy - fy * centres_m[n, 2] / max(z, 0.01)
        # Every pixel whose beam can meet the voxel is within this of the pixel at its centre.
        reach = int(1.6 * fx * half_m / nearest_m) + 2
        touched = False
        for row in range(max(int(v) - reach, 0), min(int(v) + reach + 1, height)):
            for column in range(max(int(u) - reach, 0), min(int(u) + reach + 1, width)):
                d = depth_m[row, column]
                if d >= lowest_m and min(d, limit_m) >= z - half_m:
                    # The beam as near to the centre as it gets.
                    y, x = (cx - column) / fx, (cy - row) / fy
                    t = (z + y * centres_m[n, 1] + x * centres_m[n, 2]) / (1.0 + x * x + y * y)
                    t = min(t, d, limit_m)
                    away = (z - t) ** 2 + (centres_m[n, 1] - t * y) ** 2 + (centres_m[n, 2] - t * x) ** 2
                    if away <= half_m**2:
                        touched = True
                        break
            if touched:
                break
        if not touched:
            continue
        column, row = int(np.floor(u + 0.5)), int(np.floor(v + 0.5))
        if z <= 0.0 or column < 0 or row < 0 or column >= width or row >= height:
            why[n] = BORDER
            continue
        d = depth_m[row, column]
        least = np.inf
        for beside in range(max(row - 1, 0), min(row + 2, height)):
            for other in range(max(column - 1, 0), min(column + 2, width)):
                if depth_m[beside, other] >= lowest_m:
                    least = min(least, depth_m[beside, other])
        if not d >= lowest_m:
            why[n] = NO_READING
        elif z >= limit_m:
            why[n] = LIMIT
        elif z >= d:
            why[n] = HIDDEN
        elif z >= least:
            why[n] = BESIDE
        elif z + half_m > limit_m:
            why[n] = LAST
        else:
            # The beam of the pixel at the centre passes it within half a diagonal of the pixel.
            why[n] = BETWEEN if np.sqrt(2.0) * z > voxel_m * min(fx, fy) else THROUGH
    return why
