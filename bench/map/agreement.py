"""What our map says beside what OctoMap says of the same images, voxel by voxel.

OctoMap with its own rays and its own nodes, but with rays that end at the plane where ours end: see
`bench.map.octomap`. Each voxel that either has seen is counted by what both say of it, and each difference by what the
frames saw of the voxel: see `bench.map.reasons`.
"""

from __future__ import annotations

import tempfile
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bench.map import frames as map_frames
from bench.map.octomap import ExactOctoMap, Integers, leaves_of
from bench.map.reasons import REASONS, observed
from bench.table import Row
from companion.mapping import VoxelMap
from companion.mapping.journal import Header, Journal
from companion.mapping.voxels.chunks import EDGE, NOTHING, OFFSETS
from companion.mapping.voxels.lookup import FREE, OCCUPIED, UNKNOWN
from companion.model import DepthFrame

STATES = {int(UNKNOWN): "unknown", int(FREE): "free", int(OCCUPIED): "occupied"}


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
