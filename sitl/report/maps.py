"""The map that the vehicle built: from above and from the side, with the roof taken off (paper Fig. 7, right half)."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, Normalize, to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from sitl.report.data import Array, Points, ReportData
from sitl.report.splat import Camera, render
from sitl.report.style import DPI, MISSED, MOST_IN, STRIP_IN, WIDTH_IN, add_scale_bar, picture

_HEIGHT_COLOURS = LinearSegmentedColormap.from_list("rock", ["#f3e9d2", "#cdbf9f", "#8e9a92", "#4f6d7a", "#22394a"])
_FROM_ABOVE = Camera(-math.pi / 2, math.pi / 2)
# Turned so that the longer side of the mine runs across the picture, and never along its walls.
_ACROSS_WIDE, _ACROSS_TALL = (Camera(math.radians(azimuth), math.radians(48.0)) for azimuth in (-62.0, -28.0))

_CELL_M = 0.25
_REACH_CELLS = 4  # 1 m: walls seen only high up still find the floor beside them


@dataclass(frozen=True, slots=True, eq=False)
class _Model:
    """What is drawn: cubes, their colours, and the heights that the colours stand for."""

    centres_m: Array
    colours: Array
    heights: Normalize


def map_pictures(data: ReportData) -> tuple[bytes, bytes] | None:
    """Two PNG, from above and oblique; ``None`` when there is neither a map nor anything missed."""
    model = _cut_model(data)
    if model is None:
        return None
    spread = np.ptp(model.centres_m[:, :2], axis=0)
    oblique = _ACROSS_WIDE if spread[0] >= spread[1] else _ACROSS_TALL
    return _drawn(model, data, _FROM_ABOVE), _drawn(model, data, oblique)


def _cut_model(data: ReportData) -> _Model | None:
    """The map up to the flying height, and everything that was missed, in red."""
    occupied = np.asarray(data.occupied_m, dtype=np.float64).reshape(-1, 3)
    missed = _joined(np.asarray(data.missed_m, dtype=np.float64).reshape(-1, 3), data.voxel_m)
    if len(occupied) > 0:
        occupied = occupied[below_cut(occupied, data.height_m)]
    centres = np.concatenate([occupied, missed])
    if len(centres) == 0:
        return None
    # A single wild voxel must not take the colours from all others.
    low, high = np.quantile((occupied if len(occupied) > 0 else centres)[:, 2], (0.002, 0.998))
    heights = Normalize(float(low), float(max(high, low + data.voxel_m)))
    colours = np.concatenate(
        [_HEIGHT_COLOURS(heights(occupied[:, 2]))[:, :3], np.tile(to_rgb(MISSED), (len(missed), 1))]
    )
    return _Model(centres, colours, heights)


def _joined(points_m: Array, voxel_m: float) -> Array:
    """Centres of the voxels within half a voxel of scattered points (n, 3), which fills the gaps between them."""
    if len(points_m) == 0:
        return points_m
    shifts = np.array(list(itertools.product((-0.5, 0.5), repeat=3)))
    cells = np.floor(points_m / voxel_m + shifts[:, None]).astype(np.int64).reshape(-1, 3)
    low = cells.min(axis=0)
    size = np.ptp(cells, axis=0) + 1
    distinct = np.unique(np.ravel_multi_index(tuple((cells - low).T), tuple(size)))
    return np.asarray((np.stack(np.unravel_index(distinct, tuple(size)), axis=1) + low + 0.5) * voxel_m)


def _drawn(model: _Model, data: ReportData, camera: Camera) -> bytes:
    box_px = (int(WIDTH_IN * DPI), int(MOST_IN * DPI))
    drawn = render(model.centres_m, model.colours, data.voxel_m, camera, box_px)
    rows, columns, _ = drawn.rgb.shape

    def draw(figure: Figure) -> None:
        add_scale_bar(figure, 1.0 / (drawn.pixel_m * DPI), columns / DPI)
        height = STRIP_IN + rows / DPI
        middle = 0.5 * STRIP_IN / height
        bar = figure.add_axes((0.36, middle, 0.2, 0.1 / height))
        figure.colorbar(ScalarMappable(model.heights, _HEIGHT_COLOURS), bar, orientation="horizontal")
        bar.xaxis.set_major_locator(MaxNLocator(4))
        figure.text(0.57, middle + 0.05 / height, "height z in m", va="center_baseline")
        if len(data.missed_m) > 0:
            patch = Patch(color=MISSED, label="could be seen, but is not in the map")
            figure.legend(handles=[patch], loc="center right", bbox_to_anchor=(0.995, middle))

    return picture(WIDTH_IN, STRIP_IN + rows / DPI, draw, drawn.rgb)


def below_cut(points_m: Points, height_m: float) -> NDArray[np.bool_]:
    """Which points (n, 3), n > 0, lie less than ``height_m`` above the floor there.

    The floor is the lowest of them within a metre, so the cut follows slopes. Where one drift passes over another, the
    lower one remains.
    """
    low, high = points_m[:, :2].min(axis=0), points_m[:, :2].max(axis=0)
    columns, rows = ((high - low) / _CELL_M).astype(np.int64) + 1
    floor = np.full((columns, rows), np.inf)
    i, j = ((points_m[:, :2] - low) / _CELL_M).astype(np.int64).T
    np.minimum.at(floor, (i, j), points_m[:, 2])
    floor = _smoothed(_lowest_around(floor), np.isfinite(floor))
    return np.asarray(points_m[:, 2] < floor[i, j] + height_m)


def _lowest_around(floor_m: Array) -> Array:
    """The least value within `_REACH_CELLS` along each axis."""
    for axis in (0, 1):
        floor_m = _windows(floor_m, axis, np.inf).min(axis=-1)
    return floor_m


def _smoothed(floor_m: Array, known: NDArray[np.bool_]) -> Array:
    """The mean over the same reach, of known cells only."""
    total, count = np.where(known, floor_m, 0.0), known.astype(np.float64)
    for axis in (0, 1):
        total, count = (_windows(field, axis, 0.0).sum(axis=-1) for field in (total, count))
    return np.divide(total, count, out=np.full_like(total, np.inf), where=count > 0)


def _windows(field: Array, axis: int, outside: float) -> Array:
    """The values within `_REACH_CELLS` of each cell along an axis, as a last axis."""
    pads = [(_REACH_CELLS, _REACH_CELLS) if k == axis else (0, 0) for k in (0, 1)]
    padded = np.pad(field, pads, constant_values=outside)
    return np.lib.stride_tricks.sliding_window_view(padded, 2 * _REACH_CELLS + 1, axis=axis)
