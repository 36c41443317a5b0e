"""The one way to write a map, whatever the format: files are whole or not there."""

from __future__ import annotations

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import laspy
import numpy as np
import octomap
import open3d
import pytest

from companion.mapping import VoxelMap
from companion.mapping.files import FORMATS, MapFileError, open_map, write, write_map, write_mesh
from companion.mapping.files.whole import whole_file
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


# Files are whole or not there, whatever happens to who writes them.


OLD, NEW = scattered(10, chunks=300), scattered(11, chunks=300)

WRITER = """
import sys
from pathlib import Path
from companion.mapping.files import write, write_mesh
from tests.mapping.files.sources import scattered
source = scattered(11, chunks=300)
path = Path(sys.argv[1])
def progress(share):
    print(share, flush=True)
while True:
    (write_mesh if path.suffix == ".obj" else write)(source, path, progress)
"""


@pytest.mark.timeout(400)
@pytest.mark.parametrize(
    "format_", [pytest.param("laz", marks=pytest.mark.long), "ot", pytest.param("obj", marks=pytest.mark.long)]
)
def test_a_killed_writer_leaves_old_or_new(format_: str, tmp_path: Path) -> None:
    """Protects the map when the power goes while it is written: the old file or the new one, and nothing for ever."""
    path = tmp_path / f"map.{format_}"
    write_ = write_mesh if format_ == "obj" else write
    write_(NEW, tmp_path / f"new.{format_}")
    write_(OLD, tmp_path / f"old.{format_}")
    new, old = (tmp_path / f"new.{format_}").read_bytes(), (tmp_path / f"old.{format_}").read_bytes()
    assert old != new
    left = 0
    for reports in (1, 5, 20):
        write_(OLD, path)
        child = subprocess.Popen([sys.executable, "-c", WRITER, str(path)], stdout=subprocess.PIPE)
        assert child.stdout is not None
        for _ in range(reports):
            assert child.stdout.readline()
        child.kill()
        child.wait()
        child.stdout.close()
        assert path.read_bytes() in (old, new)
        left += len(list(tmp_path.glob(".*")))
    # It was killed in the middle, not between: half files were left, and the next writer took them away.
    assert left > 0
    write_(OLD, path)
    assert path.read_bytes() == old
    assert list(tmp_path.glob(".*")) == []


def test_several_writers_at_once(tmp_path: Path) -> None:
    """Protects a map that is saved and exported at the same moment: the last wins, whole, and none disturbs another."""
    path = tmp_path / "map.ot"
    sources = [scattered(seed, chunks=40) for seed in range(4)]
    with ThreadPoolExecutor(4) as pool:
        for _ in range(5):
            list(pool.map(lambda source: write(source, path), sources))
            assert contents(open_map(path)) in [contents(source) for source in sources]
    assert list(tmp_path.iterdir()) == [path]


FULL_DISK = """
import resource, sys
from pathlib import Path
from companion.mapping.files import write, write_mesh
from tests.mapping.files.sources import scattered
source = scattered(11, chunks=300)
resource.setrlimit(resource.RLIMIT_FSIZE, (30_000, 30_000))
for name in sys.argv[1:]:
    path = Path(name)
    try:
        (write_mesh if path.suffix == ".obj" else write)(source, path)
    except OSError as error:
        print(error.strerror)
"""


@pytest.mark.timeout(400)
def test_a_full_disk_leaves_the_old_files(tmp_path: Path) -> None:
    """Protects the last good map: what cannot be finished takes nobody's place and leaves nothing behind."""
    paths = [tmp_path / f"map.{format_}" for format_ in (*FORMATS, "obj")]
    for path in paths:
        path.write_bytes(b"good")
    # Compiled before: what is compiled is kept in a file too, which could not grow in the child either.
    for path in paths:
        (write_mesh if path.suffix == ".obj" else write)(scattered(0, chunks=2), tmp_path / f"first{path.suffix}")
        (tmp_path / f"first{path.suffix}").unlink()
    # A file that may not grow further fails in the same call as a disk that is full.
    child = subprocess.run([sys.executable, "-c", FULL_DISK, *paths], capture_output=True, text=True, check=False)
    assert (child.stdout, child.stderr) == ("File too large\n" * len(paths), "")
    assert [path.read_bytes() for path in paths] == [b"good"] * len(paths)
    assert sorted(tmp_path.iterdir()) == sorted(paths)


def test_a_folder_that_may_not_be_written(tmp_path: Path) -> None:
    """Protects from an error that does not say where: the operating system's own comes through, with the name."""
    with pytest.raises(FileNotFoundError, match="nowhere"):
        write(OLD, tmp_path / "nowhere" / "map.ply")
    (tmp_path / "map.bt").mkdir()
    with pytest.raises(OSError, match="directory"):
        write(scattered(0, chunks=2), tmp_path / "map.bt")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["map.bt"]


def test_the_folder_of_a_mission_that_is_a_file(tmp_path: Path) -> None:
    """Protects what is in the way."""
    (tmp_path / "out").write_bytes(b"mine")
    with pytest.raises(OSError, match="out"):
        write_map(OLD, tmp_path / "out")
    assert (tmp_path / "out").read_bytes() == b"mine"


def test_the_old_file_stays_until_the_new_one_is_whole(tmp_path: Path) -> None:
    """Protects readers: while a file is being written, whoever opens it sees the one before."""
    path = tmp_path / "map.ply"
    path.write_bytes(b"old")
    with whole_file(path) as file:
        file.write(b"new")
        assert path.read_bytes() == b"old"
    assert path.read_bytes() == b"new"


def test_ctrl_c_leaves_the_old_file(tmp_path: Path) -> None:
    """Protects the last good map from somebody who lost patience."""
    path = tmp_path / "map.ply"
    path.write_bytes(b"old")

    def interrupted(share: float) -> None:
        if share > 0.0:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write(OLD, path, interrupted)
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]
