"""What our map says beside what OctoMap says of the same images, voxel by voxel, and why they differ.

OctoMap once more, with its own rays and its own nodes, but with rays that end at the plane where ours end: see
`ExactOctoMap`. Each voxel that either has seen is counted by what both say of it, and each difference by what the
frames saw of the voxel, which is worked out from the images alone.
"""

from __future__ import annotations

import tempfile
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bench import map_frames
from bench.table import Row
from companion.geometry import camera_to_world
from companion.mapping import VoxelMap
from companion.mapping.chunks import EDGE, NOTHING, OFFSETS
from companion.mapping.journal import Header, Journal
from companion.mapping.lookup import FREE, OCCUPIED, UNKNOWN
from companion.model import DepthFrame

Integers = NDArray[np.int64]
Floats = NDArray[np.float64]

OCTOMAP_KEY = 2**15
"""OctoMap counts voxels from the lowest corner of its cube; ours count from the middle of it."""

LEVELS = 16
"""Of OctoMap's tree."""

STATES = {int(UNKNOWN): "unknown", int(FREE): "free", int(OCCUPIED): "occupied"}

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


def octree(voxel_m: float) -> Any:
    """An empty OctoMap with its default sensor model."""
    import octomap

    tree = octomap.OcTree(voxel_m)
    settings = map_frames.octomap_model(voxel_m)
    tree.setProbHit(settings.hit_probability)
    tree.setProbMiss(settings.miss_probability)
    tree.setClampingThresMin(settings.clamp_min_probability)
    tree.setClampingThresMax(settings.clamp_max_probability)
    tree.setOccupancyThres(settings.occupied_probability)
    return tree


def voxels_of(points_m: Floats, voxel_m: float) -> Integers:
    """(n, 3) the voxel of each point as OctoMap finds it: points are of single precision there."""
    return np.floor(points_m.astype(np.float32).astype(np.float64) / voxel_m).astype(np.int64)


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


class ExactOctoMap:
    """OctoMap's ``insertPointCloud``, step by step, so that each ray may end where it should.

    ``insertPointCloud`` knows a limit along the ray only, the same for all rays; a depth camera has one along its axis.
    So: a tree for one frame casts all rays. First those that end on a surface; then those that do not, in groups of
    nearly the same length, which is the limit given for each: they end less than an eighth of a voxel early. Voxels in
    which a ray ends on a surface are occupied, all others of this tree are free; each gets one update in the tree that
    stays. Where no ray reaches the limit this is what ``insertPointCloud`` does, and `check` sees to it.
    """

    def __init__(self, voxel_m: float) -> None:
        self.tree, self._voxel_m = octree(voxel_m), voxel_m

    def put(self, points: Floats, origin: Floats, hits: NDArray[np.bool_]) -> None:
        """Insert one frame."""
        rays = octree(self._voxel_m)
        rays.insertPointCloud(points[hits], origin)
        ways = points[~hits] - origin
        group = np.floor(np.linalg.norm(ways, axis=1) / (self._voxel_m / 8.0)).astype(np.int64)
        for length in np.unique(group).tolist():
            # Twice as far as they go: beyond the limit, which cuts them.
            rays.insertPointCloud(origin + 2.0 * ways[group == length], origin, length * self._voxel_m / 8.0)
        crossed = leaves_of(rays)[0]
        occupied = np.unique(voxels_of(points[hits], self._voxel_m), axis=0)
        free = crossed[~np.isin(_packed(crossed), _packed(occupied))]
        self.tree.updateNodes((free + 0.5) * self._voxel_m, False)
        self.tree.updateNodes((occupied + 0.5) * self._voxel_m, True)

    def check(self, frame: DepthFrame) -> None:
        """Compare with the real ``insertPointCloud`` on the surfaces of one frame.

        Raises:
            AssertionError: they differ.
        """
        points, origin = map_frames.ends_m(frame)
        points = points[map_frames.hits_of(frame)]
        here, real = ExactOctoMap(self._voxel_m), octree(self._voxel_m)
        here.put(points, origin, np.ones(len(points), np.bool_))
        real.insertPointCloud(points, origin)
        assert _sorted(leaves_of(here.tree)) == _sorted(leaves_of(real)), "not the voxels of insertPointCloud"


