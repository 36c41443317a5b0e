"""The surface, read by trimesh and Open3D, against rooms and tunnels whose walls are known."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import open3d
import pytest
import trimesh

from companion.mapping import VoxelMap
from companion.mapping.files import write_mesh
from companion.mapping.voxels.piece import MapSource
from companion.model import FloatArray
from tests.mapping.files.sources import (
    FREE_VALUE,
    OCCUPIED_VALUE,
    ROOM_HALF_M,
    Held,
    inside_room_m,
    of_solid,
    of_voxels,
    room,
    scattered,
)
from tests.mapping.voxels.scenes import EXACT, camera, frame, pose, room_depth


def _mesh(source: MapSource, path: Path) -> trimesh.Trimesh:
    write_mesh(source, path)
    mesh = trimesh.load(path, process=False)
    assert isinstance(mesh, trimesh.Trimesh)
    return mesh


def _inside_tunnel_m(points: FloatArray) -> FloatArray:
    """How far points are inside a tunnel of 2 m radius with round ends, in a direction that is no axis's."""
    along = np.array([0.8, 0.5, math.sqrt(1.0 - 0.64 - 0.25)])
    t = np.clip(points @ along, -4.0, 4.0)
    return np.asarray(2.0 - np.linalg.norm(points - t[..., np.newaxis] * along, axis=-1))


def _tunnel() -> Held:
    return of_solid(_inside_tunnel_m, (-4, -3, -3), (3, 2, 2))


@pytest.mark.parametrize("suffix", [".ply", ".obj"])
def test_a_closed_room_is_closed(suffix: str, tmp_path: Path) -> None:
    """Protects from cracks, above all between chunks, and from triangles that face the rock."""
    mesh = _mesh(room(), tmp_path / f"map{suffix}")
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    # A ball's: one piece without handles.
    assert mesh.euler_number == 2
    # The free side is inside, so seen as a solid the room is inside out.
    assert -mesh.volume == pytest.approx(8.0 * ROOM_HALF_M.prod(), rel=0.12)
    centres, normals = mesh.triangles_center, mesh.face_normals
    assert np.mean(inside_room_m(centres + 0.05 * normals) > inside_room_m(centres)) > 0.99


def test_open3d_reads_the_same_mesh(tmp_path: Path) -> None:
    """Protects the second reader that people use."""
    theirs = _mesh(room(), tmp_path / "map.ply")
    mesh = open3d.io.read_triangle_mesh(tmp_path / "map.ply")
    assert np.allclose(np.asarray(mesh.vertices), theirs.vertices)
    assert (np.asarray(mesh.triangles) == theirs.faces).all()
    # Text with four decimals.
    write_mesh(room(), tmp_path / "map.obj")
    mesh = open3d.io.read_triangle_mesh(tmp_path / "map.obj")
    assert len(mesh.triangles) == len(theirs.faces)
    assert np.allclose(np.sort(np.asarray(mesh.vertices), axis=0), np.sort(theirs.vertices, axis=0), atol=0.0001)


@pytest.mark.parametrize(
    ("source", "inside_m"), [(room(), inside_room_m), (_tunnel(), _inside_tunnel_m)], ids=["r", "t"]
)
def test_walls_are_where_they_are(source: Held, inside_m: object, tmp_path: Path) -> None:
    """Protects the surveyor: the surface is within half a voxel of the true wall in the mean, and within one always.

    A voxel is occupied when the wall is anywhere in it, so without any noise that is what a voxel can tell.
    """
    mesh = _mesh(source, tmp_path / "map.ply")
    error_m = inside_m(mesh.vertices)  # type: ignore[operator]
    assert np.abs(error_m).mean() < 0.5 * source.voxel_m
    # In a corner of the room the vertex is the mean of three walls.
    assert np.percentile(np.abs(error_m), 99) < source.voxel_m


