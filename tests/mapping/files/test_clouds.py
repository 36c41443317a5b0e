"""Point clouds, each opened by a reader that is not ours; LAS also byte by byte, as the standard has it."""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from datetime import date
from pathlib import Path

import laspy
import numpy as np
import open3d
import pytest

from companion.errors import InputError
from companion.mapping.files import Georeference, MapFileError, write
from companion.mapping.files.georeference import CoordinateSystem
from companion.mapping.voxels.piece import MapPiece
from companion.model import FloatArray
from tests.mapping.files.sources import EMPTY, Held, occupied_m, of_voxels, scattered

LOWEST_COLOUR, HIGHEST_COLOUR = (68, 1, 84), (253, 231, 37)


@pytest.fixture(scope="module")
def source() -> Held:
    """A map on both sides of the origin."""
    return scattered()


def _probabilities(source: Held) -> FloatArray:
    logs = source.values[source.values >= source.threshold] / 1000.0
    return np.asarray(1.0 / (1.0 + np.exp(-logs)))


@pytest.mark.parametrize("format_", ["ply", "pcd"])
def test_open3d_reads_points_and_colours(source: Held, tmp_path: Path, format_: str) -> None:
    """Protects the clouds that people open in CloudCompare, MeshLab, PCL and Open3D: all points, dark is low."""
    path = tmp_path / f"map.{format_}"
    write(source, path)
    cloud = open3d.io.read_point_cloud(path)
    points, colours = np.asarray(cloud.points), np.asarray(cloud.colors) * 255.0
    # Single precision at a few metres.
    assert np.allclose(points, occupied_m(source), atol=1e-6)
    assert np.allclose(colours[points[:, 2].argmin()], LOWEST_COLOUR)
    assert np.allclose(colours[points[:, 2].argmax()], HIGHEST_COLOUR)


@pytest.mark.parametrize("format_", ["ply", "pcd"])
def test_open3d_reads_probabilities(source: Held, tmp_path: Path, format_: str) -> None:
    """Protects the confidence of each voxel in the formats that can hold any property."""
    path = tmp_path / f"map.{format_}"
    write(source, path)
    cloud = open3d.t.io.read_point_cloud(path)
    assert np.allclose(cloud.point["probability"].numpy().ravel(), _probabilities(source), atol=1e-6)


@pytest.mark.parametrize("format_", ["las", "laz"])
def test_laspy_reads_points(source: Held, tmp_path: Path, format_: str) -> None:
    """Protects the cloud for surveyors: in whole mm, with colours, and the confidence as intensity."""
    path = tmp_path / f"map.{format_}"
    write(source, path, created=date(2025, 11, 22))
    cloud = laspy.read(path)
    # Half of the scale, 0.5 mm, is what rounding can cost.
    assert np.abs(cloud.xyz - occupied_m(source)).max() <= 0.0005 + 1e-9
    assert np.abs(np.asarray(cloud.intensity) / 65535 - _probabilities(source)).max() < 1e-4
    lowest = int(np.asarray(cloud.z).argmin())
    assert (cloud.red[lowest], cloud.green[lowest], cloud.blue[lowest]) == tuple(257 * c for c in LOWEST_COLOUR)
    assert cloud.header.creation_date == date(2025, 11, 22)


def test_las_is_as_the_standard_has_it(source: Held, tmp_path: Path) -> None:
    """Protects surveyors' software from a header that only laspy, which also wrote it, would accept."""
    write(source, tmp_path / "map.las", created=date(2025, 2, 1))
    data = (tmp_path / "map.las").read_bytes()
    points = occupied_m(source)
    # LAS 1.2, table 3.
    assert data[:4] == b"LASF"
    assert struct.unpack_from("<BB", data, 24) == (1, 2)
    assert data[26:58].rstrip(b"\0") == b"EXTRACTION"
    assert data[58:90].rstrip(b"\0").startswith(b"companion ")
    assert struct.unpack_from("<HH", data, 90) == (32, 2025)
    header_bytes, offset, records, kind, record_bytes, count = struct.unpack_from("<HIIBHI", data, 94)
    assert (header_bytes, records, kind, record_bytes, count) == (227, 0, 2, 26, len(points))
    assert len(data) == offset + 26 * count
    assert struct.unpack_from("<5I", data, 111) == (count, 0, 0, 0, 0)
    assert struct.unpack_from("<3d", data, 131) == (0.001, 0.001, 0.001)
    offsets = np.array(struct.unpack_from("<3d", data, 155))
    extremes = np.array(struct.unpack_from("<6d", data, 179)).reshape(3, 2)
    assert np.allclose(extremes, np.stack([points.max(axis=0), points.min(axis=0)], axis=1), atol=0.0006)
    # Table 8: X Y Z, intensity, bits of returns (one of one), five bytes that say nothing here, red green blue.
    layout = np.dtype(
        [("xyz", "<i4", 3), ("intensity", "<u2"), ("returns", "u1"), ("rest", "u1", 5), ("rgb", "<u2", 3)]
    )
    read = np.frombuffer(data, layout, count, offset)
    assert np.abs(read["xyz"] * 0.001 + offsets - points).max() <= 0.0005 + 1e-9
    assert (read["returns"] == 0b001001).all()
    assert not read["rest"].any()


UTM_M = (500_000.25, 6_000_000.5, 400.125)


