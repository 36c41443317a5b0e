"""Point clouds as the maps of `companion map info`, `export`, `merge` and `view`."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from companion.cli.maps.extra import EXTRA
from companion.config.mapping import MapSettings
from companion.mapping.files import open_map
from companion.mapping.journal import Header, Journal
from tests.cli.maps.conftest import Run, journal_at, labels, tree

AROUND = 32 * 22 * 12 - 6000
"""Occupied voxels of the room in the mission."""
SCAN_M = [(0.55, 0.55, 0.55), (0.57, 0.52, 0.55), (9.05, 9.05, 9.05)]
"""Two points in one voxel in the midst of the room, and one far from it."""


@pytest.fixture
def scan(tmp_path: Path) -> Path:
    """A cloud of three points."""
    path = tmp_path / "scan.ply"
    rows = "\n".join(" ".join(map(str, point)) for point in SCAN_M)
    axes = "".join(f"property double {axis}\n" for axis in "xyz")
    path.write_text(f"ply\nformat ascii 1.0\nelement vertex 3\n{axes}end_header\n{rows}\n")
    return path


@pytest.mark.parametrize("suffix", ["ply", "pcd", "las", "laz"])
def test_info_of_a_point_cloud(run: Run, mission: Path, tmp_path: Path, suffix: str) -> None:
    """Protects who looks at a scan: its voxels, its bounds, and that nothing is known of what is free."""
    run("export", mission, tmp_path / f"a.{suffix}")
    code, printed, errors = run("info", tmp_path / f"a.{suffix}")
    assert (code, errors) == (0, "")
    assert f"{AROUND:,} occupied, 0 free, 0 undecided" in printed
    assert f"points        {AROUND:,}; what holds one is occupied, and what is free is not known" in printed
    assert "x -0.10 to 3.10, y -0.10 to 2.10" in printed
    assert "frame         not said in the file" in printed


def test_info_in_other_voxels_and_for_programs(run: Run, scan: Path) -> None:
    """Protects the size of the voxels, which no cloud says by itself."""
    assert json.loads(run("info", scan, "--json")[1])["points"] == 3
    assert "voxel         0.02 m" in run("info", scan, "--voxel", 0.02)[1]
    assert json.loads(run("info", scan, "--voxel", 0.02, "--json")[1])["facts"]["occupied"] == 3
    assert json.loads(run("info", scan, "--voxel", 20, "--json")[1])["facts"]["occupied"] == 1


def test_a_cloud_is_merged_into_a_map(run: Run, mission: Path, scan: Path, tmp_path: Path) -> None:
    """Protects known walls: where the scanner saw something, a map that took it for free has it occupied."""
    for out in ("a.ot", "b.journal"):
        code, _, errors = run("merge", scan, mission, "-o", tmp_path / out)
        assert code == 0
        assert errors == f"{scan}: 3 points in 2 voxels of 0.1 m; what is free is not known\n"
    assert labels(tmp_path / "a.ot", np.array([*SCAN_M, (0.75, 0.55, 0.55), (5.0, 5.0, 5.0)])) == [1, 1, 1, 0, -1]
    with Journal.read_only(tmp_path / "b.journal") as journal:
        assert journal.header.frame == "east-north-up"


def test_points_go_into_the_voxels_of_the_map(run: Run, tmp_path: Path, scan: Path) -> None:
    """Protects maps of other voxels than the default: a cloud has none of its own, so it takes theirs."""
    other = journal_at(tmp_path / "fine.journal", header=Header.of(MapSettings(voxel_m=0.05)))
    assert run("merge", other, scan, "-o", tmp_path / "a.ot")[0] == 0
    assert open_map(tmp_path / "a.ot").voxel_m == 0.05
    code, _, errors = run("merge", other, scan, "--voxel", 0.2, "-o", tmp_path / "b.ot")
    assert code == 2
    assert "has voxels of 0.2 m" in errors


def test_clouds_are_merged_and_written_in_other_formats(run: Run, scan: Path, tmp_path: Path) -> None:
    """Protects scans of one place, and whoever needs one as an OctoMap: one offset for what is read and written."""
    code, _, _ = run("export", scan, tmp_path / "a.laz", tmp_path / "a.ot", "--offset", 0.5, 0.5, 0.5)
    assert code == 0
    assert labels(tmp_path / "a.ot", np.array([SCAN_M[0], SCAN_M[2]]) - 0.5) == [1, 1]
    assert run("merge", scan, tmp_path / "a.laz", "-o", tmp_path / "b.journal", "--voxel", 0.1)[0] == 0
    with Journal.read_only(tmp_path / "b.journal") as journal:
        assert journal.header.frame == "of point clouds"
    assert "2 occupied" in run("info", tmp_path / "b.journal")[1]


def test_options_without_a_use_are_refused(run: Run, mission: Path, scan: Path, tmp_path: Path) -> None:
    """Protects from an option that does nothing: who gave it thinks that it did."""
    other = journal_at(tmp_path / "other.journal")
    before = tree(tmp_path)
    for arguments in (
        ("info", mission, "--voxel", 0.2),
        ("export", mission, tmp_path / "a.ply", "--voxel", 0.2),
        ("export", mission, tmp_path / "a.ply", "--offset", 1, 2, 3),
        ("merge", mission, other, "-o", tmp_path / "out.journal", "--offset", 1, 2, 3),
        ("view", mission, "--picture", tmp_path / "a.png", "--voxel", 0.2),
        ("info", scan, "--offset", 1, 2, "inf"),
    ):
        code, printed, errors = run(*arguments)
        assert (code, printed, errors.count("\n")) == (2, "", 1), arguments
        assert errors.startswith(("--voxel 0.2: ", "--offset 1 2 3: ", "--offset 1 2 inf: must be")), arguments
    assert tree(tmp_path) == before


def test_what_reads_a_cloud_may_have_to_be_installed(run: Run, scan: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects the user of a plain installation from a traceback, and from thinking that the file is at fault."""
    monkeypatch.setitem(sys.modules, "plyfile", None)
    code, _, errors = run("info", scan)
    assert (code, errors.count("\n")) == (1, 1)
    assert f"`companion map ... scan.ply` needs pip install '{EXTRA}'" in errors
