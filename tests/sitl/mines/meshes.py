"""A room of 10 x 4 x 3 m in the forms in which people's tools write it, and whether it came in as it is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh

from sitl.mines import World, load_world
from sitl.mines.mesh import open_edges

BOX = "v 0 0 0\nv 10 0 0\nv 10 4 0\nv 0 4 0\nv 0 0 3\nv 10 0 3\nv 10 4 3\nv 0 4 3\n"
QUADS = "f 1 2 3 4\nf 5 8 7 6\nf 1 5 6 2\nf 2 6 7 3\nf 3 7 8 4\nf 4 8 5 1\n"


def box() -> trimesh.Trimesh:
    """A closed room of 10 x 4 x 3 m with one corner at 0."""
    mesh: trimesh.Trimesh = trimesh.creation.box((10, 4, 3))
    mesh.apply_translation((5.0, 2.0, 1.5))
    return mesh


def world_of(path: Path, content: str | bytes) -> World:
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return load_world(str(path), 0, (5.0, 2.0, 1.5, 0.0))


def area_m2(world: World) -> float:
    corners = world.vertices_m[world.triangles].astype(np.float64)
    crossed = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return float(np.linalg.norm(crossed, axis=1).sum() / 2)


def open_edges_of(world: World) -> int:
    return open_edges(world.vertices_m.astype(np.float64), world.triangles.astype(np.int64))


def is_the_box(world: World) -> bool:
    """Whether it is closed and has the size and the surface of the box."""
    low, high = world.vertices_m.min(axis=0), world.vertices_m.max(axis=0)
    same = np.allclose([*low, *high], [0, 0, 0, 10, 4, 3], atol=1e-5)
    return bool(same and open_edges_of(world) == 0 and np.isclose(area_m2(world), 2 * (40 + 30 + 12), atol=1e-3))