def leaves_of(tree: Any) -> tuple[Integers, NDArray[np.float32]]:
    """(n, 3) voxels of an octree and (n,) their log-odds in thousandths; those drawn together are taken apart."""
    if tree.size() == 0:
        return np.empty((0, 3), np.int64), np.empty(0, np.float32)
    data = tree.write().partition(b"\ndata\n")[2]
    nodes = np.frombuffer(data, np.dtype([("value", "<f4"), ("children", "u1")]))
    return _leaves(nodes["value"].copy(), nodes["children"].copy())


@njit(cache=True)
def _leaves(values: NDArray[np.float32], children: NDArray[np.uint8]) -> tuple[Integers, NDArray[np.float32]]:
    """The leaves of OctoMap's ``.ot``: nodes depth first, each with a bit for each of its children."""
    count = 0
    # First how many voxels, then which ones.
    voxels, log_odds = np.empty((0, 3), np.int64), np.empty(0, np.float32)
    for fills in (False, True):
        if fills:
            voxels, log_odds = np.empty((count, 3), np.int64), np.empty(count, np.float32)
        count, level = 0, 0
        keys = np.zeros((LEVELS + 2, 3), np.int64)
        todo = np.zeros(LEVELS + 2, np.int64)
        for node in range(len(values)):
            if children[node] == 0:
                edge = 1 << (LEVELS - level)
                for n in range(edge * edge * edge):
                    if fills:
                        voxels[count, 0] = keys[level, 0] * edge + n % edge - OCTOMAP_KEY
                        voxels[count, 1] = keys[level, 1] * edge + n // edge % edge - OCTOMAP_KEY
                        voxels[count, 2] = keys[level, 2] * edge + n // (edge * edge) - OCTOMAP_KEY
                        log_odds[count] = 1000.0 * values[node]
                    count += 1
            todo[level] = children[node]
            while level > 0 and todo[level] == 0:
                level -= 1
            child = 0
            while child < 8 and not todo[level] >> child & 1:
                child += 1
            todo[level] &= ~(1 << child)
            for axis in range(3):
                keys[level + 1, axis] = 2 * keys[level, axis] + (child >> axis & 1)
            level += 1
    return voxels, log_odds


def _packed(voxels: Integers) -> Integers:
    """(n,) one number for each voxel."""
    return np.asarray(((voxels[:, 0] + 2**20) << 42) | ((voxels[:, 1] + 2**20) << 21) | (voxels[:, 2] + 2**20))


def _sorted(leaves: tuple[Integers, NDArray[np.float32]]) -> list[tuple[int, float]]:
    return sorted(zip(_packed(leaves[0]).tolist(), leaves[1].tolist(), strict=True))


def _ours(voxels: VoxelMap) -> tuple[Integers, NDArray[np.float32]]:
    """As `leaves_of`, of our map."""
    places, values = [np.empty((0, 3), np.int64)], [np.empty(0, np.float32)]
    for piece in voxels.pieces():
        chunk, place = np.nonzero(piece.values != NOTHING)
        places.append(piece.chunks[chunk].astype(np.int64) * EDGE + OFFSETS[place])
        values.append(piece.values[chunk, place].astype(np.float32))
    return np.concatenate(places), np.concatenate(values)


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
    order = np.argsort(_packed(voxels))
    keys = _packed(voxels)[order]
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
        at = np.minimum(np.searchsorted(keys, _packed(ends)), len(keys) - 1)
        found = keys[at] == _packed(ends)
        rows = order[at[found]]
        inside_m = 0.5 * voxel_m - np.abs(points_m[found] - (ends[found] + 0.5) * voxel_m).max(axis=1)
        np.maximum.at(slack_m, rows, inside_m)
        hits[np.unique(rows)] += 1
    return Observed(why, hits, looks, lasts, slack_m)


@njit(cache=True, error_model="numpy")
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
