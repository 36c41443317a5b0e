"""The map V: free, occupied and unknown voxels, from depth images and planar scans."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from companion.config.mapping import MapSettings
from companion.mapping.voxels import lookup
from companion.mapping.voxels.chunk_table import Store, Table, find_rows, forget_rows, load_rows, store_rows
from companion.mapping.voxels.chunks import CHUNK_LIMIT, EDGE, NOTHING, plain
from companion.mapping.voxels.depth_image import clear_depth, hole_depth_m
from companion.mapping.voxels.marks import mark_hits
from companion.mapping.voxels.piece import (
    MOST_CHUNKS,
    IntegrationReport,
    MapCounts,
    MapPiece,
    MapSnapshot,
    MapSource,
    add_log_odds,
)
from companion.mapping.voxels.scan import beams_of, pass_beams, update_passed
from companion.mapping.voxels.sensor_model import CHANGED, HITS, LOWERED, steps_of
from companion.mapping.voxels.update import update_chunks
from companion.mapping.voxels.view import view_of
from companion.model import DepthFrame, FloatArray, PlanarScan

_FIRST_CHUNKS = 256
Number = TypeVar("Number", bound=np.floating)


class VoxelMap:
    """A sparse map of voxels, which grows with the surfaces seen. For one thread at a time.

    A voxel covers i voxel_m <= x < (i + 1) voxel_m, and so on; it is FREE when it was looked through more than hit,
    OCCUPIED from ``settings.occupied_probability`` on, and UNKNOWN otherwise: unknown is not free.

    Args:
        settings: voxel size, range and sensor model.
    """

    def __init__(self, settings: MapSettings) -> None:
        self.settings = settings
        self._steps = steps_of(settings)
        self._store = Store(_FIRST_CHUNKS)
        self._revision = 0
        # Memory for one image, kept from frame to frame: taking it anew would cost more than the work.
        self._clear_m = np.empty((0, 0), np.float32)

    @property
    def voxel_m(self) -> float:
        """Edge of a voxel."""
        return self.settings.voxel_m

    @property
    def threshold(self) -> int:
        """A voxel is occupied from this value on, in thousandths of log-odds."""
        return self._steps.threshold

    @property
    def revision(self) -> int:
        """Grows with everything that changes the map."""
        return self._revision

    @property
    def memory_bytes(self) -> int:
        """Size of what the map holds."""
        return self._store.memory_bytes

    def integrate(self, frame: DepthFrame) -> IntegrationReport:
        """Put one depth image into the map.

        A pixel that measured a surface marks the voxel at its end; voxels whose centre a pixel saw to be clear are
        freed, unless the same frame marked them. Pixels at or beyond the nearer of the map's and the camera's range
        free the space up to there. NaN, what is nearer than the camera's least range, and what is at or beyond
        ``settings.saturated_m`` say nothing. Depth is along the optical axis, and so are both ranges.

        Args:
            frame: the image with its camera and its pose. Images of several cameras come in turn.

        Raises:
            ValueError: the pose or the camera has a value that is not finite, or the image is not the camera's size.
            OSError: there is no more memory; the map is as it was, but for a part of this image.
        """
        camera, settings = frame.camera, self.settings
        if frame.depth_m.shape != (camera.height_px, camera.width_px):
            raise ValueError(
                f"depth_m has the shape {frame.depth_m.shape}, the camera is {camera.height_px} px high and "
                f"{camera.width_px} px wide"
            )
        box, projection, rays = view_of(frame, settings.voxel_m, settings.max_range_m)
        depth_m = plain(self._unsaturated(frame.depth_m), np.float32)
        if self._clear_m.shape != depth_m.shape:
            self._clear_m = np.empty(depth_m.shape, np.float32)
        marks = mark_hits(depth_m, rays, box)
        hole_m = min(hole_depth_m(settings.voxel_m, min(camera.fx_px, camera.fy_px)), rays.limit_m)
        limits = rays.lowest_m, rays.limit_m, settings.margin_m, settings.depth_noise_per_m, hole_m
        clear = clear_depth(depth_m, *limits, self._clear_m)
        self._revision += 1
        counts = np.zeros(3, np.int64)
        chunks_new = self._filled(
            lambda table, done: update_chunks(
                table, box, done, marks, clear, projection, self._steps, self._revision, counts
            ),
            len(marks.slots),
        )
        return _report(counts, marks.pixels.tolist(), chunks_new)

    def integrate_scan(self, scan: PlanarScan) -> IntegrationReport:
        """Put one turn of a planar scanner into the map.

        Each beam frees the voxels that it passed through and marks the one in which it ended, if it ended before the
        nearer of the map's and the scanner's range. Hits win over misses within a turn. NaN, 0 and what is at or beyond
        ``settings.saturated_m`` say nothing.

        Args:
            scan: the turn with its pose; the scanner sits at the vehicle's centre, level on its body.

        Raises:
            ValueError: the pose or a bearing is not finite, or bearings and ranges differ in number.
            OSError: there is no more memory; the map is as it was, but for a part of this turn.
        """
        scan = replace(scan, ranges_m=self._unsaturated(scan.ranges_m))
        box, beams = beams_of(scan, self.voxel_m, self.settings.max_range_m)
        passed = pass_beams(beams, box)
        self._revision += 1
        counts = np.zeros(3, np.int64)
        chunks_new = self._filled(
            lambda table, done: update_passed(table, box, done, passed, self._steps, self._revision, counts),
            len(passed.slots),
        )
        hits = int(np.count_nonzero(beams.hits))
        return _report(counts, (hits, len(beams.hits) - hits, len(scan.ranges_m) - len(beams.hits)), chunks_new)

    def merge(self, other: MapSource) -> None:
        """Add what another vehicle's map says: log-odds are added, then clamped.

        Raises:
            ValueError: the maps have voxels of different size.
        """
        if other.voxel_m != self.voxel_m:
            raise ValueError(f"cannot merge a map with voxels of {other.voxel_m} m into one of {self.voxel_m} m")
        for theirs in other.pieces():
            chunks = _chunks(theirs.chunks)
            values = load_rows(self._store.table, find_rows(self._store.table, chunks))
            add_log_odds(values, plain(theirs.values, np.int16), self._steps.lowest, self._steps.highest)
            self.put(MapPiece(chunks, values))

    def classify(self, points: NDArray[np.floating]) -> NDArray[np.uint8]:
        """(n,) `UNKNOWN`, `FREE` or `OCCUPIED` of the voxel that holds each of ``points`` (n, 3), in m.

        Raises:
            ValueError: a point is not finite.
        """
        points_m = self._points(points)
        return np.asarray(lookup.states_at(self._store.table, points_m, self.voxel_m, self._steps.threshold))

    def occupied_near(self, points: NDArray[np.floating]) -> NDArray[np.bool_]:
        """(n,) whether one of the 27 voxels at and around each of ``points`` (n, 3), in m, is occupied.

        Raises:
            ValueError: a point is not finite.
        """
        points_m = self._points(points)
        table = self._store.table
        bits = lookup.occupied_bits(table, self._steps.threshold)
        return np.asarray(lookup.near_occupied(table, bits, points_m, self.voxel_m))

    def occupied(self) -> FloatArray:
        """(n, 3) centres of the occupied voxels, in m."""
        return self._centres(lookup.OCCUPIED)

    def free(self) -> FloatArray:
        """(n, 3) centres of the free voxels, in m."""
        return self._centres(lookup.FREE)

    def counts(self) -> MapCounts:
        """How many voxels are occupied, free and undecided."""
        occupied = free = seen = 0
        for piece in self.pieces():
            states = lookup.states_of(piece.values, self._steps.threshold)
            occupied += int(np.count_nonzero(states == lookup.OCCUPIED))
            free += int(np.count_nonzero(states == lookup.FREE))
            seen += int(np.count_nonzero(piece.values != NOTHING))
        return MapCounts(occupied, free, seen - occupied - free, self._store.chunks)

    def snapshot(self, since: int = 0) -> MapSnapshot:
        """The states of the chunks that changed after revision ``since``, as a copy; 0 gives all."""
        piece = self.piece(self.changed(since))
        states = lookup.states_of(piece.values, self._steps.threshold)
        return MapSnapshot(self.voxel_m, self._revision, piece.chunks, np.asarray(states))

    def changed(self, since: int = 0) -> NDArray[np.int32]:
        """(n, 3) coordinates of the chunks that changed after revision ``since``; 0 gives all."""
        table, size = self._store.table, self._store.chunks
        return table.coords[:size][table.revisions[:size] > since]

    def piece(self, chunks: NDArray[np.int32]) -> MapPiece:
        """A copy of some chunks, those among ``chunks`` (n, 3) that the map has."""
        table = self._store.table
        rows = find_rows(table, _chunks(chunks))
        rows = rows[rows >= 0]
        return MapPiece(table.coords[rows], load_rows(table, rows))

    def pieces(self, most_chunks: int = MOST_CHUNKS) -> Iterator[MapPiece]:
        """Every chunk once, in no particular order, ``most_chunks`` at a time."""
        everything = self.changed()
        for first in range(0, len(everything), most_chunks):
            yield self.piece(everything[first : first + most_chunks])

    def put(self, piece: MapPiece) -> None:
        """Take chunks as they are, in place of what the map had there.

        Raises:
            OSError: there is no more memory; some of them were taken.
        """
        chunks, values = _chunks(piece.chunks), plain(piece.values, np.int16)
        self._revision += 1
        self._filled(lambda table, done: store_rows(table, chunks, values, done, self._revision), len(chunks))

    def drop(self, chunks: NDArray[np.int32]) -> None:
        """Forget those of ``chunks`` (n, 3) that the map has: they are unknown again, and their memory is used anew."""
        forget_rows(self._store.table, _chunks(chunks))

    def _unsaturated(self, readings_m: NDArray[Number]) -> NDArray[Number]:
        """The same, with NaN for what the sensor says when nothing comes back."""
        saturated_m = self.settings.saturated_m
        if saturated_m is None:
            return readings_m
        return np.where(readings_m >= saturated_m, readings_m.dtype.type(np.nan), readings_m)

    def _filled(self, fill: Callable[[Table, int], int], last: int) -> int:
        """Call ``fill`` with the table and where to go on, and make room each time that it stops before ``last``.

        Returns:
            How many chunks are new.
        """
        before, done = self._store.chunks, 0
        while (done := fill(self._store.table, done)) < last:
            self._store.grow()
        return self._store.chunks - before

    def _centres(self, state: np.uint8) -> FloatArray:
        found = [np.zeros((0, 3))]
        for piece in self.pieces():
            states = lookup.states_of(piece.values, self._steps.threshold)
            found.append(lookup.centres(piece.chunks, states, state, self.voxel_m))
        return np.concatenate(found)

    def _points(self, points: NDArray[np.floating]) -> FloatArray:
        """The same points as the compiled functions take them; those beyond the grid are moved to its unused rim."""
        points_m = plain(points, np.float64)
        if points_m.ndim != 2 or points_m.shape[1] != 3:
            raise ValueError(f"points have the shape {points_m.shape}, not (n, 3)")
        reach_m = (CHUNK_LIMIT - 1) * EDGE * self.voxel_m
        largest_m = float(np.max(np.abs(points_m), initial=0.0))
        if not np.isfinite(largest_m):
            raise ValueError("points have coordinates that are not finite")
        return points_m if largest_m < reach_m else np.clip(points_m, -reach_m, reach_m)


def _report(counts: NDArray[np.int64], pixels: Sequence[int], chunks_new: int) -> IntegrationReport:
    """What became of an image or a turn, of which so many pixels hit something, saw free space only, said nothing."""
    hit, clear, invalid = pixels
    return IntegrationReport(
        hits=int(counts[HITS]),
        misses=int(counts[LOWERED]),
        pixels_hit=hit,
        pixels_clear=clear,
        pixels_invalid=invalid,
        chunks_updated=int(counts[CHANGED]),
        chunks_new=chunks_new,
    )


def _chunks(chunks: NDArray[np.int32]) -> NDArray[np.int32]:
    """The same coordinates as the compiled functions take them."""
    return plain(chunks, np.int32).reshape(-1, 3)
