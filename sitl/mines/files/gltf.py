"""glTF 2.0, as one binary file (.glb) or as JSON with files beside it (.gltf)."""

from __future__ import annotations

import json
import struct
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from sitl.mines.files.geometry import NO_TRIANGLES, Geometry, UnreadableError, single_step

_READ = {4, 5}
_MODES = {0: "points", 1: "lines", 2: "line loops", 3: "line strips", 6: "triangle fans"}
"""Kinds of primitives beside triangles (4) and strips of them (5)."""

_HARMLESS = ("KHR_materials_", "KHR_texture_", "EXT_texture_", "KHR_lights_", "MSFT_texture_", "KHR_xmp")
"""Extensions that do not change where the surface is."""


def read_gltf(path: Path) -> Geometry:
    """The triangles of the scene, each node at its place. The standard's up is y and its unit the metre.

    Raises:
        UnreadableError: damaged, or the file needs what is not read, such as compressed meshes.
    """
    import trimesh

    header = _header(path)
    needed = [str(name) for name in header.get("extensionsRequired", [])]
    if unknown := [name for name in needed if not name.startswith(_HARMLESS)]:
        raise UnreadableError(
            f"needs {', '.join(unknown)}, which is not read: open it in Blender and export it without compression"
        )
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            scene = trimesh.load_scene(str(path), process=False, skip_materials=True)
        parts = [mesh for mesh in scene.dump() if isinstance(mesh, trimesh.Trimesh)]
    except Exception as error:
        raise UnreadableError(f"no mesh can be read: damaged or not what its name says: {error}") from error
    remarks = _left_out(header)
    if not parts:
        return Geometry(np.empty((0, 3)), NO_TRIANGLES, remarks=remarks)
    vertices = np.concatenate([np.asarray(part.vertices, np.float64) for part in parts])
    first = np.cumsum([0] + [len(part.vertices) for part in parts])
    # Nodes are placed in double precision, what hangs on them is not kept in it.
    step = max(single_step(part.vertices) for part in scene.geometry.values())
    triangles = np.concatenate([np.asarray(part.faces, np.int64) + k for part, k in zip(parts, first, strict=False)])
    return Geometry(vertices, triangles, up="y", step=step, remarks=remarks)


def _header(path: Path) -> dict[str, Any]:
    data = path.read_bytes()
    try:
        if path.suffix.lower() == ".glb":
            magic, _, size, length, kind = struct.unpack_from("<4sIII4s", data)
            if magic != b"glTF" or kind != b"JSON":
                raise ValueError("it does not begin as the standard says")
            if size > len(data):
                raise ValueError(f"it should have {size} bytes and ends after {len(data)}")
            data = data[20 : 20 + length]
        header = json.loads(data)
        if not isinstance(header, dict):
            raise ValueError("its JSON is not an object")
    except (ValueError, struct.error) as error:
        raise UnreadableError(f"no mesh can be read: damaged or not what its name says: {error}") from None
    return header


def _left_out(header: dict[str, Any]) -> tuple[str, ...]:
    remarks = []
    primitives = [each for mesh in header.get("meshes", []) for each in mesh.get("primitives", [])]
    for mode, name in _MODES.items():
        if count := sum(each.get("mode", 4) == mode for each in primitives):
            remarks.append(f"{count} primitives of {name} are left out")
    if header.get("skins"):
        remarks.append("skins are left out: what they bend stands as it was modelled")
    if header.get("animations"):
        remarks.append("animations are left out: everything stands as it was modelled")
    return tuple(remarks)
