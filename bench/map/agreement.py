"""What our map says beside what OctoMap says of the same images, voxel by voxel.

OctoMap with its own rays and its own nodes, but with rays that end at the plane where ours end: see
`bench.map.octomap`. Each voxel that either has seen is counted by what both say of it, and each difference by what the
frames saw of the voxel, by the images alone: see `observed`.
"""

from __future__ import annotations

import tempfile
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bench.common import Row
from bench.map import frames as map_frames
from bench.map.octomap import ExactOctoMap, Floats, Integers, leaves_of, packed, voxels_of
from companion.compiled import compiled_unchecked
from companion.geometry import camera_to_world
from companion.mapping import VoxelMap
from companion.mapping.journal import Header, Journal
from companion.mapping.voxels.chunks import EDGE, NOTHING, OFFSETS
from companion.mapping.voxels.lookup import FREE, OCCUPIED, UNKNOWN
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

STATES = {int(UNKNOWN): "unknown", int(FREE): "free", int(OCCUPIED): "occupied"}


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


class Grid(NamedTuple):
    """A part of space, dense.

    Attributes:
        lowest: (3,) the voxel at its corner.
        values: (x, y, z) log-odds in thousandths, NaN where nothing is known.
    """

    lowest: Integers
    values: NDArray[np.float32]

    def states(self) -> NDArray[np.uint8]:
        """What it says of each voxel."""
        known = np.where(self.values >= 0.0, OCCUPIED, FREE)
        return np.where(np.isnan(self.values), UNKNOWN, known).astype(np.uint8)


def agreement(frames: list[DepthFrame], voxel_m: float) -> Row:
    """Both maps from the same frames: how many voxels they say what of, why they differ, and how large they are."""
    ours, theirs = VoxelMap(map_frames.octomap_model(voxel_m)), ExactOctoMap(voxel_m)
    theirs.check(frames[0])
    for frame in frames:
        ours.integrate(frame)
        points, origin = map_frames.ends_m(frame)
        theirs.put(points, origin, map_frames.hits_of(frame))
    known, known_octo = _ours(ours), leaves_of(theirs.tree)
    lowest = np.minimum(known[0].min(0), known_octo[0].min(0)) - 2
    shape = np.maximum(known[0].max(0), known_octo[0].max(0)) + 3 - lowest
    grids = []
    for voxels, values in (known_octo, known):
        dense = np.full(shape, np.nan, np.float32)
        dense[tuple((voxels - lowest).T)] = values
        grids.append(Grid(lowest, dense))
    cells, reasons, lost = _compared(grids[0], grids[1], frames, voxel_m)
    return {"cells": cells, "reasons": reasons, "lost": lost, "sizes": _sizes(ours, theirs.tree)}


def _ours(voxels: VoxelMap) -> tuple[Integers, NDArray[np.float32]]:
    """As `leaves_of`, of our map."""
    places, values = [np.empty((0, 3), np.int64)], [np.empty(0, np.float32)]
    for piece in voxels.pieces():
        chunk, place = np.nonzero(piece.values != NOTHING)
        places.append(piece.chunks[chunk].astype(np.int64) * EDGE + OFFSETS[place])
        values.append(piece.values[chunk, place].astype(np.float32))
    return np.concatenate(places), np.concatenate(values)


def _compared(octo: Grid, ours: Grid, frames: list[DepthFrame], voxel_m: float) -> tuple[list[Row], list[Row], Row]:
    """The confusion table; the differences by reason; the voxels that are occupied in OctoMap and not in ours."""
    said, say = octo.states(), ours.states()
    seen = int(np.count_nonzero((said != UNKNOWN) | (say != UNKNOWN)))
    cells: list[Row] = []
    for one, other in product(STATES, STATES):
        count = int(np.count_nonzero((said == one) & (say == other)))
        if one != UNKNOWN or other != UNKNOWN:
            share = 100.0 * count / seen
            cells.append({"octomap": STATES[one], "ours": STATES[other], "voxels": count, "share, %": share})

    places = np.argwhere(said != say)
    at = tuple(places.T)
    why, hits, looks, lasts, slack_m = observed(places + octo.lowest, frames, voxel_m)
    near = _grown(said == OCCUPIED)[at]
    theirs, mine = octo.values[at], ours.values[at]
    reasons: list[Row] = []
    for one, other, reason in product(STATES, STATES, REASONS):
        chosen = (said[at] == one) & (say[at] == other) & (why == reason)
        if chosen.any():
            row: Row = {"octomap": STATES[one], "ours": STATES[other], "why": REASONS[reason]}
            row |= {"voxels": int(chosen.sum()), "near surface, %": 100.0 * float(near[chosen].mean())}
            row |= {"hits p50": float(np.median(hits[chosen])), "looks p50": float(np.median(looks[chosen]))}
            row |= {"octomap p50": _median(theirs[chosen]), "ours p50": _median(mine[chosen])}
            reasons.append(row)
    gone = np.flatnonzero((said[at] == OCCUPIED) & (say[at] != OCCUPIED))
    each = [
        {
            "voxel": (places[n] + octo.lowest).tolist(),
            "ours": STATES[int(say[tuple(places[n])])],
            "octomap, mlo": float(theirs[n]),
            "ours, mlo": None if np.isnan(mine[n]) else float(mine[n]),
            "frames that hit": int(hits[n]),
            "frames that looked through": int(looks[n]),
            "of these at the range limit": int(lasts[n]),
            "deepest end, mm": 1e3 * float(slack_m[n]) if hits[n] else None,
        }
        for n in gone.tolist()
    ]
    occupied = int(np.count_nonzero(said == OCCUPIED))
    # An end this near to the voxel's face falls on either side of it in single precision.
    rounding = int(np.count_nonzero(slack_m[gone] < 1e-4))
    return cells, reasons, {"occupied": occupied, "lost": len(each), "lost by rounding": rounding, "each": each}


def _grown(these: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """These voxels and the 26 around each; nothing wraps, because the grid has a rim of two."""
    for axis in range(3):
        these = these | np.roll(these, 1, axis) | np.roll(these, -1, axis)
    return these


def _median(values: NDArray[np.float32]) -> float | None:
    known = values[~np.isnan(values)]
    return float(np.median(known)) if len(known) else None


def _sizes(ours: VoxelMap, tree: Any) -> Row:
    """Bytes in memory and as files."""
    return {
        "ours, MB": ours.memory_bytes / 1e6,
        "octomap, MB": tree.memoryUsage() / 1e6,
        "journal, MB": _journal_bytes(ours) / 1e6,
        ".bt, MB": len(tree.writeBinary()) / 1e6,
        ".ot, MB": len(tree.write()) / 1e6,
    }


def _journal_bytes(ours: VoxelMap) -> int:
    """What the map takes in a journal into which it is written once."""
    header = Header.of(ours.settings, "world")
    with tempfile.TemporaryDirectory() as folder, Journal.open(Path(folder) / "map.journal", header) as journal:
        for piece in ours.pieces():
            journal.append(piece)
        journal.commit()
        return journal.bytes_on_disk