@pytest.mark.parametrize("format_", ["las", "laz"])
def test_a_map_goes_back_to_its_surveyed_place(source: Held, tmp_path: Path, format_: str) -> None:
    """Protects the survey: to half a mm, six thousand km from the origin, where a float has steps of half a metre."""
    path = tmp_path / f"map.{format_}"
    write(source, path, georeference=Georeference(UTM_M))
    cloud = laspy.read(path)
    assert np.abs(cloud.xyz - (occupied_m(source) + UTM_M)).max() <= 0.0005 + 1e-8
    assert np.abs(cloud.header.offsets - UTM_M).max() < 10.0
    assert (cloud.header.scales == 0.001).all()
    # Colours are by height all the same.
    assert len(np.unique(cloud.red)) > 5


@pytest.mark.parametrize("format_", ["las", "laz"])
def test_a_coordinate_system_is_said_as_las_wants_it(source: Held, tmp_path: Path, format_: str) -> None:
    """Protects georeferenced maps: well-known text of the first version, LAS 1.4, and the bit that announces it."""
    path = tmp_path / f"map.{format_}"
    write(source, path, georeference=Georeference(UTM_M, CoordinateSystem.of("epsg:25832")))
    cloud = laspy.read(path)
    assert cloud.header.parse_crs().to_epsg() == 25832
    assert np.abs(cloud.xyz - (occupied_m(source) + UTM_M)).max() <= 0.0005 + 1e-8
    data = path.read_bytes()
    # LAS 1.4 R15, tables 3 and 5: bit 4 of the global encoding, then the version; and the VLR of OGC WKT.
    assert struct.unpack_from("<H", data, 6)[0] & 1 << 4
    assert struct.unpack_from("<BB", data, 24) == (1, 4)
    assert struct.unpack_from("<16sH", data, struct.unpack_from("<H", data, 94)[0] + 2) == (b"LASF_Projection\0", 2112)
    assert b'PROJCS["ETRS89 / UTM zone 32N"' in data
    assert struct.unpack_from("<HH", data, 90) == (0, 0)


def test_a_map_that_is_too_large_for_millimetres_has_centimetres(tmp_path: Path) -> None:
    """Protects from numbers that run over: LAS counts in 32 bits, 2147 km in mm."""
    voxels = {(-14_000_000, 0, 0): 3000, (14_000_000, 5, 0): 3000}
    write(of_voxels(voxels), tmp_path / "map.las")
    cloud = laspy.read(tmp_path / "map.las")
    assert (cloud.header.scales == 0.01).all()
    assert np.abs(np.sort(cloud.x) - [-1_399_999.95, 1_400_000.05]).max() <= 0.005 + 1e-8


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("EPSG:4326", "is no projected system: a map is in m and not in degrees"),
        ("EPSG:4978", "is no projected system"),
        ("EPSG:2263", "counts east in US survey foot"),
        ("EPSG:2053", "counts west in metre"),
        ("EPSG:9999999", "the EPSG registry has no such"),
        ("25832", "give its number as EPSG:NNNN"),
        ("+proj=utm +zone=32", "give its number as EPSG:NNNN"),
    ],
)
def test_a_coordinate_system_that_cannot_hold_a_map_is_refused(name: str, says: str) -> None:
    """Protects from a map in degrees or feet, or mirrored."""
    with pytest.raises(InputError, match=re.escape(says)):
        CoordinateSystem.of(name)


def test_a_place_where_the_system_is_not_used_is_said() -> None:
    """Protects from a forgotten place, and from one with north before east."""
    system = CoordinateSystem.of("EPSG:25832")
    assert system.problem_at(UTM_M) is None
    for place_m in ((0.0, 0.0, 0.0), (6_000_000.0, 500_000.0, 400.0)):
        assert "EPSG:25832 is used from 6° to 12.01° east" in str(system.problem_at(place_m))
    assert CoordinateSystem.of("EPSG:25832+7837").problem_at(UTM_M) is None
    # Fiji lies on both sides of the date line.
    assert CoordinateSystem.of("EPSG:3460").problem_at((2_000_000.0, 4_000_000.0, 0.0)) is None


def test_no_date_is_no_date(tmp_path: Path) -> None:
    """Protects from a date that nobody gave: the vehicle's clock may be wrong underground."""
    write(scattered(), tmp_path / "map.las")
    assert struct.unpack_from("<HH", (tmp_path / "map.las").read_bytes(), 90) == (0, 0)


def test_all_at_one_height_have_one_colour(tmp_path: Path) -> None:
    """Protects a floor without anything on it from a division by zero."""
    write(of_voxels({(0, 0, 0): 3000, (5, 7, 0): 3000}), tmp_path / "map.ply")
    colours = np.asarray(open3d.io.read_point_cloud(tmp_path / "map.ply").colors) * 255.0
    assert np.allclose(colours, LOWEST_COLOUR)


def test_what_changes_while_it_is_written_is_refused(tmp_path: Path) -> None:
    """Protects from a file whose header says another number of points than follow."""

    class Growing:
        voxel_m, threshold, looks = 0.1, 847, 0

        def pieces(self, most_chunks: int = 1024) -> Iterator[MapPiece]:
            self.looks += 1
            return of_voxels(dict.fromkeys([(k, 0, 0) for k in range(self.looks)], 3000)).pieces(most_chunks)

    with pytest.raises(MapFileError, match="changed while it was being written"):
        write(Growing(), tmp_path / "map.ply")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("format_", ["ply", "pcd", "las", "laz"])
def test_an_empty_map_is_a_file_without_points(tmp_path: Path, format_: str) -> None:
    """Protects a flight that ended before it saw anything: its files are valid and hold nothing."""
    path = tmp_path / f"map.{format_}"
    write(EMPTY, path)
    if format_ in ("las", "laz"):
        assert len(laspy.read(path)) == 0
    else:
        with open3d.utility.VerbosityContextManager(open3d.utility.VerbosityLevel.Error):
            assert len(open3d.io.read_point_cloud(path).points) == 0
