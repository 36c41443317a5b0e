"""Draws voxels as shaded cubes, in parallel projection: a z-buffer made of array operations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sitl.report.data import Array, Points

Floats = NDArray[np.float32]

_SAMPLES = 2  # a pixel along each axis
_FACE_LIGHT = np.array([0.82, 0.68, 1.0], np.float32)  # faces across x, y and z
_SHADE_REACH_M = 1.5
_SHADE_STRENGTH = 1.4


@dataclass(frozen=True, slots=True)
class Camera:
    """Where the viewer stands, infinitely far away: ``azimuth_rad`` counter-clockwise from east, above the horizon."""

    azimuth_rad: float
    elevation_rad: float

    @property
    def axes(self) -> Array:
        """(3, 3): the directions in the world of right, up and towards the viewer, one in each row."""
        ca, sa = np.cos(self.azimuth_rad), np.sin(self.azimuth_rad)
        ce, se = np.cos(self.elevation_rad), np.sin(self.elevation_rad)
        return np.array([[-sa, ca, 0.0], [-se * ca, -se * sa, ce], [ce * ca, ce * sa, se]])


@dataclass(frozen=True, slots=True, eq=False)
class Rendering:
    """What `render` drew.

    Attributes:
        rgb: (rows, columns, 3) uint8, row 0 on top; white where nothing is.
        pixel_m: how large a pixel is, for lengths across the picture.
    """

    rgb: NDArray[np.uint8]
    pixel_m: float


def render(centres_m: Points, colours: Array, voxel_m: float, camera: Camera, box_px: tuple[int, int]) -> Rendering:
    """Draws cubes as large as they fit.

    Args:
        centres_m: (n, 3), at least one.
        colours: (n, 3) red, green and blue from 0 to 1.
        voxel_m: edge length of the cubes, whose edges run along the world's axes.
        camera: from where.
        box_px: the greatest width and height of the result.
    """
    seen = np.asarray(centres_m, dtype=np.float64) @ camera.axes.T
    low, high = seen[:, :2].min(axis=0) - 2.0 * voxel_m, seen[:, :2].max(axis=0) + 2.0 * voxel_m
    pixel = float(((high - low) / box_px).max())
    sample = pixel / _SAMPLES
    columns, rows = (_SAMPLES * int(np.ceil(extent / pixel - 1e-6)) for extent in high - low)

    # The cubes lie on a grid, so sorting their centres by depth sorts the cubes: the greatest rank is what one sees.
    order = np.argsort(seen[:, 2])
    at_column = ((seen[order, 0] - low[0]) / sample).astype(np.int64)
    at_row = rows - 1 - ((seen[order, 1] - low[1]) / sample).astype(np.int64)
    flat, rank = at_row * columns + at_column, np.arange(len(order))
    # A sample more than the cube: centres are rounded to samples, and no crack may open between two of them.
    offsets, faces, rises_m = _stamp(voxel_m + sample, sample, camera)
    winner = np.full(rows * columns, -1)
    for k, (right, up) in enumerate(offsets):
        np.maximum.at(winner, flat + (right - up * columns), rank * len(offsets) + k)

    rgb, depth = _resolved(
        winner.reshape(rows, columns),
        _FACE_LIGHT[faces],
        rises_m.astype(np.float32),
        colours[order].astype(np.float32),
        seen[order, 2].astype(np.float32),
    )
    rgb *= _shade(depth, pixel, voxel_m)[..., None]
    return Rendering((255.0 * np.clip(rgb, 0.0, 1.0)).astype(np.uint8), pixel)


def _stamp(edge_m: float, sample_m: float, camera: Camera) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
    """The outline of one cube in samples.

    Returns:
        (k, 2) offsets from the centre to the right and up; (k,) which face is seen there, 0, 1 or 2 for the one across
        x, y or z; (k,) how much nearer than the centre it is, in m.
    """
    reach = int(np.ceil(edge_m / sample_m))  # half the diagonal of a cube is 0.87 of its edge
    steps = np.arange(-reach, reach + 1)
    offsets = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
    right, up, towards = camera.axes
    on_plane = sample_m * (offsets[:, :1] * right + offsets[:, 1:] * up)
    # Going away from the viewer, a line of sight is inside the cube once it has entered all three of its slabs.
    slope = np.where(np.abs(towards) < 1e-9, 1e-9, towards)
    enter = (np.sign(slope) * edge_m / 2 - on_plane) / slope
    face = np.argmin(enter, axis=1)
    rise = enter[np.arange(len(face)), face]
    on_cube = on_plane + rise[:, None] * slope
    inside = (np.abs(on_cube) <= edge_m / 2 * (1 + 1e-6)).all(axis=1)
    return offsets[inside], face[inside], rise[inside]


def _resolved(
    winner: NDArray[np.int64], light: Floats, rises_m: Floats, colours: Floats, depths_m: Floats
) -> tuple[Floats, Floats]:
    """The mean colour of the samples of each pixel (rows, columns, 3) on white, and their nearest depth.

    ``light`` and ``rises_m`` belong to the parts of a cube, ``colours`` and ``depths_m`` to the cubes.
    """
    rows, columns = winner.shape[0] // _SAMPLES, winner.shape[1] // _SAMPLES
    samples = winner.reshape(rows, _SAMPLES, columns, _SAMPLES).swapaxes(1, 2).reshape(rows * columns, _SAMPLES**2)
    drawn = np.flatnonzero(samples.max(axis=1) >= 0)
    samples = samples[drawn]

    cube = samples // len(light)  # -1, the last entry: the background
    part = samples - cube * len(light)
    lit = np.where(samples < 0, np.float32(1.0), light[part])
    colours = np.append(colours, np.ones((1, 3), np.float32), axis=0)
    depths_m = np.append(depths_m, np.float32(-np.inf))
    rgb = np.ones((rows * columns, 3), np.float32)
    rgb[drawn] = np.einsum("ps,psc->pc", lit, colours[cube]) / np.float32(_SAMPLES**2)
    depth = np.full(rows * columns, -np.inf, np.float32)
    depth[drawn] = (depths_m[cube] + rises_m[part]).max(axis=1)
    return rgb.reshape(rows, columns, 3), depth.reshape(rows, columns)


def _shade(depth_m: Floats, pixel_m: float, voxel_m: float) -> Floats:
    """How much light is left: less than 1 where the surroundings stand nearer to the viewer, as in corners.

    The depth buffer against itself, softened more and more (an unsharp mask; Luft, Colditz, Deussen 2006): it needs no
    normals and no rays. Softening by less than half a voxel would only show that a map has noise. A difference counts
    in proportion to how far was softened, and at most once, so that what floats high above does not blacken what is
    below it.
    """
    known = np.isfinite(depth_m)
    depth = np.where(known, depth_m, np.float32(0.0))
    field, weight, dark = depth, known.astype(np.float32), np.zeros_like(depth)
    step, counted, variance_px2 = 1, 0, 0.0
    while counted == 0 or step * pixel_m < _SHADE_REACH_M:
        field, weight = _softened(field, step), _softened(weight, step)
        variance_px2 += step**2 / 2
        softened_m = pixel_m * variance_px2**0.5
        if softened_m > voxel_m / 2:
            around = field / np.maximum(weight, np.float32(1e-6))
            dark += np.clip((around - depth) / np.float32(softened_m), 0.0, 1.0)
            counted += 1
        step *= 2
    return np.where(known, np.exp(dark * np.float32(-_SHADE_STRENGTH / counted)), np.float32(1.0))


def _softened(field: Floats, step: int) -> Floats:
    """The field under the window (1, 2, 1)/4 along both axes, spread by ``step`` pixels; zero beyond the border."""
    for turned in (False, True):
        source = field.T if turned else field
        total = 2.0 * source
        total[step:] += source[:-step]
        total[:-step] += source[step:]
        total *= 0.25
        field = total.T if turned else total
    return field