def test_a_room_that_was_seen(tmp_path: Path) -> None:
    """Protects the same through the map itself: depth images of a room that stands askew."""
    low, high, turn = np.array([-2.03, -1.82, -1.37]), np.array([2.16, 1.94, 1.51]), 0.3
    cam, voxels = camera(160, 120), VoxelMap(EXACT)
    for yaw in np.arange(0.0, 2.0 * math.pi, 0.5):
        for pitch in (-0.7, 0.0, 0.7):
            at = pose(0.1, -0.2, 0.05, yaw=yaw, pitch=pitch)
            x, y = (math.cos(turn) * 0.1 + math.sin(turn) * 0.2, math.sin(turn) * 0.1 - math.cos(turn) * 0.2)
            voxels.integrate(frame(cam, pose(x, y, 0.05, yaw=yaw + turn, pitch=pitch), room_depth(cam, at, low, high)))
    mesh = _mesh(voxels, tmp_path / "map.ply")
    c, s = math.cos(turn), math.sin(turn)
    points = np.stack(
        [c * mesh.vertices[:, 0] + s * mesh.vertices[:, 1], c * mesh.vertices[:, 1] - s * mesh.vertices[:, 0]], axis=1
    )
    points = np.column_stack([points, mesh.vertices[:, 2]])
    error_m = np.minimum(points - low, high - points).min(axis=1)
    assert len(points) > 5000
    assert np.abs(error_m).mean() < 0.5 * voxels.voxel_m


def test_no_surface_towards_the_unknown(tmp_path: Path) -> None:
    """Protects from walls that nobody saw: where free or occupied meets unknown, or is not decided, it is open."""
    free = {(x, y, z): FREE_VALUE for x in range(-3, 3) for y in range(-3, 3) for z in range(-3, 3)}
    assert len(_mesh_or_none(of_voxels(free), tmp_path)) == 0
    assert len(_mesh_or_none(of_voxels(dict.fromkeys(free, OCCUPIED_VALUE)), tmp_path)) == 0
    undecided = {voxel: 400 if voxel[2] >= 0 else FREE_VALUE for voxel in free}
    assert len(_mesh_or_none(of_voxels(undecided), tmp_path)) == 0
    wall = {voxel: OCCUPIED_VALUE if voxel[2] >= 0 else FREE_VALUE for voxel in free}
    mesh = _mesh(of_voxels(wall), tmp_path / "map.ply")
    # 6 x 6 crossings, a quad each; an open sheet that faces down.
    assert len(mesh.faces) == 72
    assert not mesh.is_watertight
    assert np.allclose(mesh.face_normals, [0.0, 0.0, -1.0])
    assert np.allclose(mesh.vertices[:, 2], mesh.vertices[0, 2])


def _mesh_or_none(source: Held, folder: Path) -> list[str]:
    """The lines of an OBJ that are not comments."""
    write_mesh(source, folder / "none.obj")
    return [line for line in (folder / "none.obj").read_text("ascii").splitlines() if not line.startswith("#")]


def test_the_surface_does_not_depend_on_where_chunks_end(tmp_path: Path) -> None:
    """Protects from seams: the same wall moved by some voxels is the same mesh, moved."""
    rng = np.random.default_rng(0)
    values = {
        (x, y, z): int(rng.integers(847, 3000) if z > 2 + math.sin(x) else -rng.integers(1, 2000))
        for x in range(12)
        for y in range(12)
        for z in range(6)
    }
    here = _mesh(of_voxels(values), tmp_path / "map.ply")
    moved = {(x - 6, y + 10, z - 3): value for (x, y, z), value in values.items()}
    there = _mesh(of_voxels(moved), tmp_path / "map.ply")
    assert len(there.faces) == len(here.faces) > 200
    back = there.triangles_center + np.array([0.6, -1.0, 0.3])
    assert np.allclose(np.sort(back, axis=0), np.sort(here.triangles_center, axis=0), atol=1e-5)


def test_no_triangle_is_degenerate(tmp_path: Path) -> None:
    """Protects software that divides by the area: in noise every triangle has one, and every vertex is used."""
    mesh = _mesh(scattered(0, chunks=200), tmp_path / "map.ply")
    assert len(mesh.faces) > 1000
    assert mesh.area_faces.min() > 0.0
    assert (np.bincount(mesh.faces.ravel(), minlength=len(mesh.vertices)) > 0).all()
