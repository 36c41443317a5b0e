"""The one way to write a map, whatever the format."""

from __future__ import annotations

from pathlib import Path

import laspy
import numpy as np
import octomap
import open3d
import pytest

from companion.mapping import VoxelMap
from companion.mapping.files import FORMATS, MapFileError, open_map, write, write_map, write_mesh
from tests.mapping.files.sources import EMPTY, contents, of_voxels, scattered
from tests.mapping.voxels.scenes import EXACT, camera, frame, pose

MISSION = ["map.bt", "map.laz", "map.pcd", "map.ply"]


def test_a_mission_brings_home_four_files(tmp_path: Path) -> None:
    """Protects what the customer gets: a real map in four formats, in which readers find the same."""
    voxels = VoxelMap(EXACT)
    voxels.integrate(frame(camera(), pose(0.1, -0.2, 0.3), 2.0))
    paths = write_map(voxels, tmp_path / "new" / "folder")
    assert sorted(path.name for path in (tmp_path / "new" / "folder").iterdir()) == MISSION
    assert {format_: path.name for format_, path in paths.items()} == {name[4:]: name for name in MISSION}
    occupied = voxels.counts().occupied
    assert occupied > 0
    tree = octomap.OcTree(1.0)
    assert tree.readBinary(str(paths["bt"]).encode())
    assert np.asarray(tree.getLabels(voxels.occupied())).min() == 1
    assert np.asarray(tree.getLabels(voxels.free())).max() == 0
    assert len(laspy.read(paths["laz"])) == occupied
    for format_ in ("ply", "pcd"):
        assert len(open3d.io.read_point_cloud(paths[format_]).points) == occupied


def test_a_map_too_far_for_octomap_has_its_other_files(tmp_path: Path) -> None:
    """Protects a mission that went too far for one format: the error says so, the other files are there."""
    with pytest.raises(MapFileError, match="further than"):
        write_map(of_voxels({(40_000, 0, 0): 3000}), tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["map.laz", "map.pcd", "map.ply"]
    assert laspy.read(tmp_path / "map.laz").x[0] == pytest.approx(4000.05)


@pytest.mark.parametrize("format_", [*FORMATS, "obj"])
@pytest.mark.parametrize("source", [EMPTY, of_voxels({(-1, -1, -1): 3000})], ids=["empty", "one"])
def test_any_format_holds_little_or_nothing(format_: str, source: object, tmp_path: Path) -> None:
    """Protects a flight that ended at once."""
    path = tmp_path / f"map.{format_}"
    (write_mesh if format_ == "obj" else write)(source, path)  # type: ignore[arg-type]
    assert path.stat().st_size > 0
    if format_ in ("bt", "ot"):
        assert len(contents(open_map(path))) == (source is not EMPTY)


@pytest.mark.parametrize("name", ["Karte für Müller.PLY", "карта.Las", "地図.OT"])
def test_names_in_any_script_and_case(name: str, tmp_path: Path) -> None:
    """Protects people who do not write in ASCII, and suffixes in capitals."""
    source = scattered(0, chunks=5)
    write(source, tmp_path / name)
    assert [path.name for path in tmp_path.iterdir()] == [name]
    if name.endswith("OT"):
        assert contents(open_map(tmp_path / name)) == contents(source)


@pytest.mark.parametrize("name", ["map.xyz", "map", "map.ply.gz"])
def test_an_unknown_suffix_lists_the_known(name: str, tmp_path: Path) -> None:
    """Protects from a format that is guessed."""
    with pytest.raises(MapFileError, match=r"\.ply, \.pcd, \.las, \.laz, \.bt, \.ot"):
        write(EMPTY, tmp_path / name)
    with pytest.raises(MapFileError, match=r"\.ply or \.obj"):
        write_mesh(EMPTY, tmp_path / name)


@pytest.mark.parametrize("format_", [*FORMATS, "obj"])
def test_progress_goes_from_nothing_to_all(format_: str, tmp_path: Path) -> None:
    """Protects whoever waits: the share grows, in steps, and ends at all of it."""
    shares: list[float] = []
    source = scattered(0, chunks=300)
    (write_mesh if format_ == "obj" else write)(source, tmp_path / f"map.{format_}", shares.append)
    assert shares == sorted(shares)
    assert (shares[0], shares[-1]) == (0.0, 1.0)
