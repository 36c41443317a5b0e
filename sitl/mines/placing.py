"""From the unit, the axes and the origin of a file to metres, z up, near the origin."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from companion.errors import InputError
from sitl.mines.files.geometry import Geometry, Up

Array = NDArray[np.float64]

MOST_EXTENT_M, MOST_HEIGHT_M, LEAST_EXTENT_M = 20_000.0, 2_000.0, 2.0
"""No mine that can be flown is longer or higher, nor shorter."""

FAR_M, ORIGIN_STEP_M = 1_000.0, 100.0
"""A mine that begins further away than this along an axis gets an origin there, a multiple of the step. At 1 km single
precision, in which worlds are kept, has steps of 0.06 mm."""

WORST_STEP_M, COARSE_STEP_M = 0.05, 0.002
"""Coordinates that were written in steps above the first are refused, and above the second told."""

_UNITS = ((0.001, "millimetres"), (0.01, "centimetres"))
_DRIFT_M = 1.2
"""No mine that can be flown is lower."""

_Z_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


@dataclass(frozen=True, slots=True)
class Reading:
    """How a mesh file is to be read; ``None`` leaves it to the file.

    Attributes:
        scale: what one unit of the file is in m.
        up: the axis of the file that points up.
        cloud_voxel_m: edge of the voxels that the surface of a cloud of points is made of.
    """

    scale: float | None = None
    up: Up | None = None
    cloud_voxel_m: float = 0.2

    def __post_init__(self) -> None:
        if self.scale is not None and not 0.0 < self.scale < math.inf:
            raise InputError(f"--scale {self.scale:g}: must be a number above 0: what one unit of the file is in m")
        if not 0.01 <= self.cloud_voxel_m <= 2.0:
            raise InputError(f"--cloud-voxel {self.cloud_voxel_m:g}: must be from 0.01 to 2 m")

    def options(self) -> tuple[str, ...]:
        """The same for a command."""
        parts = {"--scale": self.scale, "--up": self.up, "--cloud-voxel": self.cloud_voxel_m}
        return tuple(text for name, value in parts.items() if value is not None for text in (name, str(value)))


@dataclass(frozen=True, slots=True, eq=False)
class Placed:
    """Vertices in m, z up, after the shift.

    Attributes:
        vertices_m: (n, 3) float64.
        scale: what one unit of the file was taken for, in m.
        origin_m: (3,) where the shifted origin is in the coordinates of the file, in m with z up; zero if not shifted.
        remarks: what people should know of it, the extent first.
    """

    vertices_m: Array
    scale: float
    origin_m: Array
    remarks: tuple[str, ...]


def placed(path: Path, geometry: Geometry, reading: Reading) -> Placed:
    """Scale, turn and shift a file's vertices.

    Raises:
        InputError: the size is none of a mine, or the coordinates are too coarse where they are.
    """
    scale = geometry.unit_m if reading.scale is None else reading.scale
    up = geometry.up if reading.up is None else reading.up
    vertices = geometry.vertices * scale if scale != 1.0 else geometry.vertices
    if up == "y":
        vertices = vertices @ _Z_UP.T
    is_used = np.full(len(vertices), len(geometry.triangles) == 0)
    is_used[geometry.triangles] = True
    used = vertices[is_used]
    low, high = used.min(axis=0), used.max(axis=0)
    _check_size(path, low, high, scale)
    # A mine that reaches to the origin stays where it is, to the last bit.
    away = np.where(low > FAR_M, low, np.where(high < -FAR_M, high, 0.0))
    origin = np.where(away != 0.0, np.round((low + high) / 2 / ORIGIN_STEP_M) * ORIGIN_STEP_M, 0.0)
    remarks = [_extent(low, high, scale, up, geometry)]
    if reading.up is None and geometry.up == "z" and high[1] - low[1] < min(high[0] - low[0], high[2] - low[2]):
        remarks.append("the shortest extent is along y: if the mesh lies on its side, it is y up: --up y")
    remarks += _coarse(path, geometry.step * scale)
    if origin.any():
        remarks.append(
            f"far from 0: {_numbers(origin)} m is the origin of all that is written, kept beside it as origin_m"
        )
        vertices = vertices - origin
    return Placed(vertices, scale, origin, tuple(remarks))


def _check_size(path: Path, low: Array, high: Array, scale: float) -> None:
    extent = high - low
    if extent.max() <= MOST_EXTENT_M and extent[2] <= MOST_HEIGHT_M and extent.max() >= LEAST_EXTENT_M:
        return
    said = f"world {path}: {_numbers(extent, ' x ')} m with --scale {scale:g}"
    if extent.max() < LEAST_EXTENT_M:
        raise InputError(
            f"{said}: no mine is shorter than {LEAST_EXTENT_M:g} m. Is its unit the kilometre, --scale {scale * 1000:g}"
            ", or was it scaled to 1? Say with --scale what one unit is in m"
        )
    for factor, unit in _UNITS:
        there = extent * factor
        if there[2] >= _DRIFT_M and there.max() <= MOST_EXTENT_M and there[2] <= MOST_HEIGHT_M:
            guess = f"this looks like {unit}: --scale {scale * factor:g}, which makes it {_numbers(there, ' x ')} m"
            break
    else:
        guess = "is a vertex far away from all others? Otherwise say with --scale what one unit is in m"
    raise InputError(f"{said}: no mine is longer than {MOST_EXTENT_M:g} m or higher than {MOST_HEIGHT_M:g} m; {guess}")


def _extent(low: Array, high: Array, scale: float, up: Up, geometry: Geometry) -> str:
    kind = f"{len(geometry.triangles)} triangles" if len(geometry.triangles) else f"{len(geometry.vertices)} points"
    scaled = "" if scale == 1.0 else f", one unit being {scale:g} m"
    if up == "y":
        scaled += ", the file's y being up"
    # Rounded first, and with 0 added: there is no minus 0.
    ends = np.round([low, high], 2).T + 0.0
    bounds = ", ".join(f"{axis} {a:.2f} to {b:.2f}" for axis, (a, b) in zip("xyz", ends, strict=True))
    return f"{kind}, {_numbers(high - low, ' x ')} m ({bounds}){scaled}"


def _coarse(path: Path, step_m: float) -> list[str]:
    if step_m > WORST_STEP_M:
        raise InputError(
            f"world {path}: its single precision has steps of {step_m:.2g} m so far from 0: walls are not where they "
            "were. Export it nearer to 0, or as PLY or OBJ in double precision"
        )
    if step_m > COARSE_STEP_M:
        return [f"its single precision has steps of {1000 * step_m:.0f} mm so far from 0"]
    return []


def _numbers(values: Array, between: str = ", ") -> str:
    return between.join(f"{value:.2f}".rstrip("0").rstrip(".") for value in values)
