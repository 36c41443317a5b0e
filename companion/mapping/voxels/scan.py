"""A planar scanner's turn: which voxels its beams passed through, and in which they ended."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled, compiled_unchecked
from companion.geometry import rotation
from companion.mapping.voxels.chunk_table import Table, find_row, has_room, keep_row, load_brick, next_row, store_brick
from companion.mapping.voxels.chunks import BRICK, MASK, SHIFT, WORDS, place_of
from companion.mapping.voxels.marks import doubled
from companion.mapping.voxels.sensor_model import CHANGED, HITS, LOWERED, Steps, compared, lower, raise_, spread
from companion.mapping.voxels.view import Box, box_of
from companion.model import FloatArray, PlanarScan


class Beams(NamedTuple):
    """The beams of one turn that said something, in voxels from the lowest corner of a box.

    Attributes:
        start: (3,) where the scanner is.
        directions: (n, 3) unit vectors.
        lengths: (n,) how far each saw.
        hits: (n,) bool, whether it ended at a surface.
    """

    start: FloatArray
    directions: FloatArray
    lengths: FloatArray
    hits: NDArray[np.bool_]


class Passed(NamedTuple):
    """The voxels that the beams of one turn met.

    Attributes:
        slots: (chunks of the box,) int32 in (x, y, z) C order, row of each below, -1 where no beam came.
        hits: (n, 64) uint64, one bit for each voxel of a chunk in which a beam ended.
        seen: (n, 64) uint64, the same for voxels that a beam passed through.
    """

    slots: NDArray[np.int32]
    hits: NDArray[np.uint64]
    seen: NDArray[np.uint64]


def beams_of(scan: PlanarScan, voxel_m: float, max_range_m: float) -> tuple[Box, Beams]:
    """The beams of a scan on a grid of ``voxel_m``, up to the nearer of the map's and the scanner's range limit.

    Raises:
        ValueError: the pose or a bearing is not finite, or lies outside the grid; bearings and ranges differ in number.
    """
    pose = scan.pose
    if not pose.is_finite:
        raise ValueError(f"the pose of the scan has a value that is not finite: {pose}")
    bearings, ranges_m = np.asarray(scan.bearings_rad, np.float64), np.asarray(scan.ranges_m, np.float64)
    if bearings.ndim != 1 or bearings.shape != ranges_m.shape:
        raise ValueError(f"bearings have the shape {bearings.shape}, ranges {ranges_m.shape}: one of each for a beam")
    if not np.all(np.isfinite(bearings)):
        raise ValueError("a bearing of the scan is not finite")
    limit_m = min(max_range_m, float(scan.max_range_m))
    said = ranges_m > 0.0  # NaN is not
    lengths_m = np.minimum(ranges_m[said], limit_m)
    level = np.stack([np.cos(bearings[said]), np.sin(bearings[said]), np.zeros(len(lengths_m))], axis=1)
    directions = level @ rotation(pose.yaw_rad, pose.pitch_rad, pose.roll_rad).T
    origin_m = np.array([pose.x_m, pose.y_m, pose.z_m])
    ends_m = origin_m + directions * lengths_m[:, np.newaxis]
    corners_m = np.vstack([ends_m, origin_m])
    box = box_of(corners_m.min(axis=0).tolist(), corners_m.max(axis=0).tolist(), voxel_m)
    start = origin_m / voxel_m - np.array([box.x, box.y, box.z]) * (MASK + 1)
    return box, Beams(start, directions, lengths_m / voxel_m, ranges_m[said] < limit_m)


@compiled_unchecked
def pass_beams(beams: Beams, box: Box) -> Passed:
    """Follow each beam from voxel to voxel (Amanatides and Woo 1987)."""
    chunks = box.size_x * box.size_y * box.size_z
    slots = np.full(chunks, -1, np.int32)
    hits, seen = np.zeros((16, WORDS), np.uint64), np.zeros((16, WORDS), np.uint64)
    used = 0
    at, step, last = np.empty(3, np.int64), np.empty(3, np.int64), np.empty(3, np.int64)
    next_t, per_voxel = np.empty(3), np.empty(3)
    for number in range(beams.lengths.shape[0]):
        length = beams.lengths[number]
        for axis in range(3):
            position, direction = beams.start[axis], beams.directions[number, axis]
            at[axis] = math.floor(position)
            last[axis] = math.floor(position + length * direction)
            step[axis] = 1 if direction > 0.0 else -1
            border = at[axis] + (1 if direction > 0.0 else 0)
            still = direction == 0.0
            next_t[axis] = math.inf if still else (border - position) / direction
            per_voxel[axis] = math.inf if still else abs(1.0 / direction)
        # So many borders lie between the two ends, whatever rounding does to the order in which they are met.
        borders = abs(last[0] - at[0]) + abs(last[1] - at[1]) + abs(last[2] - at[2])
        for border in range(borders + 1):
            chunk = ((at[0] >> SHIFT) * box.size_y + (at[1] >> SHIFT)) * box.size_z + (at[2] >> SHIFT)
            slot = slots[chunk]
            if slot < 0:
                slot, used = np.int32(used), used + 1
                slots[chunk] = slot
                if used > hits.shape[0]:
                    hits, seen = doubled(hits), doubled(seen)
            place = place_of(at[0] & MASK, at[1] & MASK, at[2] & MASK)
            bit = np.uint64(1) << np.uint64(place & 63)
            if border < borders:
                seen[slot, place >> 6] |= bit
            elif beams.hits[number]:
                hits[slot, place >> 6] |= bit
            # The axis whose border comes next, among those that have not arrived.
            axis, least = 0, math.inf
            for candidate in range(3):
                if at[candidate] != last[candidate] and next_t[candidate] <= least:
                    axis, least = candidate, next_t[candidate]
            at[axis] += step[axis]
            next_t[axis] += per_voxel[axis]
    return Passed(slots, hits, seen)


@compiled
def update_passed(
    table: Table, box: Box, start: int, passed: Passed, steps: Steps, revision: int, counts: NDArray[np.int64]
) -> int:
    """Put what the beams met into the chunks of the box from number ``start`` on, as far as there is room.

    A hit counts in full at every range: a scanner's noise does not grow as a camera's does.

    Returns:
        The number of the chunk that did not find room, or the number of chunks when all are done.
    """
    seen, hits = np.zeros(BRICK, np.int16), np.zeros(BRICK, np.int16)
    old, new = np.zeros(BRICK, np.int16), np.zeros(BRICK, np.int16)
    gains = np.full(BRICK, steps.hits[0], np.int16)
    codes, voxels, spare, used = table.codes, table.voxels, table.spare, table.used
    miss, lowest, highest = np.int16(steps.miss), np.int16(steps.lowest), np.int16(steps.highest)
    for number in range(start, passed.slots.shape[0]):
        slot = passed.slots[number]
        if slot < 0:
            continue
        if not has_room(table):
            return number
        a, b, c = number // (box.size_y * box.size_z), number // box.size_z % box.size_y, number % box.size_z
        row = find_row(table, box.x + a, box.y + b, box.z + c)
        is_new = row < 0
        if is_new:
            row = next_row(table, box.x + a, box.y + b, box.z + c)
        changed = False
        for word in range(WORDS):
            hit, through = passed.hits[slot, word], passed.seen[slot, word]
            if hit | through == np.uint64(0):
                continue
            spread(through, seen)
            spread(hit, hits)
            load_brick(voxels, codes[row, word], old)
            lower(old, seen, miss, lowest, new)
            raise_(old, hits, gains, highest, new)
            hit_here, changed_here, missed_here = compared(old, new, hits)
            counts[HITS] += hit_here
            if changed_here:
                counts[LOWERED] += missed_here
                store_brick(codes, voxels, spare, used, row, word, new)
                changed = True
        if changed:
            if is_new:
                keep_row(table)
            table.revisions[row] = revision
            counts[CHANGED] += 1
    return int(passed.slots.shape[0])
