"""Draws voxels as shaded cubes, in parallel projection: a z-buffer made of array operations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sitl.report.data import Array, Points

Floats = NDArray[np.float32]

_SUPERSAMPLING = 2
_FACE_LIGHT = np.array([0.80, 0.66, 1.0])  # faces across x, y and z
_SHADES = ((0.15, 3.0), (0.5, 1.6), (1.5, 0.5))  # reach in m and strength in 1/m of what darkens corners


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
        extent_m: (left, right, bottom, top) in the picture's plane, along `Camera.axes`.
    """

    rgb: NDArray[np.uint8]
    extent_m: tuple[float, float, float, float]


def render(centres_m: Points, colours: Array, voxel_m: float, camera: Camera, width_px: int) -> Rendering:
    """Draws cubes.

    Args:
        centres_m: (n, 3), at least one.
        colours: (n, 3) red, green and blue from 0 to 1.
        voxel_m: edge length of the cubes, whose edges run along the world's axes.
        camera: from where.
        width_px: width or height of the result, whichever is larger.
    """
    seen = centres_m @ camera.axes.T
    room = 2.0 * voxel_m
    low, high = seen[:, :2].min(axis=0) - room, seen[:, :2].max(axis=0) + room
    pixel = float((high - low).max()) / (width_px * _SUPERSAMPLING)
    offsets, faces = _stamp(voxel_m + pixel, pixel, camera)
    border = int(np.abs(offsets).max()) + 1
    # Whole blocks of samples in both directions, so that they can be averaged.
    size = -(-np.ceil((high - low) / pixel).astype(np.int64) // _SUPERSAMPLING) * _SUPERSAMPLING
    columns, rows = (int(n) + 2 * border * _SUPERSAMPLING for n in size)
    left, top = low[0] - border * _SUPERSAMPLING * pixel, low[1] + (rows - border * _SUPERSAMPLING) * pixel

    # The cubes lie on a grid, so sorting their centres by depth sorts the cubes: the greatest rank is what one sees.
    order = np.argsort(seen[:, 2])
    at_column = ((seen[order, 0] - left) / pixel).astype(np.int64)
    at_row = ((top - seen[order, 1]) / pixel).astype(np.int64)
    flat, rank = at_row * columns + at_column, np.arange(len(order))
    winner = np.full(rows * columns, -1)
    for k, (right, up) in enumerate(offsets):
        np.maximum.at(winner, flat + (right - up * columns), rank * len(offsets) + k)
    rgb, depth = _resolved(
        winner.reshape(rows, columns),
        _FACE_LIGHT[faces].astype(np.float32),
        colours[order].astype(np.float32),
        seen[order, 2].astype(np.float32),
    )
    rgb *= _shade(depth, pixel * _SUPERSAMPLING)[..., None]
    extent = (float(left), float(left + columns * pixel), float(top - rows * pixel), float(top))
    return Rendering((255.0 * np.clip(rgb, 0.0, 1.0)).astype(np.uint8), extent)


def _resolved(
    winner: NDArray[np.int64], light: Floats, colours: Floats, depths_m: Floats
) -> tuple[Floats, Floats]:
    """Colour (rows, columns, 3) on white, averaged over the samples of each pixel, and the nearest depth of them."""
    rgb, depth = np.float32(0.0), np.float32(-np.inf)
    colours = np.concatenate([colours, np.ones((1, 3), np.float32)])  # index -1: the background
    depths_m = np.append(depths_m, np.float32(-np.inf))
    light = np.append(light, np.float32(1.0))
    parts = len(light) - 1
    for dy, dx in np.ndindex(_SUPERSAMPLING, _SUPERSAMPLING):
        sample = winner[dy::_SUPERSAMPLING, dx::_SUPERSAMPLING]
        cube = sample // parts
        part = np.where(sample < 0, parts, sample - cube * parts)
        rgb = rgb + colours[cube] * light[part][..., None]
        depth = np.maximum(depth, depths_m[cube])
    return rgb / np.float32(_SUPERSAMPLING**2), depth


def _stamp(edge_m: float, pixel_m: float, camera: Camera) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The outline of one cube in samples.

    Returns:
        (k, 2) offsets from the centre to the right and up, and (k,) which face is seen there: 0, 1 or 2 for the one
        across x, y or z.
    """
    reach = int(np.ceil(edge_m / pixel_m))  # half the diagonal of a cube is 0.87 of its edge
    steps = np.arange(-reach, reach + 1)
    offsets = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
    right, up, towards = camera.axes
    on_plane = pixel_m * (offsets[:, :1] * right + offsets[:, 1:] * up)
    # The line of sight through each sample enters the cube at the nearest of the far sides of its three slabs.
    slope = np.where(np.abs(towards) < 1e-9, 1e-9, towards)
    enter = (np.sign(slope) * edge_m / 2 - on_plane) / slope
    face = np.argmin(enter, axis=1)
    on_cube = on_plane + enter[np.arange(len(face)), face, None] * slope
    inside = (np.abs(on_cube) <= edge_m / 2 * (1 + 1e-6)).all(axis=1)
    return offsets[inside], face[inside]


def _shade(depth_m: Floats, pixel_m: float) -> Floats:
    """How much light is left: less than 1 where the surroundings stand nearer to the viewer, as in corners.

    The depth buffer under an unsharp mask (Luft, Colditz, Deussen 2006): it needs no normals and no rays.
    """
    known = np.isfinite(depth_m)
    depth = np.where(known, depth_m, np.float32(0.0))
    weight = known.astype(np.float32)
    dark = np.zeros_like(depth)
    for reach_m, strength in _SHADES:
        reach = max(1, round(reach_m / pixel_m))
        around = _blurred(depth, reach) / np.maximum(_blurred(weight, reach), np.float32(1e-6))
        dark += strength * np.clip(around - depth, 0.0, reach_m)
    return np.asarray(np.where(known, np.exp(-dark), 1.0), dtype=np.float32)


def _blurred(field: Floats, reach: int) -> Floats:
    """The field under a triangular window: a sliding mean of 2 reach + 1 values, twice, along both axes."""
    width = 2 * reach + 1
    for axis in (0, 1, 0, 1):
        padded = np.pad(field, [(reach + 1, reach) if k == axis else (0, 0) for k in (0, 1)])
        total = np.cumsum(padded, axis=axis, dtype=np.float64).swapaxes(0, axis)
        field = ((total[width:] - total[:-width]) / width).swapaxes(0, axis).astype(np.float32)
    return field
