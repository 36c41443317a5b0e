"""The files of a map, each opened by a reader that is not ours."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import laspy
import numpy as np
import octomap
import open3d
import pytest

from companion.mapping import FREE, OCCUPIED, UNKNOWN, MapSnapshot, VoxelMap
from companion.mapping.files import write_map, write_octree
from companion.mapping.files.colours import height_colours
from companion.mapping.files.octree import MapFileError
from companion.mapping.files.whole import whole_file
from companion.model import FloatArray
from tests.mapping.scenes import EXACT, camera, frame, pose, room_depth

OCTOMAP_LABEL = {UNKNOWN: -1, FREE: 0, OCCUPIED: 1}


@pytest.fixture(scope="module")
def voxels() -> VoxelMap:
    """A map on both sides of the origin, with whole free blocks in it that the tree can prune."""
    built = VoxelMap(EXACT)
    cam = camera()
    for yaw in (0.0, 1.5, 3.1, -1.5):
        at = pose(0.1, -0.2, 0.3, yaw=yaw)
        built.integrate(frame(cam, at, room_depth(cam, at, np.array([-3.0, -3.2, -2.9]), np.array([3.3, 3.1, 3.0]))))
    return built


@pytest.fixture(scope="module")
def written(voxels: VoxelMap, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The map's files, in a folder that was not there."""
    return write_map(voxels, tmp_path_factory.mktemp("map") / "new" / "folder")


def _sorted(points: FloatArray) -> FloatArray:
    return points[np.lexsort(np.round(points, 4).T)]


@pytest.mark.parametrize("format_", ["ply", "pcd"])
def test_open3d_reads_points_and_colours(voxels: VoxelMap, written: dict[str, Path], format_: str) -> None:
    """Protects the clouds that people open in CloudCompare, MeshLab, PCL and Open3D."""
    cloud = open3d.io.read_point_cloud(written[format_])
    points, colours = np.asarray(cloud.points), np.asarray(cloud.colors)
    # Single precision at a few metres.
    assert np.allclose(_sorted(points), _sorted(voxels.occupied()), atol=1e-6)
    assert np.allclose(colours, height_colours(voxels.occupied()[:, 2]) / 255.0)


