"""A surface around a cloud of points: the voxels that hold points, with small gaps between them closed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Keys = NDArray[np.int64]

CLOSED_VOXELS = 2
"""Gaps of up to so many voxels are closed."""

MOST_VOXELS = 2_000_000
"""Of more, the surface has more triangles than a flight can be simulated with: some 2 GB."""

_BLOCK = 4_000_000
_BITS, _BORDER = 20, 4
"""Of a key for each axis, and empty voxels all around, so that keys never run over from one axis to the next."""

_MOST = 2**_BITS - 2 * _BORDER
_STEPS = (1, 1 << _BITS, 1 << 2 * _BITS)
"""What one voxel along x, y and z adds to a key."""


class TooManyVoxelsError(Exception):
    """The voxels are too small for the cloud."""


@dataclass(frozen=True, slots=True, eq=False)
class Closed:
    """A cloud's surface.

    Attributes:
        vertices_m: (n, 3) corners of voxels.
        triangles: (m, 3) indices into ``vertices_m``, two for each face between a full voxel and an empty one, which
            face the empty one.
        points_per_voxel: the median of the voxels that hold points.
        voxels: how many hold points, and how many more were filled.
    """

    vertices_m: Array
    triangles: NDArray[np.int64]
    points_per_voxel: float
    voxels: int
    filled: int


def closed_surface(points_m: Array, voxel_m: float) -> Closed:
    """The surface of the voxels that hold points, after a morphological closing.

    A voxel is filled, too, if each of the 27 boxes of 3 x 3 x 3 voxels that it is part of meets one that holds points:
    holes and slits of up to `CLOSED_VOXELS` across are closed in walls of any direction, and sharp corners as far.

    Args:
        points_m: (n, 3), finite.
        voxel_m: edge of a voxel.

    Raises:
        TooManyVoxelsError: more than `MOST_VOXELS`, or more than 2^20 along an axis.
    """
    low = np.floor(points_m.min(axis=0) / voxel_m)
    span = np.floor(points_m.max(axis=0) / voxel_m) - low
    if span.max() > _MOST:
        raise TooManyVoxelsError(f"{span.max():.0f} voxels in a row, of at most {_MOST}")
    full, counts = _full(points_m, voxel_m, low)
    solid = full
    for step in _STEPS:
        solid = np.unique(np.concatenate([solid - step, solid, solid + step]))
    for step in _STEPS:
        solid = solid[_among(solid - step, solid) & _among(solid + step, solid)]
    vertices, triangles = _faces(solid)
    return Closed(
        (vertices - _BORDER + low) * voxel_m, triangles, float(np.median(counts)), len(full), len(solid) - len(full)
    )


def _full(points_m: Array, voxel_m: float, low: Array) -> tuple[Keys, NDArray[np.int64]]:
    """The voxels that hold points, sorted, and how many each holds; block by block, so that memory stays bounded."""
    full, counts = np.empty(0, np.int64), np.empty(0, np.int64)
    for begin in range(0, len(points_m), _BLOCK):
        cells = (np.floor(points_m[begin : begin + _BLOCK] / voxel_m) - low).astype(np.int64) + _BORDER
        more, of_more = np.unique(cells @ np.array(_STEPS), return_counts=True)
        full, place = np.unique(np.concatenate([full, more]), return_inverse=True)
        counts = np.bincount(place, np.concatenate([counts, of_more])).astype(np.int64)
        if len(full) > MOST_VOXELS:
            raise TooManyVoxelsError(f"{len(full)} voxels or more hold points, of at most {MOST_VOXELS}")
    return full, counts


def _among(keys: Keys, of: Keys) -> NDArray[np.bool_]:
    """Which keys, sorted, are among other sorted ones."""
    place = np.minimum(np.searchsorted(of, keys), len(of) - 1)
    return np.asarray(of[place] == keys)


def _faces(solid: Keys) -> tuple[Array, NDArray[np.int64]]:
    """The corners and triangles of the faces between solid voxels and others."""
    quads = []
    for axis, step in enumerate(_STEPS):
        # Two sides of a face, so turned that they and the axis follow the right hand.
        side, other = _STEPS[(axis + 1) % 3], _STEPS[(axis + 2) % 3]
        around = np.array([0, side, side + other, other])
        quads.append((solid[~_among(solid + step, solid)] + step)[:, None] + around)
        quads.append(solid[~_among(solid - step, solid)][:, None] + around[::-1])
    corners, index = np.unique(np.concatenate(quads), return_inverse=True)
    index = index.reshape(-1, 4)
    triangles = np.concatenate([index[:, [0, 1, 2]], index[:, [0, 2, 3]]])
    mask = (1 << _BITS) - 1
    return np.stack([corners >> shift & mask for shift in (0, _BITS, 2 * _BITS)], axis=1).astype(np.float64), triangles
