"""The map V: free, occupied and unknown voxels, from depth images."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from companion.config.mapping import MapSettings
from companion.mapping import lookup
from companion.mapping.chunks import CHUNK_LIMIT, EDGE, NOTHING, add_row, doubled, empty_table, find_row, is_full
from companion.mapping.depth_image import clear_depth
from companion.mapping.marks import mark_hits
from companion.mapping.piece import MOST_CHUNKS, MapPiece
from companion.mapping.sensor_model import steps_of
from companion.mapping.snapshot import IntegrationReport, MapCounts, MapSnapshot
from companion.mapping.update import merge_rows, update_chunks
from companion.mapping.view import view_of
from companion.model import DepthFrame, FloatArray

_FIRST_CHUNKS = 64


class _Room:
    """Memory for one image, kept from frame to frame: taking it anew would cost more than the work."""

    def __init__(self, shape: tuple[int, ...]) -> None:
        self.depth_m = np.empty(shape, np.float32)
        self.clear_m = np.empty(shape, np.float32)
        self.chunks = np.empty(shape, np.int32)
        self.places = np.empty(shape, np.int32)


class VoxelMap:
    """A sparse map of voxels, which grows with what is seen. For one thread at a time.

    A voxel covers i voxel_m <= x < (i + 1) voxel_m, and so on; it is FREE when it was looked through more than hit,
    OCCUPIED from ``settings.occupied_probability`` on, and UNKNOWN otherwise: unknown is not free.

    Args:
        settings: voxel size, range and sensor model.
    """

    def __init__(self, settings: MapSettings) -> None:
        self.settings = settings
        self._steps = steps_of(settings)
        self._table = empty_table(_FIRST_CHUNKS)
        self._revision = 0
        self._room = _Room((0, 0))

    @property
    def voxel_m(self) -> float:
        """Edge of a voxel."""
        return self.settings.voxel_m

    @property
    def memory_bytes(self) -> int:
        """Size of the arrays that hold the map, with the room that they have left."""
        return sum(array.nbytes for array in self._table)

    def integrate(self, frame: DepthFrame) -> IntegrationReport:
        """Put one depth image into the map.

        A pixel that measured a surface marks the voxel at its end; voxels whose centre a pixel saw to be clear are
        freed, unless the same frame marked them. Pixels at or beyond the nearer of the map's and the camera's range
        free the space up to there. NaN and what is nearer than the camera's least range say nothing. Depth is along
        the optical axis, and so are both ranges.

        Args:
            frame: the image with its camera and its pose.

        Raises:
            ValueError: the pose or the camera has a value that is not finite, or the image is not the camera's size.
        """
        camera, settings = frame.camera, self.settings
        if frame.depth_m.shape != (camera.height_px, camera.width_px):
            raise ValueError(
                f"depth_m has the shape {frame.depth_m.shape}, the camera is {camera.height_px} px high and "
                f"{camera.width_px} px wide"
            )
        view = view_of(frame, settings.voxel_m, settings.max_range_m)
        room = self._room_for(frame.depth_m)
        rays = view.rays
        marks = mark_hits(room.depth_m, rays, view.box, room.chunks, room.places)
        clear = clear_depth(
            room.depth_m, rays.lowest_m, rays.limit_m, settings.margin_m, settings.depth_noise_per_m, room.clear_m
        )

        self._revision += 1
        chunks_before = self._size
        counts = np.zeros(3, np.int64)
        done = 0
        while True:
            done = update_chunks(
                self._table, view.box, done, marks, clear, view.projection, self._steps, self._revision, counts
            )
            if done == len(marks.slots):
                break
            self._table = doubled(self._table)
        hits, misses, chunks_updated = (int(count) for count in counts)
        pixels_hit, pixels_clear, pixels_invalid = (int(count) for count in marks.pixels)
        return IntegrationReport(
            hits, misses, pixels_hit, pixels_clear, pixels_invalid, chunks_updated, self._size - chunks_before
        )

    def merge(self, other: VoxelMap) -> None:
        """Add what another vehicle's map says: log-odds are added, then clamped.

        Raises:
            ValueError: the maps have voxels of different size.
        """
        if other.voxel_m != self.voxel_m:
            raise ValueError(f"cannot merge a map with voxels of {other.voxel_m} m into one of {self.voxel_m} m")
        self._revision += 1
        theirs, steps = other._table, self._steps
        done = 0
        while True:
            done = merge_rows(self._table, theirs, done, steps.lowest, steps.highest, self._revision)
            if done == theirs.size[0]:
                return
            self._table = doubled(self._table)

    def classify(self, points: NDArray[np.floating]) -> NDArray[np.uint8]:
        """(n,) `UNKNOWN`, `FREE` or `OCCUPIED` of the voxel that holds each of ``points`` (n, 3), in m.

        Raises:
            ValueError: a point is not finite.
        """
        points_m = self._points(points)
        return np.asarray(lookup.states_at(self._table, points_m, self.voxel_m, self._steps.threshold))

    def occupied_near(self, points: NDArray[np.floating]) -> NDArray[np.bool_]:
        """(n,) whether one of the 27 voxels at and around each of ``points`` (n, 3), in m, is occupied.

        Raises:
            ValueError: a point is not finite.
        """
        points_m = self._points(points)
        bits = lookup.occupied_bits(self._table.values[: self._size], self._steps.threshold)
        return np.asarray(lookup.near_occupied(self._table, bits, points_m, self.voxel_m))

    def occupied(self) -> FloatArray:
        """(n, 3) centres of the occupied voxels, in m."""
        return self.snapshot().occupied()

    def free(self) -> FloatArray:
        """(n, 3) centres of the free voxels, in m."""
        return self.snapshot().free()

    def counts(self) -> MapCounts:
        """How many voxels are occupied, free and undecided."""
        values = self._table.values[: self._size]
        states = lookup.states_of(values, self._steps.threshold)
        occupied, free = np.count_nonzero(states == lookup.OCCUPIED), np.count_nonzero(states == lookup.FREE)
        seen = np.count_nonzero(values != NOTHING)
        return MapCounts(int(occupied), int(free), int(seen - occupied - free), self._size)

    def snapshot(self, since: int = 0) -> MapSnapshot:
        """The states of the chunks that changed after revision ``since``, as a copy; 0 gives all."""
        changed = np.flatnonzero(self._table.revisions[: self._size] > since)
        states = lookup.states_of(self._table.values[changed], self._steps.threshold)
        return MapSnapshot(self.voxel_m, self._revision, self._table.coords[changed], np.asarray(states))

    @property
    def threshold(self) -> int:
        """A voxel is occupied from this value on, in thousandths of log-odds."""
        return self._steps.threshold

    @property
    def revision(self) -> int:
        """Grows with everything that changes the map."""
        return self._revision

    def changed(self, since: int = 0) -> NDArray[np.int32]:
        """(n, 3) coordinates of the chunks that changed after revision ``since``; 0 gives all."""
        return self._table.coords[: self._size][self._table.revisions[: self._size] > since]

    def piece(self, chunks: NDArray[np.int32]) -> MapPiece:
        """A copy of some chunks, those among ``chunks`` (n, 3) that the map has."""
        rows = np.array([find_row(self._table, *(int(part) for part in chunk)) for chunk in chunks], np.int64)
        rows = rows[rows >= 0]
        return MapPiece(self._table.coords[rows], self._table.values[rows])

    def pieces(self, most_chunks: int = MOST_CHUNKS) -> Iterator[MapPiece]:
        """Every chunk once, in no particular order, ``most_chunks`` at a time."""
        everything = self.changed()
        for first in range(0, len(everything), most_chunks):
            yield self.piece(everything[first : first + most_chunks])

    def put(self, piece: MapPiece) -> None:
        """Take chunks as they are, in place of what the map had there."""
        self._revision += 1
        for chunk, values in zip(piece.chunks, piece.values, strict=True):
            x, y, z = (int(part) for part in chunk)
            row = find_row(self._table, x, y, z)
            if row < 0:
                if is_full(self._table):
                    self._table = doubled(self._table)
                row = add_row(self._table, x, y, z)
            self._table.values[row] = values
            self._table.revisions[row] = self._revision

    def drop(self, chunks: NDArray[np.int32]) -> None:
        """Forget those of ``chunks`` (n, 3) that the map has: they are unknown again, and what they held is free."""
        gone = {tuple(chunk) for chunk in chunks.tolist()}
        kept = MapPiece(self._table.coords[: self._size].copy(), self._table.values[: self._size].copy())
        stays = np.array([tuple(chunk) not in gone for chunk in kept.chunks.tolist()], np.bool_)
        revisions = self._table.revisions[: self._size][stays]
        self._table = empty_table(self._table.coords.shape[0])
        self.put(MapPiece(kept.chunks[stays], kept.values[stays]))
        self._table.revisions[: self._size] = revisions

    def _room_for(self, depth_m: NDArray[np.float32]) -> _Room:
        """The image in memory of our own: compiled code differs for memory that is read-only or of another layout."""
        if self._room.depth_m.shape != depth_m.shape:
            self._room = _Room(depth_m.shape)
        self._room.depth_m[...] = depth_m
        return self._room

    @property
    def _size(self) -> int:
        return int(self._table.size[0])

    def _points(self, points: NDArray[np.floating]) -> FloatArray:
        """The same points as the compiled functions take them; those beyond the grid are moved to its unused rim."""
        points_m = np.require(points, np.float64, ["C", "W"])
        if points_m.ndim != 2 or points_m.shape[1] != 3:
            raise ValueError(f"points have the shape {points_m.shape}, not (n, 3)")
        reach_m = (CHUNK_LIMIT - 1) * EDGE * self.voxel_m
        largest_m = float(np.max(np.abs(points_m), initial=0.0))
        if not np.isfinite(largest_m):
            raise ValueError("points have coordinates that are not finite")
        return points_m if largest_m < reach_m else np.clip(points_m, -reach_m, reach_m)
