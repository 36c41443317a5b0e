"""Faces with any number of corners as triangles."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_ROUNDING = 1e-9


def triangulated(vertices: Array, corners: Indices, counts: Indices) -> tuple[Indices, tuple[str, ...]]:
    """Triangles that cover the faces, in the order of the faces.

    A convex face becomes a fan around its first corner. A fan around a corner of another one would cover what lies
    outside of it, such as the doorway in a wall that goes around it: those are cut by their ears.

    Args:
        vertices: (n, 3).
        corners: (k,) indices of vertices below n, face after face.
        counts: (f,) how many of them each face has.

    Returns:
        (m, 3) indices of vertices, and remarks about faces that are not among them.
    """
    if (counts == 3).all():
        return corners.reshape(-1, 3), ()
    first = np.cumsum(counts) - counts
    pieces, owners, flat = [], [], 0
    for count in np.unique(counts[counts >= 3]).tolist():
        faces = np.flatnonzero(counts == count)
        polygons = corners[first[faces, None] + np.arange(count)]
        convex = np.ones(len(faces), np.bool_) if count == 3 else _convex(vertices[polygons])
        fans = polygons[convex]
        for k in range(1, count - 1):
            pieces.append(fans[:, [0, k, k + 1]])
            owners.append(faces[convex])
        for face, polygon in zip(faces[~convex].tolist(), polygons[~convex], strict=True):
            ears = polygon[_ears(vertices[polygon])]
            flat += len(ears) == 0
            pieces.append(ears)
            owners.append(np.full(len(ears), face))
    order = np.argsort(np.concatenate([np.empty(0, np.int64), *owners]), kind="stable")
    triangles = np.concatenate([np.empty((0, 3), np.int64), *pieces])[order]
    remarks = []
    if few := int(np.sum(counts < 3)):
        remarks.append(f"{few} faces with fewer than three corners are left out")
    if flat:
        remarks.append(f"{flat} faces that enclose nothing are left out")
    return triangles, tuple(remarks)


def _convex(corners: Array) -> NDArray[np.bool_]:
    """Whether no corner of each polygon (f, k, 3) turns the other way than the polygon itself."""
    away = corners - corners[:, :1]
    normal = np.cross(away, np.roll(away, -1, axis=1)).sum(axis=1)
    sides = np.roll(corners, -1, axis=1) - corners
    turns = np.cross(np.roll(sides, 1, axis=1), sides)
    along = np.einsum("fkc,fc->fk", turns, normal)
    return np.asarray((along >= -_ROUNDING * np.sum(normal**2, axis=1)[:, None]).all(axis=1))


def _ears(corners: Array) -> Indices:
    """(t, 3) numbers of the corners (k, 3) of one polygon, seen along its normal."""
    from mapbox_earcut import triangulate_float64

    away = corners - corners[0]
    normal = np.cross(away, np.roll(away, -1, axis=0)).sum(axis=0)
    seen = np.delete(away, np.argmax(np.abs(normal)), axis=1)
    found = triangulate_float64(np.ascontiguousarray(seen), np.array([len(corners)], np.uint32))
    ears: Indices = found.reshape(-1, 3).astype(np.int64)
    # The reader of a plan and the writer of the ears need not agree on which way round a face goes.
    turned = np.cross(*(away[ears[:, k]] - away[ears[:, 0]] for k in (1, 2))).sum(axis=0)
    return ears if turned @ normal >= 0.0 else ears[:, ::-1]
