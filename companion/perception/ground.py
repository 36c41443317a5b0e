"""The ground ahead, from a depth image: its height by bearing and distance, so that the scan can follow a slope."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled
from companion.perception.view import View

SECTORS = 12
"""Ground profiles side by side over the image: each is narrow enough for a drift that branches off to have its own."""

STEP_M = 0.5
"""Length of one cell of a profile."""

STEP_TOLERANCE_M = 0.15
"""Height by which a cell may differ from what the slope limit allows: rubble, and the noise of depth at range."""

FIRST_SEEN_MARGIN = 0.02
"""The ground counts as in view when its elevation (a tangent) is this far above the lower edge of the image."""

FOOT_MARGIN = 0.04
"""As long as no ground has been seen, a wall is what reaches down to the lower edge of the image within this elevation:
its foot is below the picture. What hangs above it may be the roof over a ramp that goes down."""

LEVEL_M = 0.25
"""Height of one level of the histogram that tells a wall from the ground in front of it."""

WALL_FROM, WALL_TO = 0.4, 1.1
"""Points between these shares of h above the ground of a cell stand on a wall: ground that can be flown over does not
rise that much within a cell."""

WALL_POINTS = 4
"""As many of them end the ground: beyond a wall there is none, and its upper part must not be taken for a ramp."""


@compiled
def ground_profiles(view: View, h_m: float, max_slope: float) -> tuple[NDArray[np.float64], int]:
    """Ground height relative to the vehicle, by sector of the image and distance.

    Walks outward from the point below the vehicle, where the ground is h below, and accepts the lowest surface of each
    cell as ground when the slope to it is possible. The ground ends at a wall; where the lower edge of the image cuts
    it off, and where nothing is seen, the last known height is kept.

    Args:
        view: the image.
        h_m: height above the ground below the vehicle.
        max_slope: steepest ground, rise over run.

    Returns:
        (SECTORS, cells) heights at distances (cell + 0.5)·STEP_M, and in how many cells ground was really seen in the
        two sectors about the image's middle.
    """
    depth, left, up, to_level, offset_m, min_range_m, max_range_m = view
    height, width = depth.shape
    cells = max(1, int(np.ceil(max_range_m / STEP_M)))
    low = np.full((SECTORS, cells), np.inf)
    low_at = np.zeros((SECTORS, cells))
    second = np.full((SECTORS, cells), np.inf)
    rise_m = max_slope * max_range_m
    levels = int((2.0 * h_m + 2.0 * rise_m) / LEVEL_M) + 1
    points = np.zeros((SECTORS, cells, levels), np.int32)
    for v in range(height):
        for u in range(width):
            z = depth[v, u]
            if not (z >= min_range_m and z < max_range_m):
                continue
            below = offset_m[2] + z * (to_level[2, 0] + to_level[2, 1] * left[u] + to_level[2, 2] * up[v])
            level = int((below + h_m + rise_m) / LEVEL_M)
            if level < 0 or level >= levels:
                continue
            x = offset_m[0] + z * (to_level[0, 0] + to_level[0, 1] * left[u] + to_level[0, 2] * up[v])
            y = offset_m[1] + z * (to_level[1, 0] + to_level[1, 1] * left[u] + to_level[1, 2] * up[v])
            distance = np.sqrt(x * x + y * y)
            cell = int(distance / STEP_M)
            if cell >= cells:
                continue
            sector = u * SECTORS // width
            points[sector, cell, level] += 1
            # The second lowest, so that one stray pixel does not make a hole. Nothing above the vehicle is ground.
            if below > 0.0:
                continue
            if below < low[sector, cell]:
                second[sector, cell] = low[sector, cell]
                low[sector, cell] = below
                low_at[sector, cell] = distance
            elif below < second[sector, cell]:
                second[sector, cell] = below
    profile = np.empty((SECTORS, cells))
    seen_cells = np.zeros(SECTORS, np.int32)
    # The last cell in which ground was seen with no wall standing on it: -1 when there is none.
    last_seen = np.full(SECTORS, -1, np.int32)
    for s in range(SECTORS):
        u = min(width - 1, (2 * s + 1) * width // (2 * SECTORS))
        bx = to_level[0, 0] + to_level[0, 1] * left[u] + to_level[0, 2] * up[height - 1]
        by = to_level[1, 0] + to_level[1, 1] * left[u] + to_level[1, 2] * up[height - 1]
        bz = to_level[2, 0] + to_level[2, 1] * left[u] + to_level[2, 2] * up[height - 1]
        lowest_tangent = bz / max(np.sqrt(bx * bx + by * by), 1e-6)
        known_at, known = 0.0, -h_m
        walled = False
        for c in range(cells):
            at = (c + 0.5) * STEP_M
            profile[s, c] = known
            if walled:
                continue
            in_view = known >= (lowest_tangent + FIRST_SEEN_MARGIN) * at
            if not in_view or second[s, c] == np.inf:
                continue
            accepted = False
            step = low_at[s, c] - known_at
            possible = abs(second[s, c] - known) <= max_slope * step + STEP_TOLERANCE_M
            # Asked of the first ground only: later a grazing ramp may well show in every other cell.
            if possible and (
                known_at > 0.0
                or _line_was_seen(points[s], known, low_at[s, c], second[s, c], lowest_tangent, h_m + rise_m)
            ):
                profile[s, c] = second[s, c]
                # Cells between the last ground and this one lie on the straight line between them.
                first = int(known_at / STEP_M)
                for k in range(first, c):
                    between = ((k + 0.5) * STEP_M - known_at) / max(step, 1e-6)
                    if between > 0.0:
                        profile[s, k] = known + (second[s, c] - known) * between
                known_at, known = low_at[s, c], second[s, c]
                accepted = True
            # Judged from the ground of this very cell: on a ramp that of the last one may lie far below.
            first_level = int((known + WALL_FROM * h_m + h_m + rise_m) / LEVEL_M)
            last_level = int((known + WALL_TO * h_m + h_m + rise_m) / LEVEL_M)
            stands = known_at > 0.0 or second[s, c] <= (lowest_tangent + FOOT_MARGIN) * low_at[s, c]
            walled = stands and points[s, c, max(first_level, 0) : max(last_level, 0)].sum() >= WALL_POINTS
            if accepted and not walled:
                last_seen[s] = c
                seen_cells[s] += 1
    _go_on_as_beside(profile, last_seen)
    return profile, seen_cells[SECTORS // 2 - 1] + seen_cells[SECTORS // 2]


@compiled
def _go_on_as_beside(profile: NDArray[np.float64], last_seen: NDArray[np.int32]) -> None:
    """Beyond the last ground that was seen in a sector it goes on as in the nearest one that saw further.

    Kept level, the slab leaves the ramp that its neighbours follow and meets the roof: a wall beside free space, which
    looks like a tangent in the middle of a straight ramp. And the foot of a wall beside a ramp, where the picture just
    begins, lies as ground at the same distance would: alone it is not taken for any.
    """
    seen = profile.copy()
    cells = profile.shape[1]
    for s in range(SECTORS):
        for c in range(last_seen[s] + 1, cells):
            for off in range(1, SECTORS):
                left, right = s - off, s + off
                if left >= 0 and last_seen[left] >= c:
                    profile[s, c] = seen[left, c]
                    break
                if right < SECTORS and last_seen[right] >= c:
                    profile[s, c] = seen[right, c]
                    break
            else:
                # Nobody saw so far: as it was.
                if c > 0 and last_seen.max() >= 0:
                    profile[s, c] = profile[s, c - 1]


@compiled
def _line_was_seen(
    points: NDArray[np.int32], from_z: float, to_at: float, to_z: float, lowest_tangent: float, floor_of_levels: float
) -> bool:
    """Whether the ground from below the vehicle to the first that is seen shows wherever it would have to be in view.

    The upper part of a wall whose foot is below the picture lies at the slope of a steep ramp too, but then the cells
    on the way to it are empty where the ramp would be.
    """
    for k in range(1, int(to_at / STEP_M)):
        at = (k + 0.5) * STEP_M
        z = from_z + (to_z - from_z) * at / max(to_at, 1e-6)
        if z < (lowest_tangent + FIRST_SEEN_MARGIN) * at:
            continue
        level = int((z + floor_of_levels) / LEVEL_M)
        if points[k, max(level - 1, 0) : level + 2].sum() == 0:
            return False
    return True


@compiled
def ground_at(profile: NDArray[np.float64], sector: int, distance_m: float, h_m: float) -> float:
    """Ground height at a distance: linear between the cells' centres and the point below the vehicle."""
    cells = profile.shape[1]
    place = distance_m / STEP_M - 0.5
    if place <= 0.0:
        share = (place + 0.5) / 0.5
        return float(-h_m + (profile[sector, 0] + h_m) * share)
    cell = int(place)
    if cell >= cells - 1:
        return float(profile[sector, cells - 1])
    share = place - cell
    return float(profile[sector, cell] * (1.0 - share) + profile[sector, cell + 1] * share)
