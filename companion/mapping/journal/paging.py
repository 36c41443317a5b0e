"""A map that may be larger than the memory: what is far away waits in the journal.

Space is divided into regions of 8 x 8 x 8 chunks, which are in memory whole or not at all. Before a frame is put into
the map, the regions that the camera may reach are brought in; when the map's memory is above its bound, those that were
not near for longest are dropped, as soon as the journal has them.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.config.mapping import MapSettings
from companion.mapping.journal import Header, Journal
from companion.mapping.journal.contents import ChunkRows
from companion.mapping.voxels.chunks import CHUNK_LIMIT, EDGE, MASK, SHIFT, chunks_of, keys_of, place_of
from companion.mapping.voxels.lookup import UNKNOWN, states_of
from companion.mapping.voxels.piece import MOST_CHUNKS, IntegrationReport, MapPiece, MapSnapshot
from companion.mapping.voxels.voxel_map import VoxelMap
from companion.model import Camera, DepthFrame, PlanarScan, Pose

MEMORY_BYTES = 512 << 20
"""Bound of a map's memory, where nothing else is said."""

COMPACT_S = 0.02
"""Time that one flush gives to the journal's compaction."""

_REGION_SHIFT = 3
_REGION_EDGE = 1 << _REGION_SHIFT
_OFFSETS = np.indices((_REGION_EDGE,) * 3, np.int32).reshape(3, -1).T
"""(512, 3) the chunks of a region, from its lowest."""

_KEPT_SHARE = 0.8
"""Of what fits, so much stays: trimming a little with every frame would cost more."""

_CHANGED, _SAVED = 0, 1

Region = tuple[int, int, int]


@dataclass(frozen=True, slots=True)
class Flushed:
    """What one `PagedMap.flush` wrote.

    Attributes:
        chunks: how many.
        bytes_written: their size in the journal.
    """

    chunks: int
    bytes_written: int


