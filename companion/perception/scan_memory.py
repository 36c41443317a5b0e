"""The scan memory: rock of the last metres, in space, so that the wall beside the vehicle is known as a curve.

Between the edge of the camera's view and the side beams nobody looks, and a corner that is being rounded lies there.
Points are kept at every height that the camera sees: the vehicle climbs and sinks within the time that they count, and
rock that lay below it is beside it then.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled
from companion.model import ABSURD, HIT, UNKNOWN, FloatArray, Pose, Scan
from companion.perception.view import View

CELL_M, LEVEL_M = 0.1, 0.2
"""One point a cell is kept, the newest: the memory is bounded however long the flight."""

CELLS, LEVELS = 128, 32
"""Cells along each side of the grid and upward. It wraps round: what is within 6.4 m of the vehicle fits."""

REACH_S = 1.0
"""A vehicle that climbs or sinks is as high as that wherever it gets to within this time."""

RECENT_S = 3.0
"""What was seen in the last seconds is where it was seen, even by a position that drifts."""

AGAIN_S, ONCE_S = 0.5, 3.0
"""Rock that two images within the first of these times have shown is remembered; what one alone has shown may be dust
or spray, and is gone after the second: the vehicle has braked for it by then, and looked again."""

SEEN_THROUGH_M, SEEN_THROUGH_PER_M = 0.04, 0.004
"""A remembered point is dropped when a fresh look at its bearing sees further than it by more than
SEEN_THROUGH_M + SEEN_THROUGH_PER_M · range²: the noise of a stereo camera grows with the square of the range. Without
this the nearest of many noisy points would make every wall thicker with each look."""


class ScanMemory:
    """Points in the odometry's frame, expired by age and distance.

    Args:
        max_age_s: age at which a point expires; 0 remembers nothing.
        max_distance_m: distance from the vehicle in the plane at which it expires, at most half the grid.
        half_height_m: points so much above or below the vehicle are in its way.
    """

    def __init__(self, max_age_s: float, max_distance_m: float, half_height_m: float) -> None:
        self._max_age_s = max_age_s
        self._max_distance_m = min(max_distance_m, CELLS * CELL_M / 2.0)
        self._bounds = self._max_age_s, self._max_distance_m
        self._half_height_m = half_height_m
        self._points = np.zeros((LEVELS, CELLS, CELLS, 4))  # x, y, lowest and highest z
        self._seen_s = np.full((LEVELS, CELLS, CELLS), -np.inf)
        self._sure = np.zeros((LEVELS, CELLS, CELLS), np.bool_)
        self._once_s = np.full((LEVELS, CELLS, CELLS), -np.inf)

    def remember(
        self, pose: Pose, bearings_rad: FloatArray, ranges_m: FloatArray, t_s: float, sure: bool = True
    ) -> None:
        """Add obstacle points at the vehicle's own height, given in polar coordinates about a pose.

        Those that are not sure are gone after `ONCE_S`.
        """
        if self._max_age_s > 0.0 and pose.is_finite:
            where = pose.x_m, pose.y_m, pose.z_m, pose.yaw_rad
            marks = self._seen_s, self._sure
            _remember(self._points, marks, where, bearings_rad, ranges_m, t_s, self._bounds, sure)

    def remember_view(self, view: View, pose: Pose, look_m: float, t_s: float) -> None:
        """Add what a depth image shows nearer than ``look_m``, at whatever height.

        A cell counts from its second pixel on: a single one is a flying pixel. It is sure from its second image on.
        """
        if self._max_age_s > 0.0 and pose.is_finite:
            where = pose.x_m, pose.y_m, pose.z_m, pose.yaw_rad
            reach_m = min(look_m, self._max_distance_m)
            marks = self._seen_s, self._sure, self._once_s
            _remember_view(self._points, marks, where, view, t_s, (self._max_age_s, reach_m))

    def recall(self, scan: Scan, pose: Pose, t_s: float) -> FloatArray:
        """Fill the bearings of ``scan`` of which nothing was learnt just now with remembered points, in place.

        Of those at the heights where the vehicle is, and gets to within `REACH_S`.

        Returns:
            (n,) the nearest point of the last `RECENT_S` at each bearing; infinite where there is none.
        """
        # A height beyond all whole numbers made the loop over the levels endless.
        climb_m = pose.vz_mps * REACH_S if abs(pose.vz_mps) < ABSURD else 0.0
        low_m = pose.z_m - self._half_height_m + min(0.0, climb_m)
        high_m = pose.z_m + self._half_height_m + max(0.0, climb_m)
        return np.asarray(
            _recall(
                self._points,
                (self._seen_s, self._sure),
                scan,
                (pose.x_m, pose.y_m, pose.yaw_rad),
                (low_m, high_m),
                t_s,
                self._bounds,
            )
        )

    def above_and_below(self, pose: Pose, radius_m: float, ahead_m: float, t_s: float) -> tuple[float, float]:
        """Free height up to the lowest rock, and down to the highest, over what the body flies over and under.

        Args:
            pose: where it is.
            radius_m: of the body, with what it is to be clear of.
            ahead_m: so far along the heading it may get until it stands.
            t_s: now.

        Returns:
            Both from the middle of the body; infinite where nothing is known.
        """
        if not pose.is_finite:
            return math.inf, math.inf
        up_m, down_m = _above_and_below(
            self._points,
            (self._seen_s, self._sure),
            (pose.x_m, pose.y_m, pose.z_m, pose.yaw_rad),
            (radius_m, max(0.0, ahead_m), self._half_height_m),
            (t_s - self._max_age_s, t_s - min(self._max_age_s, ONCE_S)),
        )
        return float(up_m), float(down_m)


@compiled
def _cell(x_m: float, y_m: float, z_m: float) -> tuple[int, int, int]:
    return (
        int(np.floor(z_m / LEVEL_M)) % LEVELS,
        int(np.floor(y_m / CELL_M)) % CELLS,
        int(np.floor(x_m / CELL_M)) % CELLS,
    )


@compiled
def _remember(
    points: NDArray[np.float64],
    marks: tuple[NDArray[np.float64], NDArray[np.bool_]],
    where: tuple[float, float, float, float],
    bearings: FloatArray,
    ranges: FloatArray,
    t_s: float,
    bounds: tuple[float, float],
    sure: bool,
) -> None:
    seen, known = marks
    max_age_s, max_distance_m = bounds
    x_m, y_m, z_m, yaw_rad = where
    for i in range(bearings.size):
        if not ranges[i] <= max_distance_m:
            continue
        x = x_m + ranges[i] * np.cos(yaw_rad + bearings[i])
        y = y_m + ranges[i] * np.sin(yaw_rad + bearings[i])
        # A reading taken while the pose was no number has no place; kept, its NaN would become an index.
        if not (abs(x) < ABSURD and abs(y) < ABSURD):
            continue
        cell = _cell(x, y, z_m)
        points[cell][0], points[cell][1], points[cell][2], points[cell][3] = x, y, z_m, z_m
        known[cell] = sure or (known[cell] and t_s - seen[cell] <= max_age_s)
        seen[cell] = t_s


@compiled
def _remember_view(
    points: NDArray[np.float64],
    marks: tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.float64]],
    where: tuple[float, float, float, float],
    view: View,
    t_s: float,
    bounds: tuple[float, float],
) -> None:
    seen, known, once = marks
    max_age_s, max_distance_m = bounds
    depth, left, up, to_level, offset_m, min_range_m, max_range_m = view
    x_m, y_m, z_m, yaw_rad = where
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    for v in range(depth.shape[0]):
        for u in range(depth.shape[1]):
            far = depth[v, u]
            if not (far >= min_range_m and far < max_range_m):
                continue
            ahead = offset_m[0] + far * (to_level[0, 0] + to_level[0, 1] * left[u] + to_level[0, 2] * up[v])
            beside = offset_m[1] + far * (to_level[1, 0] + to_level[1, 1] * left[u] + to_level[1, 2] * up[v])
            if ahead * ahead + beside * beside > max_distance_m * max_distance_m:
                continue
            x = x_m + ahead * cos - beside * sin
            y = y_m + ahead * sin + beside * cos
            z = z_m + offset_m[2] + far * (to_level[2, 0] + to_level[2, 1] * left[u] + to_level[2, 2] * up[v])
            if not (abs(x) < ABSURD and abs(y) < ABSURD and abs(z) < ABSURD):
                continue
            cell = _cell(x, y, z)
            point = points[cell]
            if once[cell] == t_s:
                point[0], point[1], point[2], point[3] = x, y, min(point[2], z), max(point[3], z)
                if seen[cell] != t_s:
                    age = t_s - seen[cell]
                    known[cell] = age <= AGAIN_S or (known[cell] and age <= max_age_s)
                    seen[cell] = t_s
            elif seen[cell] != t_s:
                # What is known of the cell stays until there is a second pixel, but for its height.
                point[2], point[3] = z, z
            once[cell] = t_s


@compiled
def _is_seen_through(distance_m: float, range_m: float) -> bool:
    """Whether a look that reached so far went through a point at that distance."""
    return distance_m < range_m - SEEN_THROUGH_M - SEEN_THROUGH_PER_M * range_m * range_m


@compiled
def _looked_range(ranges: FloatArray, state: NDArray[np.uint8], fresh: NDArray[np.bool_], b: int) -> float:
    """How far the look saw at a bearing and both beside it; 0 where it did not look at one of them.

    Poses are known to a fraction of a degree: a thin pillar falls into one bearing now and into the next one then.
    """
    least = np.inf
    for step in (-1, 0, 1):
        i = (b + step) % ranges.size
        if not fresh[i] or state[i] == UNKNOWN:
            return 0.0
        least = min(least, ranges[i])
    return least


@compiled
def _recall(
    points: NDArray[np.float64],
    marks: tuple[NDArray[np.float64], NDArray[np.bool_]],
    scan: Scan,
    where: tuple[float, float, float],
    heights: tuple[float, float],
    t_s: float,
    bounds: tuple[float, float],
) -> FloatArray:
    _, ranges, state, fresh = scan
    seen, known = marks
    x_m, y_m, yaw_rad = where
    low_m, high_m = heights
    max_age_s, max_distance_m = bounds
    bins = ranges.size
    recent = np.full(bins, np.inf)
    scale = bins / (2.0 * np.pi)
    # What was looked at, before anything that is remembered is put into it.
    looked, looked_state, looked_at = ranges.copy(), state.copy(), fresh.copy()
    first = int(np.floor(low_m / LEVEL_M))
    last = min(int(np.floor(high_m / LEVEL_M)), first + LEVELS - 1)
    for step in range(first, last + 1):
        level = step % LEVELS
        for row in range(CELLS):
            for column in range(CELLS):
                age = t_s - seen[level, row, column]
                if age > max_age_s or (age > ONCE_S and not known[level, row, column]):
                    continue
                dx = points[level, row, column, 0] - x_m
                dy = points[level, row, column, 1] - y_m
                distance = np.sqrt(dx * dx + dy * dy)
                if distance > max_distance_m:
                    seen[level, row, column] = -np.inf
                    continue
                if points[level, row, column, 2] > high_m or points[level, row, column, 3] < low_m:
                    continue
                bearing = (np.arctan2(dy, dx) - yaw_rad + np.pi) % (2.0 * np.pi)
                b = min(bins - 1, int(bearing * scale))
                if looked_at[b] and looked_state[b] != UNKNOWN:
                    if _is_seen_through(distance, _looked_range(looked, looked_state, looked_at, b)):
                        seen[level, row, column] = -np.inf
                        continue
                    if not _is_seen_through(distance, looked[b]):
                        continue
                if age <= RECENT_S:
                    recent[b] = min(recent[b], distance)
                if state[b] != HIT or distance < ranges[b]:
                    ranges[b] = distance
                    state[b] = HIT
                    fresh[b] = False
    return recent


@compiled
def _above_and_below(
    points: NDArray[np.float64],
    marks: tuple[NDArray[np.float64], NDArray[np.bool_]],
    where: tuple[float, float, float, float],
    swept: tuple[float, float, float],
    since: tuple[float, float],
) -> tuple[float, float]:
    seen, known = marks
    since_s, once_since_s = since
    x_m, y_m, z_m, yaw_rad = where
    radius_m, ahead_m, half_height_m = swept
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    up, down = np.inf, np.inf
    reach = min(int(np.ceil((radius_m + ahead_m) / CELL_M)) + 1, CELLS // 2 - 1)
    column_0, row_0 = int(np.floor(x_m / CELL_M)), int(np.floor(y_m / CELL_M))
    for level in range(LEVELS):
        for row in range(row_0 - reach, row_0 + reach + 1):
            for column in range(column_0 - reach, column_0 + reach + 1):
                cell = level, row % CELLS, column % CELLS
                if not seen[cell] >= (since_s if known[cell] else once_since_s):
                    continue
                point = points[cell]
                dx, dy = point[0] - x_m, point[1] - y_m
                along, beside = dx * cos + dy * sin, dy * cos - dx * sin
                off = along - min(max(along, 0.0), ahead_m)
                if off * off + beside * beside > radius_m * radius_m:
                    continue
                # What is at the height of the body is in its way, and not below or above it.
                if point[2] > z_m + half_height_m:
                    up = min(up, point[2] - z_m)
                elif point[3] < z_m - half_height_m:
                    down = min(down, z_m - point[3])
    return up, down
