"""From a depth image to a look ahead: the levelled slab that follows the ground, as HIT, CLEAR and UNKNOWN."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled
from companion.model import CLEAR, HIT, UNKNOWN, DepthFrame, FloatArray
from companion.perception.ground import SECTORS, ground_at, ground_profiles
from companion.perception.look import Look
from companion.perception.view import View

AGREE_M = 0.3
"""A bin is HIT by two points whose ranges differ by no more than this: a single one is a flying pixel."""

SLOPE_LOOK_M = 3.0
"""The slope of the ground ahead is taken over this distance: about where the camera first sees the ground."""

ENDS_SHARE = 0.9
"""Floor and roof end at something where they are seen no further than this share of the range: the rows of an image lie
0.5 m apart on the floor out there."""


@dataclass(frozen=True, slots=True)
class Slab:
    """Which heights about the vehicle count as obstacle, and how steep the ground may be that they follow."""

    half_height_m: float
    max_ground_slope: float


def look_ahead(view: View, frame: DepthFrame, h_m: float, slab: Slab, bins: int) -> tuple[Look, float | None]:
    """What a depth image says about the flying height, and the slope of the ground ahead.

    The slab is as thick as the body plus a margin and lies where the height above the local ground is h (on flat
    ground: the horizontal plane of paper Definition 3.8).

    Args:
        view: the image, levelled.
        frame: the same as it came, with the pose at its exposure.
        h_m: height above ground at that time.
        slab: its thickness and steepest slope.
        bins: bearings of the scan.

    Returns:
        The look, and rise over run of the ground ahead (None where no ground was seen).
    """
    profile, seen = ground_profiles(view, h_m, slab.max_ground_slope)
    ranges, state, covered, inferred = _slab(view, profile, h_m, slab.half_height_m, bins)
    slope: float | None = None
    if seen > 0:
        ahead = 0.5 * sum(ground_at(profile, s, SLOPE_LOOK_M, h_m) for s in (SECTORS // 2 - 1, SECTORS // 2))
        slope = max(-slab.max_ground_slope, min(slab.max_ground_slope, (ahead + h_m) / SLOPE_LOOK_M))
        slope = slope if math.isfinite(slope) else None
    pose = frame.pose
    look = Look(frame.t_s, pose.x_m, pose.y_m, pose.yaw_rad, ranges, state, covered, view.max_range_m, inferred)
    return look, slope


@compiled
def _slab(
    view: View, profile: NDArray[np.float64], h_m: float, half_height_m: float, bins: int
) -> tuple[FloatArray, NDArray[np.uint8], NDArray[np.bool_], NDArray[np.bool_]]:
    """Range, state, cover of each bearing, from the pixels within ``half_height_m`` of h above the ground.

    And whether a HIT is only inferred: most of the level rays had no echo, and floor and roof end out there.
    """
    depth, left, up, to_level, offset_m, min_range_m, max_range_m = view
    height, width = depth.shape
    nearest = np.full(bins, np.inf)
    second = np.full(bins, np.inf)
    level_rays = np.zeros(bins, np.int32)
    level_clear = np.zeros(bins, np.int32)
    level_lost = np.zeros(bins, np.int32)
    scale = bins / (2.0 * np.pi)
    # The highest and lowest middle of the slab, so that most pixels are told apart without looking their ground up.
    highest = half_height_m + max(profile.max() + h_m, 0.0)
    lowest = -half_height_m + min(profile.min() + h_m, 0.0)
    for v in range(height):
        for u in range(width):
            z = depth[v, u]
            dz = to_level[2, 0] + to_level[2, 1] * left[u] + to_level[2, 2] * up[v]
            dx = to_level[0, 0] + to_level[0, 1] * left[u] + to_level[0, 2] * up[v]
            dy = to_level[1, 0] + to_level[1, 1] * left[u] + to_level[1, 2] * up[v]
            at_limit = offset_m[2] + dz / np.sqrt(dx * dx + dy * dy) * max_range_m
            measured = z >= min_range_m and z < max_range_m
            level = lowest <= at_limit <= highest
            inside = measured and lowest <= offset_m[2] + z * dz <= highest
            if not (level or inside):
                continue
            sector = u * SECTORS // width
            if level:
                # Only a ray that stays in the slab out to the range limit can say that the bearing is CLEAR.
                middle = ground_at(profile, sector, max_range_m, h_m) + h_m
                if abs(at_limit - middle) <= half_height_m:
                    b = min(bins - 1, int((np.arctan2(dy, dx) + np.pi) * scale))
                    level_rays[b] += 1
                    level_clear[b] += z >= max_range_m
                    level_lost[b] += not z >= min_range_m
            if not inside:
                continue
            x = offset_m[0] + z * dx
            y = offset_m[1] + z * dy
            distance = np.sqrt(x * x + y * y)
            middle = ground_at(profile, sector, distance, h_m) + h_m
            if abs(offset_m[2] + z * dz - middle) > half_height_m:
                continue
            b = min(bins - 1, int((np.arctan2(y, x) + np.pi) * scale))
            if distance < nearest[b]:
                second[b] = nearest[b]
                nearest[b] = distance
            elif distance < second[b]:
                second[b] = distance
    lost = (2 * level_lost > level_rays) & (nearest == np.inf)
    farthest = _farthest(view, lost) if lost.any() else np.zeros(bins)
    ranges = np.zeros(bins)
    state = np.full(bins, UNKNOWN, np.uint8)
    covered = np.zeros(bins, np.bool_)
    inferred = np.zeros(bins, np.bool_)
    for b in range(bins):
        covered[b] = level_rays[b] > 0 or nearest[b] < np.inf
        if second[b] - nearest[b] <= AGREE_M:
            ranges[b] = nearest[b]
            state[b] = HIT
        elif second[b] < np.inf:
            # The nearest stands alone: a flying pixel before the surface that the next ones agree on.
            ranges[b] = second[b]
            state[b] = HIT
        elif level_rays[b] > 0 and 2 * level_clear[b] >= level_rays[b]:
            ranges[b] = max_range_m
            state[b] = CLEAR
        elif 0.0 < farthest[b] < ENDS_SHARE * max_range_m:
            # A wall that gives no echo stands where floor and roof end before it.
            ranges[b] = farthest[b]
            state[b] = HIT
            inferred[b] = True
    return ranges, state, covered, inferred


@compiled
def _farthest(view: View, wanted: NDArray[np.bool_]) -> FloatArray:
    """The greatest level distance of anything within range above or below, for the bearings that are wanted; else 0."""
    depth, left, up, to_level, offset_m, min_range_m, max_range_m = view
    height, width = depth.shape
    bins = wanted.size
    scale = bins / (2.0 * np.pi)
    found = np.zeros(bins)
    for v in range(height):
        for u in range(width):
            z = depth[v, u]
            if not (z >= min_range_m and z < max_range_m):
                continue
            x = offset_m[0] + z * (to_level[0, 0] + to_level[0, 1] * left[u] + to_level[0, 2] * up[v])
            y = offset_m[1] + z * (to_level[1, 0] + to_level[1, 1] * left[u] + to_level[1, 2] * up[v])
            b = min(bins - 1, int((np.arctan2(y, x) + np.pi) * scale))
            if wanted[b]:
                found[b] = max(found[b], np.sqrt(x * x + y * y))
    return found
