"""Point clouds read as maps, from files that other libraries wrote, and from our own."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import open3d
import pytest
from laspy.vlrs.known import WktCoordinateSystemVlr
from pyproj import CRS

from companion.mapping.files import (
    CloudReading,
    MapFileError,
    PointCloudFile,
    is_point_cloud,
    open_map,
    point_cloud,
    point_readers,
    write,
)
from companion.mapping.files.octree_walk import BINARY_OCCUPIED
from companion.mapping.voxels.chunks import NOTHING, OFFSETS
from companion.model import FloatArray
from tests.mapping.files.sources import EMPTY, contents, of_voxels, scattered

WRITERS: dict[str, Callable[[Path, FloatArray], object]] = {}


def _writer(name: str) -> Callable[[Callable[[Path, FloatArray], object]], None]:
    def take(write_points: Callable[[Path, FloatArray], object]) -> None:
        WRITERS[name] = write_points

    return take


def _open3d(path: Path, points: FloatArray, **options: Any) -> None:
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
    assert open3d.io.write_point_cloud(path, cloud, **options)


_writer("ascii.ply")(lambda path, points: _open3d(path, points, write_ascii=True))
_writer("binary.ply")(lambda path, points: _open3d(path, points))
_writer("ascii.pcd")(lambda path, points: _open3d(path, points, write_ascii=True))
_writer("binary.pcd")(lambda path, points: _open3d(path, points))
_writer("compressed.pcd")(lambda path, points: _open3d(path, points, compressed=True))


def _las(path: Path, points: FloatArray, wkt: str | None = None) -> None:
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.offsets, header.scales = np.floor(points.min(axis=0)), np.full(3, 0.001)
    if wkt is not None:
        header.vlrs.append(WktCoordinateSystemVlr(wkt))
        header.global_encoding.wkt = True
    cloud = laspy.LasData(header)
    cloud.x, cloud.y, cloud.z = points.T
    cloud.write(path)


_writer("cloud.las")(_las)
_writer("cloud.LAZ")(_las)


@pytest.fixture(scope="module")
def points() -> FloatArray:
    """Points on both sides of the origin, several in some voxels; none on the border between two."""
    rng = np.random.default_rng(5)
    voxels = rng.integers(-90, 90, (1500, 3))
    return np.asarray((np.concatenate([voxels, voxels[:700]]) + 0.5) * 0.1 + rng.uniform(-0.04, 0.04, (2200, 3)))


def occupied(source: object) -> set[tuple[int, int, int]]:
    """The voxels of a map that hold something; all else must be unknown."""
    found = set()
    assert isinstance(source, PointCloudFile)
    for piece in source.pieces(3):
        assert len(piece.chunks) <= 3
        assert set(np.unique(piece.values).tolist()) <= {int(NOTHING), int(BINARY_OCCUPIED)}
        row, place = np.nonzero(piece.values >= source.threshold)
        found |= set(map(tuple, (16 * piece.chunks[row] + OFFSETS[place]).tolist()))
    return found


def voxels_of(points: FloatArray, voxel_m: float) -> set[tuple[int, int, int]]:
    """Where points are, reckoned by hand."""
    return {(int(x), int(y), int(z)) for x, y, z in np.floor(points / voxel_m)}


@pytest.mark.parametrize("name", WRITERS)
def test_what_others_wrote_is_read(
    name: str, points: FloatArray, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Protects clouds of scanners and other programs: a voxel with a point is occupied, of others nothing is known."""
    monkeypatch.setattr(point_readers, "BLOCK", 300)
    monkeypatch.setattr(point_cloud, "_PENDING", 500)
    WRITERS[name](tmp_path / name, points)
    shares: list[float] = []
    for voxel_m in (0.1, 0.2):
        source = open_map(tmp_path / name, shares.append, CloudReading(voxel_m))
        assert occupied(source) == voxels_of(points, voxel_m)
        assert isinstance(source, PointCloudFile)
        assert (source.points, source.left_out, source.occupied) == (2200, 0, len(voxels_of(points, voxel_m)))
    assert shares[-1] == 1.0
    assert len(shares) > 10


@pytest.mark.parametrize("suffix", ["ply", "pcd", "las", "laz"])
def test_our_own_clouds_come_back(suffix: str, tmp_path: Path) -> None:
    """Protects maps of which only a cloud was kept: the very voxels that were occupied."""
    map_ = scattered()
    write(map_, tmp_path / f"map.{suffix}")
    rows, places = np.nonzero(map_.values >= map_.threshold)
    expected = set(map(tuple, (16 * map_.chunks[rows] + OFFSETS[places]).tolist()))
    assert occupied(open_map(tmp_path / f"map.{suffix}")) == expected


def test_a_place_is_taken_from_the_points(points: FloatArray, tmp_path: Path) -> None:
    """Protects surveys: six thousand km from their origin, and a map that is where its origin is."""
    place_m = (500_000.0, 6_000_000.0, 400.0)
    _las(tmp_path / "a.las", points + place_m)
    assert occupied(open_map(tmp_path / "a.las", reading=CloudReading(0.1, place_m))) == voxels_of(points, 0.1)
    with pytest.raises(
        MapFileError, match=r"further than 104858 m from the origin.*--offset 500000 59999\d\d 4\d\d$|399$"
    ):
        open_map(tmp_path / "a.las")