def test_laspy_reads_points_and_colours(voxels: VoxelMap, written: dict[str, Path]) -> None:
    """Protects the cloud for surveyors: LAS 1.4, in whole mm."""
    cloud = laspy.read(written["las"])
    assert (str(cloud.header.version), cloud.header.point_format.id) == ("1.4", 7)
    # Half of the scale, 0.5 mm, is what rounding can cost.
    assert np.abs(cloud.xyz - voxels.occupied()).max() <= 0.0005 + 1e-9
    assert (np.asarray(cloud.red) // 257 == height_colours(voxels.occupied()[:, 2])[:, 0]).all()
    assert (cloud.header.mins <= voxels.occupied().min(axis=0) + 0.001).all()


def test_octomap_reads_every_voxel(voxels: VoxelMap, written: dict[str, Path]) -> None:
    """Protects the tree that planners use: OctoMap says of each voxel what the map says, also where it is unknown."""
    tree = octomap.OcTree(1.0)
    assert tree.readBinary(str(written["bt"]).encode())
    assert tree.getResolution() == EXACT.voxel_m
    assert tree.size() == tree.calcNumNodes()
    everywhere = np.stack(np.meshgrid(*[np.arange(-48, 48)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    centres = (everywhere + 0.5) * EXACT.voxel_m
    ours = voxels.classify(centres)
    expected = np.select([ours == state for state in OCTOMAP_LABEL], list(OCTOMAP_LABEL.values()))
    assert (np.asarray(tree.getLabels(centres)) == expected).all()
    assert np.count_nonzero(ours == OCCUPIED) == voxels.counts().occupied
    assert np.count_nonzero(ours == FREE) == voxels.counts().free
    # Pruning is what keeps the file small: most free voxels are in cubes of eight and more.
    assert tree.getNumLeafNodes() < 0.5 * (voxels.counts().occupied + voxels.counts().free)


def _snapshot(chunk: tuple[int, int, int], states: np.ndarray) -> MapSnapshot:
    return MapSnapshot(0.5, 1, np.array([chunk], np.int32), states.astype(np.uint8)[np.newaxis])


@pytest.mark.parametrize("chunk", [(0, 0, 0), (-1, -1, -1), (2047, -2048, 5)], ids=str)
def test_octomap_reads_single_voxels(chunk: tuple[int, int, int], tmp_path: Path) -> None:
    """Protects the corners of OctoMap's cube and the order of children: one voxel of each kind alone in a chunk."""
    states = np.full(4096, UNKNOWN)
    states[1], states[4095] = OCCUPIED, FREE  # place 1 is (1, 0, 0), the last one (15, 15, 15)
    write_octree(_snapshot(chunk, states), tmp_path / "map.bt")
    tree = octomap.OcTree(1.0)
    assert tree.readBinary(str(tmp_path / "map.bt").encode())
    corner = np.array(chunk) * 16
    points = 0.5 * (corner + np.array([[1.5, 0.5, 0.5], [15.5, 15.5, 15.5], [0.5, 0.5, 0.5]]))
    assert list(tree.getLabels(points)) == [1, 0, -1]


def test_octomap_reads_a_chunk_that_is_one_leaf(tmp_path: Path) -> None:
    """Protects pruning above the voxels of one chunk: 4096 equal ones are a single leaf, twelve levels down."""
    write_octree(_snapshot((0, 0, 0), np.full(4096, FREE)), tmp_path / "map.bt")
    tree = octomap.OcTree(1.0)
    assert tree.readBinary(str(tmp_path / "map.bt").encode())
    assert (tree.getNumLeafNodes(), tree.size()) == (1, 13)
    assert list(tree.getLabels(np.array([[7.9, 0.1, 4.0], [8.1, 0.1, 4.0]]))) == [0, -1]


def test_octomap_cannot_hold_what_is_too_far(tmp_path: Path) -> None:
    """Protects from coordinates that wrap around: an error says how far the format reaches, and nothing is written."""
    with pytest.raises(MapFileError, match="further than 16384 m"):
        write_octree(_snapshot((2048, 0, 0), np.full(4096, FREE)), tmp_path / "map.bt")
    assert list(tmp_path.iterdir()) == []


def test_an_empty_map_is_written_and_read(tmp_path: Path) -> None:
    """Protects a flight that ended before it saw anything: its files are valid and hold nothing."""
    paths = write_map(VoxelMap(EXACT), tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["map.bt", "map.las", "map.pcd", "map.ply"]
    assert len(laspy.read(paths["las"])) == 0
    tree = octomap.OcTree(1.0)
    assert tree.readBinary(str(paths["bt"]).encode())
    assert tree.size() == 0
    for format_ in ("ply", "pcd"):
        assert len(open3d.io.read_point_cloud(paths[format_]).points) == 0


def _write_half(path: Path) -> None:
    with whole_file(path) as file:
        file.write(b"half")
        raise OSError("disk is full")


def test_a_broken_write_leaves_the_old_file(tmp_path: Path) -> None:
    """Protects the last good map: what cannot be finished takes nobody's place and leaves nothing behind."""
    path = tmp_path / "map.ply"
    path.write_bytes(b"good")
    with pytest.raises(OSError, match="disk is full"):
        _write_half(path)
    assert path.read_bytes() == b"good"
    assert list(tmp_path.iterdir()) == [path]


def test_the_old_file_stays_until_the_new_one_is_whole(tmp_path: Path) -> None:
    """Protects readers: while a file is being written, whoever opens it sees the one before."""
    path = tmp_path / "map.ply"
    path.write_bytes(b"old")
    with whole_file(path) as file:
        file.write(b"new")
        assert path.read_bytes() == b"old"
    assert path.read_bytes() == b"new"


def test_colours_go_from_low_to_high() -> None:
    """Protects the key of the colours: dark is low, bright is high, and one height has one colour."""
    colours = height_colours(np.array([-1.0, 0.0, 1.0]))
    assert colours[0].tolist() == [68, 1, 84]
    assert colours[2].tolist() == [253, 231, 37]
    assert (height_colours(np.array([2.0, 2.0])) == colours[0]).all()
    assert height_colours(np.zeros(0)).shape == (0, 3)


@pytest.fixture(autouse=True)
def _quiet_open3d() -> Iterator[None]:
    """Open3D prints a warning for an empty cloud."""
    with open3d.utility.VerbosityContextManager(open3d.utility.VerbosityLevel.Error):
        yield