class PagedMap:
    """A `VoxelMap` with a journal behind it; a `MapSource` of the whole. For one thread at a time.

    What it says is at any time what a `VoxelMap` would say that was given the same frames. Call `flush` at least each
    half second: that is what a crash may cost. The memory stays bounded by itself.

    Args:
        settings: of the map.
        journal: what it holds already is the map's beginning; the caller closes it. None: **a plain map without any
            bound**, which is not kept anywhere.
        memory_bytes: above this the map drops what is far. What the camera may reach always stays, and so does what
            could not be written, whatever it takes.

    Raises:
        ValueError: the journal is of a map with other settings.
    """

    def __init__(self, settings: MapSettings, journal: Journal | None = None, memory_bytes: int = MEMORY_BYTES) -> None:
        self._voxels = VoxelMap(settings)
        self._settings = settings
        self._journal = journal
        self._bound_bytes = memory_bytes
        self._chunk_m = EDGE * settings.voxel_m
        self._rows = ChunkRows(2)
        self._noted = self._voxels.revision
        self._regions: dict[Region, int] = {}
        self._looks = 0
        self._cell: Region | None = None
        self._around = 0
        self._reach = -math.inf
        self._camera: Camera | None = None
        self._most_chunks = self._highest_bytes = 0
        if journal is not None:
            if wrong := Header.of(settings, journal.header.frame).differences(journal.header):
                raise ValueError(f"{journal.folder}: the journal is of another map: {', '.join(wrong)}")
            rows = self._rows.add(keys_of(journal.chunks))
            self._rows.column(_CHANGED)[rows] = self._rows.column(_SAVED)[rows] = self.revision

    @property
    def voxel_m(self) -> float:
        """Edge of a voxel."""
        return self._voxels.voxel_m

    @property
    def threshold(self) -> int:
        """A voxel is occupied from this value on, in thousandths of log-odds."""
        return self._voxels.threshold

    @property
    def revision(self) -> int:
        """Grows with everything that changes the map; above 0 from the beginning."""
        return self._voxels.revision + 1

    @property
    def memory_bytes(self) -> int:
        """What is in memory: voxels and indices."""
        journal_bytes = self._journal.memory_bytes if self._journal is not None else 0
        return self._voxels.memory_bytes + self._rows.memory_bytes + journal_bytes

    @property
    def chunks_in_memory(self) -> int:
        """How many chunks are in memory."""
        return len(self._voxels.changed())

    @property
    def chunks(self) -> int:
        """How many chunks there are, in memory and in the journal."""
        self._note()
        return len(self._rows)

    def integrate(self, frame: DepthFrame) -> IntegrationReport:
        """Put one depth image into the map, as `VoxelMap.integrate` does.

        Raises:
            ValueError: as there.
        """
        if self._journal is not None:
            if frame.camera != self._camera:
                self._camera, self._reach = frame.camera, _reach_m(frame.camera, self._settings.max_range_m)
            self._bring(frame.pose, self._reach)
        return self._voxels.integrate(frame)

    def integrate_scan(self, scan: PlanarScan) -> IntegrationReport:
        """Put one turn of a planar scanner into the map, as `VoxelMap.integrate_scan` does.

        Raises:
            ValueError: as there.
        """
        if self._journal is not None:
            self._bring(scan.pose, self._settings.max_range_m)
        return self._voxels.integrate_scan(scan)

    def changed(self, since: int = 0) -> NDArray[np.int32]:
        """(n, 3) coordinates of the chunks that changed after revision ``since``; 0 gives all, in memory or not.

        A chunk may be named again that had changed a little before, but none is missing.
        """
        self._note()
        return chunks_of(self._rows.keys[self._rows.column(_CHANGED) > since])

    def piece(self, chunks: NDArray[np.int32]) -> MapPiece:
        """A copy of some chunks, those among ``chunks`` (n, 3) that the map has, in any order."""
        near = self._voxels.piece(chunks)
        if self._journal is None or len(near.chunks) == len(chunks):
            return near
        far = self._journal.read(chunks[~np.isin(keys_of(chunks), keys_of(near.chunks))])
        return MapPiece(np.concatenate([near.chunks, far.chunks]), np.concatenate([near.values, far.values]))

    def pieces(self, most_chunks: int = MOST_CHUNKS) -> Iterator[MapPiece]:
        """Every chunk once, ``most_chunks`` at a time: what is in memory, then the rest as it lies on the disk."""
        everything = near = self._voxels.changed()
        if self._journal is not None:
            on_disk = self._journal.chunks
            everything = np.concatenate([near, on_disk[~np.isin(keys_of(on_disk), keys_of(near))]])
        for first in range(0, len(everything), most_chunks):
            yield self.piece(everything[first : first + most_chunks])

    def snapshot(self, since: int = 0) -> MapSnapshot:
        """The states of the chunks that changed after revision ``since``, as a copy; 0 gives all."""
        piece = self.piece(self.changed(since))
        states = np.asarray(states_of(piece.values, self.threshold))
        return MapSnapshot(self.voxel_m, self.revision, piece.chunks, states)

    def classify(self, points: NDArray[np.floating]) -> NDArray[np.uint8]:
        """(n,) `UNKNOWN`, `FREE` or `OCCUPIED` of the voxel that holds each of ``points`` (n, 3), in m.

        Raises:
            ValueError: a point is not finite.
        """
        states = self._voxels.classify(points)
        if self._journal is None:
            return states
        unsaid = np.flatnonzero(states == UNKNOWN)
        voxels = np.floor(np.asarray(points, np.float64)[unsaid] / self.voxel_m)
        inside = np.all(np.abs(voxels) < (CHUNK_LIMIT - 1) * EDGE, axis=1)
        unsaid, voxels = unsaid[inside], voxels[inside].astype(np.int64)
        chunks, number = np.unique(voxels >> SHIFT, axis=0, return_inverse=True)
        places = np.asarray(place_of.py_func(*(voxels & MASK).T))
        for first in range(0, len(chunks), MOST_CHUNKS):
            asked = chunks[first : first + MOST_CHUNKS].astype(np.int32)
            piece = self.piece(asked)
            row_of = {chunk: row for row, chunk in enumerate(map(tuple, piece.chunks.tolist()))}
            rows = np.array([row_of.get(chunk, -1) for chunk in map(tuple, asked.tolist())], np.int64)
            here = np.flatnonzero((number >= first) & (number < first + MOST_CHUNKS))
            row = rows[number[here] - first]
            here, row = here[row >= 0], row[row >= 0]
            states[unsaid[here]] = states_of(piece.values, self.threshold)[row, places[here]]
        return states

    def flush(self, *, wait: bool = True) -> Flushed:
        """Write what has changed since the last time, make it safe, and tidy the journal up a little.

        Args:
            wait: until it is safe; without it `Journal.begin_commit` has a thread do that, and what was written
                survives this process only until the journal's `commit`.

        Raises:
            OSError: the disk is full or broken. The map goes on, and the next flush tries again.
        """
        if self._journal is None:
            return Flushed(0, 0)
        self._note()
        rows = np.flatnonzero(self._rows.column(_CHANGED) > self._rows.column(_SAVED))
        chunks = chunks_of(self._rows.keys[rows])
        before_bytes = self._journal.bytes_on_disk
        for first in range(0, len(chunks), MOST_CHUNKS):
            self._journal.append(self._voxels.piece(chunks[first : first + MOST_CHUNKS]))
        written_bytes = self._journal.bytes_on_disk - before_bytes
        if wait:
            self._journal.commit()
        self._rows.column(_SAVED)[rows] = self._rows.column(_CHANGED)[rows]
        self._journal.compact_step(COMPACT_S)
        if not wait:
            self._journal.begin_commit()
        return Flushed(len(chunks), written_bytes)

    def trim(self) -> int:
        """Drop the regions that were not near for longest, if the map takes more memory than it may.

        Returns:
            How many chunks were dropped.
        """
        memory_bytes = self._voxels.memory_bytes
        if self._journal is None or memory_bytes <= self._bound_bytes:
            return 0
        chunks = self._voxels.changed()
        if memory_bytes > self._highest_bytes:
            # Memory that was given back may still count as the map's. So what fits is known from the moment at which
            # the map last grew: that was too much.
            self._highest_bytes = memory_bytes
            self._most_chunks = len(chunks) * self._bound_bytes // memory_bytes
        if len(chunks) <= self._most_chunks:
            return 0
        return self._drop(chunks, len(chunks) - int(_KEPT_SHARE * self._most_chunks))

    def _drop(self, chunks: NDArray[np.int32], enough: int) -> int:
        """Drop regions until ``enough`` of the ``chunks`` in memory are gone; how many were."""
        self._note()
        rows = self._rows.find(keys_of(chunks))
        safe = self._rows.column(_CHANGED)[rows] == self._rows.column(_SAVED)[rows]
        regions, number = np.unique(chunks >> _REGION_SHIFT, axis=0, return_inverse=True)
        number = number.reshape(-1)
        sizes = np.bincount(number, minlength=len(regions))
        may_go = np.bincount(number, safe, minlength=len(regions)) == sizes
        looks = np.array([self._regions[region] for region in map(tuple, regions.tolist())])
        far = np.abs(regions * _REGION_EDGE - np.array(self._cell or (0, 0, 0))).max(axis=1)
        order = np.lexsort((-far, looks))
        order = order[may_go[order] & (looks[order] < self._looks)]
        order = order[: np.searchsorted(np.cumsum(sizes[order]), enough) + 1]
        gone = chunks[np.isin(number, order)]
        self._voxels.drop(gone)
        self._noted = self._voxels.revision
        for region in map(tuple, regions[order].tolist()):
            del self._regions[region]
        return len(gone)

    def _note(self) -> None:
        """Write down which chunks changed since the last note: a chunk that is brought in has not."""
        changed = self._voxels.changed(self._noted)
        if len(changed):
            rows = self._rows.add(keys_of(changed))
            self._rows.column(_CHANGED)[rows] = self.revision
        self._noted = self._voxels.revision

    def _bring(self, pose: Pose, reach_m: float) -> None:
        """Have everything in memory that lies within ``reach_m`` of a pose, which may be nonsense."""
        at_m = pose.x_m, pose.y_m, pose.z_m
        if not all(abs(part_m) < CHUNK_LIMIT * self._chunk_m for part_m in (*at_m, reach_m)):
            return
        cell = _cell_of(at_m, self._chunk_m)
        # Whole chunks around: wherever in its chunk the vehicle is, and however things are rounded.
        around = math.ceil(reach_m / self._chunk_m) + 1
        if cell == self._cell and around <= self._around:
            return
        self._looks += 1
        sides = [range((part - around) >> _REGION_SHIFT, ((part + around) >> _REGION_SHIFT) + 1) for part in cell]
        near = list(itertools.product(*sides))
        missing = [region for region in near if region not in self._regions]
        self._load(np.array(missing, np.int32).reshape(-1, 3))
        for x, y, z in near:
            self._regions[x, y, z] = self._looks
        self._cell, self._around = cell, around
        self.trim()

    def _load(self, regions: NDArray[np.int32]) -> None:
        """Bring ``regions`` (n, 3) in from the journal."""
        keys = keys_of((regions[:, np.newaxis] * _REGION_EDGE + _OFFSETS).reshape(-1, 3))
        wanted = chunks_of(keys[self._rows.find(keys) >= 0])
        if not len(wanted) or self._journal is None:
            return
        self._note()
        for first in range(0, len(wanted), MOST_CHUNKS):
            self._voxels.put(self._journal.read(wanted[first : first + MOST_CHUNKS]))
        self._noted = self._voxels.revision


def _cell_of(at_m: tuple[float, float, float], chunk_m: float) -> Region:
    x_m, y_m, z_m = at_m
    return math.floor(x_m / chunk_m), math.floor(y_m / chunk_m), math.floor(z_m / chunk_m)


def _reach_m(camera: Camera, max_range_m: float) -> float:
    """How far from the pose a frame can change the map: to the farthest corner of the image, wherever it looks."""
    u_px = max(camera.cx_px + 0.5, camera.width_px - 0.5 - camera.cx_px)
    v_px = max(camera.cy_px + 0.5, camera.height_px - 0.5 - camera.cy_px)
    corner = math.hypot(1.0, u_px / camera.fx_px, v_px / camera.fy_px)
    return min(max_range_m, camera.max_range_m) * corner + math.hypot(
        camera.mount_x_m, camera.mount_y_m, camera.mount_z_m
    )
