"""Collada (.dae), with the unit and the axis that the file names."""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sitl.mines.files.geometry import NO_TRIANGLES, Geometry, UnreadableError, Up, single_step
from sitl.mines.files.polygons import triangulated


def read_collada(path: Path) -> Geometry:
    """The faces of all meshes of the scene, each node at its place.

    Raises:
        UnreadableError: damaged, or it refers to what is not there.
    """
    import collada

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            document = collada.Collada(str(path))
            if document.scene is None:
                raise UnreadableError("no mesh can be read: the file names no scene")
            meshes = list(document.scene.objects("geometry"))
    except UnreadableError:
        raise
    except Exception as error:
        raise UnreadableError(f"no mesh can be read: damaged or not what its name says: {error}") from error
    up: Up = {"Y_UP": "y", "Z_UP": "z"}.get(str(document.assetInfo.upaxis), "")  # type: ignore[assignment]
    if not up:
        raise UnreadableError(f"its up axis is {document.assetInfo.upaxis}: save it with Z_UP or Y_UP")
    remarks = list(_left_out(document, {mesh.original.id: mesh.original for mesh in meshes}))
    vertices, triangles, first = [np.empty((0, 3))], [NO_TRIANGLES], 0
    kept: dict[str, NDArray[np.float64]] = {}
    for mesh in meshes:
        matrix = np.asarray(mesh.matrix, np.float64)
        for primitive in mesh.original.primitives:
            if not isinstance(primitive, collada.triangleset.TriangleSet | collada.polylist.Polylist):
                continue
            if primitive.vertex_index is None or len(primitive.vertex_index) == 0:
                continue
            points = _points(primitive.sources["VERTEX"][0][4], kept)
            corners, counts = _corners(primitive)
            if corners.min() < 0:
                raise UnreadableError(f"a face names vertex {corners.min()}")
            faces, dropped = triangulated(points, corners, counts)
            vertices.append(points @ matrix[:3, :3].T + matrix[:3, 3])
            triangles.append(faces + first)
            first += len(points)
            remarks += dropped
    unit_m = document.assetInfo.unitmeter
    return Geometry(
        np.concatenate(vertices),
        np.concatenate(triangles),
        up=up,
        unit_m=1.0 if unit_m is None else float(unit_m),
        step=max((single_step(np.asarray(mesh.matrix)[:3, 3]) for mesh in meshes), default=0.0),
        remarks=tuple(remarks),
    )


def _left_out(document: Any, shown: dict[str, Any]) -> Iterator[str]:
    """What stands in a document and is not among its faces; ``shown`` are the geometries of the scene."""
    if skinned := len(list(document.scene.objects("controller"))):
        yield f"{skinned} skinned meshes are left out"
    if unused := len({each.id for each in document.geometries} - set(shown)):
        yield f"{unused} meshes that the scene does not show are left out"
    groups = Counter(
        each.tag.rpartition("}")[2] for geometry in shown.values() for mesh in geometry.xmlnode for each in mesh.iter()
    )
    for name in ("lines", "linestrips"):
        if groups[name]:
            yield f"{groups[name]} groups of {name} are left out"
    if groups["ph"]:
        yield f"{groups['ph']} polygons with holes are left out"


def _points(source: Any, kept: dict[str, NDArray[np.float64]]) -> NDArray[np.float64]:
    """(n, 3) of a source, from its text: the library keeps single precision, and 0 in the place of NaN."""
    if source.id not in kept:
        array = next(each for each in source.xmlnode if each.tag.endswith("float_array"))
        kept[source.id] = np.array(array.text.split(), np.float64).reshape(-1, len(source.components))[:, :3]
    return kept[source.id]


def _corners(primitive: Any) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    index = np.asarray(primitive.vertex_index, np.int64)
    if index.ndim == 2:
        return index.ravel(), np.full(len(index), index.shape[1])
    return index, np.asarray(primitive.vcounts, np.int64)
