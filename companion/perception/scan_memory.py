"""The scan memory: obstacle points of the last metres, so that the wall beside the vehicle is known as a curve.

Between the edge of the camera's view and the side beams nobody looks, and a corner that is being rounded lies there.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled
from companion.model import ABSURD, HIT, UNKNOWN, FloatArray, Pose, Scan

CELL_M = 0.1
"""One point a cell is kept, the newest: the memory is bounded however long the flight."""

CELLS = 128
"""Cells along each side of the grid, which wraps round: 12.8 m, so points within 6.4 m of the vehicle fit."""

RECENT_S = 3.0
"""What was seen in the last seconds is where it was seen, even by a position that drifts."""

SEEN_THROUGH_M, SEEN_THROUGH_PER_M = 0.04, 0.004
"""A remembered point is dropped when a fresh look at its bearing sees further than it by more than
SEEN_THROUGH_M + SEEN_THROUGH_PER_M · range²: the noise of a stereo camera grows with the square of the range. Without
this the nearest of many noisy points would make every wall thicker with each look."""


class ScanMemory:
    """Points in the odometry's frame, expired by age and distance.

    Args:
        max_age_s: age at which a point expires; 0 remembers nothing.
        max_distance_m: distance from the vehicle at which it expires, at most half the grid.
    """

    def __init__(self, max_age_s: float, max_distance_m: float) -> None:
        self._max_age_s = max_age_s
        self._max_distance_m = min(max_distance_m, CELLS * CELL_M / 2.0)
        self._points = np.zeros((CELLS, CELLS, 2))
        self._seen_s = np.full((CELLS, CELLS), -np.inf)

    def remember(self, pose: Pose, bearings_rad: FloatArray, ranges_m: FloatArray, t_s: float) -> None:
        """Add obstacle points given in polar coordinates about a pose."""
        if self._max_age_s > 0.0:
            _remember(
                self._points,
                self._seen_s,
                pose.x_m,
                pose.y_m,
                pose.yaw_rad,
                bearings_rad,
                ranges_m,
                t_s,
                self._max_distance_m,
            )

    def recall(self, scan: Scan, pose: Pose, t_s: float) -> FloatArray:
        """Fill the bearings of ``scan`` of which nothing was learnt just now with remembered points, in place.

        Returns:
            (n,) the nearest point of the last `RECENT_S` at each bearing; infinite where there is none.
        """
        return _recall(
            self._points,
            self._seen_s,
            scan,
            pose.x_m,
            pose.y_m,
            pose.yaw_rad,
            t_s,
            self._max_age_s,
            self._max_distance_m,
        )


@compiled
def _remember(
    points: NDArray[np.float64],
    seen: NDArray[np.float64],
    x_m: float,
    y_m: float,
    yaw_rad: float,
    bearings: FloatArray,
    ranges: FloatArray,
    t_s: float,
    max_distance_m: float,
) -> None:
    for i in range(bearings.size):
        if not ranges[i] <= max_distance_m:
            continue
        x = x_m + ranges[i] * np.cos(yaw_rad + bearings[i])
        y = y_m + ranges[i] * np.sin(yaw_rad + bearings[i])
        # A reading taken while the pose was no number has no place; kept, its NaN would become an index.
        if not (abs(x) < ABSURD and abs(y) < ABSURD):
            continue
        row = int(np.floor(y / CELL_M)) % CELLS
        column = int(np.floor(x / CELL_M)) % CELLS
        points[row, column, 0] = x
        points[row, column, 1] = y
        seen[row, column] = t_s


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
    seen: NDArray[np.float64],
    scan: Scan,
    x_m: float,
    y_m: float,
    yaw_rad: float,
    t_s: float,
    max_age_s: float,
    max_distance_m: float,
) -> FloatArray:
    _, ranges, state, fresh = scan
    bins = ranges.size
    recent = np.full(bins, np.inf)
    scale = bins / (2.0 * np.pi)
    # What was looked at, before anything that is remembered is put into it.
    looked, looked_state, looked_at = ranges.copy(), state.copy(), fresh.copy()
    for row in range(CELLS):
        for column in range(CELLS):
            age = t_s - seen[row, column]
            if age > max_age_s:
                continue
            dx = points[row, column, 0] - x_m
            dy = points[row, column, 1] - y_m
            distance = np.sqrt(dx * dx + dy * dy)
            if distance > max_distance_m:
                seen[row, column] = -np.inf
                continue
            bearing = (np.arctan2(dy, dx) - yaw_rad + np.pi) % (2.0 * np.pi)
            b = min(bins - 1, int(bearing * scale))
            if looked_at[b] and looked_state[b] != UNKNOWN:
                if _is_seen_through(distance, _looked_range(looked, looked_state, looked_at, b)):
                    seen[row, column] = -np.inf
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