def test_points_that_are_no_numbers_are_left_out(points: FloatArray, tmp_path: Path) -> None:
    """Protects organized clouds of cameras, which say NaN where they measured nothing."""
    with_holes = points.copy()
    with_holes[::7, 1] = np.nan
    with_holes[3, 0] = np.inf
    head = "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 2200\nHEIGHT 1\nPOINTS 2200\n"
    (tmp_path / "a.pcd").write_bytes(f"{head}DATA binary\n".encode() + with_holes.astype("<f4").tobytes())
    source = open_map(tmp_path / "a.pcd")
    kept = points[np.isfinite(with_holes).all(axis=1)]
    assert isinstance(source, PointCloudFile)
    assert (source.points, source.left_out) == (len(kept), 2200 - len(kept))
    assert occupied(source) == voxels_of(kept, 0.1)


def test_an_ascii_pcd_may_be_spaced_as_it_likes(tmp_path: Path) -> None:
    """Protects files that people's own programs wrote, with columns set out, tabs and the line ends of Windows."""
    head = (
        "VERSION 0.7\r\nFIELDS x y z\r\nSIZE 4 4 4\r\nTYPE F F F\r\nCOUNT 1 1 1\r\nWIDTH 2\r\nHEIGHT 1\r\nPOINTS 2\r\n"
    )
    (tmp_path / "a.pcd").write_text(f"{head}DATA ascii\r\n   1.01   2.02  3.03 \r\n -1.01\t2.02 3.03\r\n")
    assert occupied(open_map(tmp_path / "a.pcd")) == {(10, 20, 30), (-11, 20, 30)}


@pytest.mark.parametrize("suffix", ["ply", "pcd", "las", "laz"])
def test_no_points_are_an_empty_map(suffix: str, tmp_path: Path) -> None:
    """Protects the files of a flight that ended before it saw anything."""
    write(EMPTY, tmp_path / f"map.{suffix}")
    assert contents(open_map(tmp_path / f"map.{suffix}")) == {}


def _cut(name: str, points: FloatArray, path: Path) -> None:
    WRITERS[name](path, points)
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 2 // 3])


@pytest.mark.parametrize("name", WRITERS)
def test_a_cloud_that_was_cut_off_is_refused(name: str, points: FloatArray, tmp_path: Path) -> None:
    """Protects from two thirds of a mine that look like all of it."""
    path = tmp_path / name
    _cut(name, points, path)
    with pytest.raises(MapFileError, match=r"cut off|is damaged") as caught:
        open_map(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("suffix", [".ply", ".pcd", ".las", ".laz"])
@pytest.mark.parametrize("content", [b"", b"\0" * 500, b"solid cube\n", b"ply\nformat ascii 1.0\nelement vertex 5\n"])
def test_what_is_no_cloud_is_refused(suffix: str, content: bytes, tmp_path: Path) -> None:
    """Protects from tracebacks out of four libraries: which file it is, in one line."""
    path = tmp_path / f"a{suffix}"
    path.write_bytes(content)
    assert is_point_cloud(path)
    with pytest.raises(MapFileError, match=r"is damaged, or no (PLY|PCD|LAS) file") as caught:
        open_map(path)
    assert str(path) in str(caught.value)


PLY = "ply\nformat ascii 1.0\nelement vertex 3\n{}end_header\n0 0 0\n1 0 0\n0 1 0\n{}"
XYZ = "property float x\nproperty float y\nproperty float z\n"


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (
            PLY.format(XYZ + "element face 1\nproperty list uchar int vertex_indices\n", "3 0 1 2\n"),
            "is a mesh of 1 faces and no point cloud",
        ),
        (
            PLY.format("property float x\nproperty float y\nproperty float h\n", ""),
            "its points have no z, only x, y, h",
        ),
        (PLY.format(XYZ, "").replace("vertex 3", "vertex 4"), "is damaged"),
        (PLY.format(XYZ, "").replace("1 0 0", "1e9 0 0"), "a point at (1000000000, 0, 0) m is further than 104858 m"),
    ],
)
def test_what_is_no_surface_is_refused(content: str, says: str, tmp_path: Path) -> None:
    """Protects from a mesh that becomes its corners, and from points that are somewhere else."""
    (tmp_path / "a.ply").write_text(content)
    with pytest.raises(MapFileError, match=re.escape(says)):
        open_map(tmp_path / "a.ply")


def test_a_cloud_in_feet_is_refused(points: FloatArray, tmp_path: Path) -> None:
    """Protects from a mine that is three times too large: LAS says what its numbers are."""
    _las(tmp_path / "m.las", points, CRS.from_epsg(25832).to_wkt("WKT1_GDAL"))
    assert occupied(open_map(tmp_path / "m.las")) == voxels_of(points, 0.1)
    _las(tmp_path / "ft.las", points, CRS.from_epsg(2263).to_wkt("WKT1_GDAL"))
    with pytest.raises(MapFileError, match="in US survey foot: a map is in m"):
        open_map(tmp_path / "ft.las")


def test_points_far_apart_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects memory and patience from a cloud in mm: what holds nearly nothing but its points' distances."""
    monkeypatch.setattr(point_cloud, "_MOST_CLOUD_CHUNKS", 50)
    write(of_voxels({(20 * k, 0, 0): 3000 for k in range(100)}), tmp_path / "a.ply")
    with pytest.raises(MapFileError, match=r"over 19\d x 0 x 0 m: too many for a map. They are in mm"):
        open_map(tmp_path / "a.ply")
