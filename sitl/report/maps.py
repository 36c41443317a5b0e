"""The map that the vehicle built: from above and from the side, with the roof taken off (paper Fig. 7, right half)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, Normalize, to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from sitl.report.cutaway import below_cut
from sitl.report.data import Array, ReportData
from sitl.report.splat import Camera, Rendering, render
from sitl.report.style import MISSED, add_scale_bar, picture

_WIDTH_IN = 10.0
_RENDER_PX = 1500
_HEIGHT_COLOURS = LinearSegmentedColormap.from_list("rock", ["#f3e9d2", "#cdbf9f", "#8e9a92", "#4f6d7a", "#22394a"])
_FROM_ABOVE = Camera(azimuth_rad=-np.pi / 2, elevation_rad=np.pi / 2)
_OBLIQUE_RAD = np.deg2rad(48.0)


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
    azimuth = np.deg2rad(-62.0 if spread[0] >= spread[1] else -28.0)
    cameras = (_FROM_ABOVE, Camera(float(azimuth), float(_OBLIQUE_RAD)))
    above, oblique = (_drawn(model, data, camera) for camera in cameras)
    return above, oblique


def _cut_model(data: ReportData) -> _Model | None:
    """The map up to the flying height, and everything that was missed, in red."""
    occupied = np.asarray(data.occupied_m, dtype=np.float64).reshape(-1, 3)
    missed = np.asarray(data.missed_m, dtype=np.float64).reshape(-1, 3)
    if len(occupied) > 0:
        occupied = occupied[below_cut(occupied, occupied, data.height_m)]
    centres = np.concatenate([occupied, missed])
    if len(centres) == 0:
        return None
    z = occupied[:, 2] if len(occupied) > 0 else centres[:, 2]
    heights = Normalize(float(z.min()), max(float(z.max()), float(z.min()) + data.voxel_m))
    colours = np.concatenate(
        [_HEIGHT_COLOURS(heights(occupied[:, 2]))[:, :3], np.tile(to_rgb(MISSED), (len(missed), 1))]
    )
    return _Model(centres, colours, heights)


def _drawn(model: _Model, data: ReportData, camera: Camera) -> bytes:
    rendering = render(model.centres_m, model.colours, data.voxel_m, camera, _RENDER_PX)
    left, right, bottom, top = rendering.extent_m

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        axes.imshow(rendering.rgb, extent=rendering.extent_m, interpolation="bilinear")
        add_scale_bar(axes, right - left)

    height = float(np.clip(_WIDTH_IN * (top - bottom) / (right - left) + 0.8, 3.0, 7.8))
    return picture(_WIDTH_IN, height, draw)
