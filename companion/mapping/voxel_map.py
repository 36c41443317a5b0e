"""The map V: free, occupied and unknown voxels, from depth images."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.config.mapping import MapSettings
from companion.mapping import lookup
from companion.mapping.chunks import doubled, empty_table, has_room
from companion.mapping.depth_image import clear_depth
from companion.mapping.marks import mark_hits
from companion.mapping.update import Steps, update_chunks
from companion.mapping.view import view_of
from companion.model import DepthFrame, FloatArray


@dataclass(frozen=True, slots=True)
class IntegrationReport:
    hits: int
    misses: int
    pixels_hit: int
    pixels_clear: int
    pixels_invalid: int
    chunks_updated: int
    chunks_new: int


def milli_log_odds(probability: float) -> int:
    return round(1000.0 * math.log(probability / (1.0 - probability)))


class VoxelMap:
    """Sparse voxel map."""

    def __init__(self, settings: MapSettings) -> None:
        self.settings = settings
        self._table = empty_table(64)
        self._revision = 0
        self._miss = milli_log_odds(settings.miss_probability)
        self._lowest = milli_log_odds(settings.clamp_min_probability)
        self._highest = milli_log_odds(settings.clamp_max_probability)
        self._threshold = milli_log_odds(settings.occupied_probability)
        self._hits = np.full(64, milli_log_odds(settings.hit_probability), np.int16)

    def integrate(self, frame: DepthFrame) -> IntegrationReport:
        s = self.settings
        camera = frame.camera
        if frame.depth_m.shape != (camera.height_px, camera.width_px):
            raise ValueError(f"depth_m has the shape {frame.depth_m.shape}")
        view = view_of(frame, s.voxel_m, s.max_range_m)
        depth_m = np.ascontiguousarray(frame.depth_m, np.float32)
        clear = clear_depth(
            depth_m, view.rays.lowest_m, view.rays.limit_m, s.margin_voxels * s.voxel_m, s.depth_noise_per_m
        )
        marks = mark_hits(depth_m, view.rays, view.box)
        self._revision += 1
        size_before = int(self._table.size[0])
        counts = np.zeros(3, np.int64)
        number, n = 0, marks.slots.size
        steps = Steps(self._miss, self._lowest, self._highest)
        while True:
            number = update_chunks(
                self._table, view.box, number, marks, clear, view.projection, steps, self._hits, self._revision, counts
            )
            if number >= n:
                break
            self._table = doubled(self._table)
        return IntegrationReport(
            int(counts[0]), int(counts[1]), int(marks.pixels[0]), int(marks.pixels[1]), int(marks.pixels[2]),
            int(counts[2]), int(self._table.size[0]) - size_before,
        )

    @property
    def voxel_m(self) -> float:
        return self.settings.voxel_m

    @property
    def memory_bytes(self) -> int:
        return sum(a.nbytes for a in self._table)

    def classify(self, points: FloatArray) -> NDArray[np.uint8]:
        return lookup.states_at(self._table, np.ascontiguousarray(points, np.float64), self.voxel_m, self._threshold)

    def occupied_near(self, points: FloatArray) -> NDArray[np.bool_]:
        bits = lookup.occupied_bits(self._table.values, int(self._table.size[0]), self._threshold)
        return lookup.near_occupied(self._table, bits, np.ascontiguousarray(points, np.float64), self.voxel_m)

    def _centres(self, state: np.uint8) -> FloatArray:
        n = int(self._table.size[0])
        states = lookup.states_of(self._table.values[:n], self._threshold)
        return lookup.centres(self._table.coords[:n], states, state, self.voxel_m)

    def occupied(self) -> FloatArray:
        return self._centres(lookup.OCCUPIED)

    def free(self) -> FloatArray:
        return self._centres(lookup.FREE)
