"""Clouds of points become surfaces that are closed where the points are dense, and refused where they are none."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import laspy
import numpy as np
import open3d
import pytest
from laspy.vlrs.known import WktCoordinateSystemVlr
from numpy.typing import NDArray
from pypcd4.pypcd4 import Encoding, PointCloud
from pyproj import CRS

from companion.errors import InputError
from sitl.mines import World, load_world
from sitl.mines.closing import MOST_VOXELS, TooManyVoxelsError, closed_surface
from sitl.mines.mesh import open_edges
from sitl.mines.placing import Reading
from sitl.scene.raycast import RayCaster
from sitl.scene.surface import surface_samples

START = (3.0, 1.8, 1.0, 0.5)


@pytest.fixture(scope="module")
def points_m() -> NDArray[np.float64]:
    """Some 12 points in each voxel of 0.2 m of the walls of the room."""
    points, _ = surface_samples(load_world("room", 0), 0.05)
    return points.astype(np.float64)


def cloud(path: Path, points: NDArray[np.float64]) -> str:
    if path.suffix in (".las", ".laz"):
        header = laspy.LasHeader(version="1.4", point_format=6)
        header.scales, header.offsets = np.full(3, 0.0001), np.floor(points.min(axis=0))
        las = laspy.LasData(header)
        las.x, las.y, las.z = points.T
        las.write(str(path))
    else:
        assert open3d.io.write_point_cloud(path, open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points)))
    return str(path)


def is_closed_room(world: World) -> bool:
    """Whether a vehicle in its middle sees walls all around, nowhere 0.25 m before or behind the true ones."""
    rng = np.random.default_rng(0)
    ways = rng.standard_normal((4000, 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    true = RayCaster(load_world("room", 0))
    assert world.start is not None
    from_there = np.array([world.start.x_m, world.start.y_m, world.start.z_m])
    seen = RayCaster(world).cast(from_there, ways)
    ends = from_there + ways * np.minimum(seen, 1e3)[:, None] + np.array(world.origin_m)
    return bool(np.isfinite(seen).all() and true.distance(ends).max() < 0.25)


@pytest.mark.parametrize("suffix", [".ply", ".pcd", ".las", ".laz"])
def test_a_cloud_becomes_a_closed_room(tmp_path: Path, points_m: NDArray[np.float64], suffix: str) -> None:
    world = load_world(cloud(tmp_path / f"room{suffix}", points_m), 0, START)
    assert is_closed_room(world)
    assert open_edges(world.vertices_m.astype(np.float64), world.triangles.astype(np.int64)) == 0
    assert any("voxels of 0.2 m" in remark for remark in world.remarks)
    assert not any("may have holes" in remark for remark in world.remarks)


def test_a_cloud_far_away_keeps_its_digits(tmp_path: Path, points_m: NDArray[np.float64]) -> None:
    shift = np.array([500_000.0, 6_000_000.0, 0.0])
    start = (START[0] + shift[0], START[1] + shift[1], START[2], START[3])
    world = load_world(cloud(tmp_path / "room.laz", points_m + shift), 0, start)
    assert world.origin_m == tuple(shift)
    assert is_closed_room(replace(world, origin_m=(0.0, 0.0, 0.0)))


def test_holes_of_up_to_two_voxels_are_closed_and_larger_ones_are_not(points_m: NDArray[np.float64]) -> None:
    """In the wall at y = 0, 0.4 m wide and all the height, and 0.8 m wide; both along the voxels."""

    def seen_m(hole: tuple[float, float]) -> float:
        x, y, _ = points_m.T
        left = points_m[~((y < 0.1) & (x > hole[0]) & (x < hole[1]))]
        surface = closed_surface(left, 0.2)
        world = World("c", surface.vertices_m.astype(np.float32), surface.triangles.astype(np.int32), None, left, "")
        middle = np.array([(hole[0] + hole[1]) / 2, 1.8, 1.3])
        return float(RayCaster(world).cast(middle, np.array([0.0, -1.0, 0.0]))[0])

    assert seen_m((4.0, 4.4)) == pytest.approx(1.7, abs=0.15)
    assert np.isinf(seen_m((4.0, 4.8)))


def test_triangles_face_away_from_the_points_and_lie_around_them() -> None:
    surface = closed_surface(np.array([[0.05, 0.05, 0.05]]), 0.1)
    corners = surface.vertices_m[surface.triangles]
    assert corners.shape == (12, 3, 3)
    assert (surface.vertices_m.min(axis=0) == 0.0).all()
    np.testing.assert_allclose(surface.vertices_m.max(axis=0), 0.1)
    volume = np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6.0
    assert volume == pytest.approx(0.001)


def test_a_thin_cloud_is_told(tmp_path: Path, points_m: NDArray[np.float64]) -> None:
    path = cloud(tmp_path / "room.ply", points_m[::20])
    assert any("walls may have holes" in remark for remark in load_world(path, 0, START).remarks)
    wide = load_world(path, 0, START, Reading(cloud_voxel_m=0.5))
    assert not any("may have holes" in remark for remark in wide.remarks)


def test_points_without_a_place_are_left_out_and_told(tmp_path: Path, points_m: NDArray[np.float64]) -> None:
    """As scanners write what did not come back."""
    with_nan = np.vstack([points_m, np.full((7, 3), np.nan)])
    world = load_world(cloud(tmp_path / "room.pcd", with_nan), 0, START)
    assert is_closed_room(world)
    assert "7 points without finite coordinates are left out" in world.remarks


def test_what_has_too_many_voxels_is_refused_before_the_work(points_m: NDArray[np.float64]) -> None:
    with pytest.raises(TooManyVoxelsError, match="in a row"):
        closed_surface(np.vstack([points_m, [20_000.0, 0.0, 0.0]]), 0.01)
    many = np.random.default_rng(0).uniform(0.0, 1000.0, (MOST_VOXELS + 100_000, 3))
    with pytest.raises(TooManyVoxelsError, match="voxels or more hold points, of at most"):
        closed_surface(many, 0.2)


def pcd(points: NDArray[np.floating], kind: str) -> bytes:
    """A PCD file with a field in front of the coordinates."""
    size = points.dtype.itemsize
    header = (
        f"VERSION 0.7\nFIELDS ring x y z _\nSIZE 2 {size} {size} {size} 1\nTYPE U F F F U\nCOUNT 1 1 1 1 3\n"
        f"WIDTH {len(points)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(points)}\nDATA {kind}\n"
    )
    rows = np.zeros(len(points), [("ring", "<u2"), ("at", points.dtype, 3), ("_", "u1", 3)])
    rows["at"] = points
    return header.encode() + rows.tobytes()


def test_a_pcd_file_in_double_precision_keeps_its_digits_and_one_in_single_is_refused_far_away(
    tmp_path: Path, points_m: NDArray[np.float64]
) -> None:
    shift = np.array([500_000.0, 6_000_000.0, 0.0])
    path, start = tmp_path / "room.pcd", (START[0] + shift[0], START[1] + shift[1], START[2], START[3])
    path.write_bytes(pcd(points_m + shift, "binary"))
    world = load_world(str(path), 0, start)
    assert world.origin_m == tuple(shift)
    assert is_closed_room(replace(world, origin_m=(0.0, 0.0, 0.0)))
    path.write_bytes(pcd((points_m + shift).astype(np.float32), "binary"))
    with pytest.raises(InputError, match=r"steps of 0.5 m so far from 0"):
        load_world(str(path), 0, start)


@pytest.mark.parametrize("encoding", [Encoding.BINARY_COMPRESSED, Encoding.ASCII])
def test_a_pcd_file_keeps_its_digits_however_it_is_packed(
    tmp_path: Path, points_m: NDArray[np.float64], encoding: Encoding
) -> None:
    """Text has the digits that stand there, though its header says single precision."""
    shift = np.array([500_000.0, 6_000_000.0, 0.0])
    path, start = tmp_path / "room.pcd", (START[0] + shift[0], START[1] + shift[1], START[2], START[3])
    PointCloud.from_points(points_m + shift, ("x", "y", "z"), (np.float64,) * 3).save(path, encoding)
    if encoding is Encoding.ASCII:
        path.write_bytes(path.read_bytes().replace(b"SIZE 8 8 8", b"SIZE 4 4 4"))
    world = load_world(str(path), 0, start)
    assert world.origin_m == tuple(shift)
    assert is_closed_room(replace(world, origin_m=(0.0, 0.0, 0.0)))


def test_a_las_file_in_feet_is_refused(tmp_path: Path, points_m: NDArray[np.float64]) -> None:
    """Protects from a mine that is three times too large."""
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.vlrs.append(WktCoordinateSystemVlr(CRS("EPSG:2229").to_wkt("WKT1_GDAL")))
    header.global_encoding.wkt = True
    las = laspy.LasData(header)
    las.x, las.y, las.z = points_m.T
    las.write(str(tmp_path / "room.las"))
    with pytest.raises(InputError, match=r"room.las: its coordinates .* in US survey foot: a map is in m"):
        load_world(str(tmp_path / "room.las"), 0, START)


@pytest.mark.parametrize("suffix", [".las", ".laz", ".pcd", ".ply"])
def test_a_cloud_that_was_cut_is_refused(tmp_path: Path, points_m: NDArray[np.float64], suffix: str) -> None:
    path = Path(cloud(tmp_path / f"room{suffix}", points_m))
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 2 // 3])
    with pytest.raises(InputError, match=r"damaged|cut off"):
        load_world(str(path), 0, START)
