"""`companion map export`: formats, boxes, and what a format cannot hold."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from companion.mapping.journal import Journal
from companion.mapping.voxels.piece import MapPiece
from tests.cli.maps.missions import HEADER, Run, labels, tree


@pytest.mark.parametrize("format_", ["ply", "pcd", "las", "laz", "bt", "ot", "obj"])
def test_export_by_suffix(run: Run, mission: Path, tmp_path: Path, format_: str) -> None:
    """Protects every format that the help names."""
    target = tmp_path / f"out.{format_}"
    code, printed, errors = run("export", mission, target)
    assert (code, errors) == (0, "")
    assert printed == f"{target}: {target.stat().st_size:,} bytes\n"
    assert sorted(tmp_path.iterdir()) == [mission, target]


def test_export_writes_the_map(run: Run, mission: Path, tmp_path: Path) -> None:
    """Protects the content: another program finds walls, free and unknown space where they are."""
    targets = tmp_path / "a.bt", tmp_path / "a.ot"
    assert run("export", mission, *targets)[0] == 0
    for target in targets:
        assert labels(target, np.array([[1.55, 1.05, 0.55], [-0.05, 1.05, 0.55], [9.0, 9.0, 9.0]])) == [0, 1, -1]


def test_export_of_a_mesh(run: Run, mission: Path, tmp_path: Path) -> None:
    """Protects the surface: a .ply has faces when it is asked for, and points only when not."""
    run("export", mission, tmp_path / "points.ply")
    assert run("export", mission, tmp_path / "mesh.ply", "--mesh")[0] == 0
    assert b"element face" in (tmp_path / "mesh.ply").read_bytes()[:1000]
    assert b"element face" not in (tmp_path / "points.ply").read_bytes()[:1000]


def test_export_of_a_box(run: Run, mission: Path, tmp_path: Path) -> None:
    """Protects a part of the map: what is outside is unknown there."""
    assert run("export", mission, tmp_path / "a.ot", "--box", "0", "0", "0", "1", "1", "1")[0] == 0
    assert labels(tmp_path / "a.ot", np.array([[0.55, 0.55, 0.55], [1.55, 1.05, 0.55]])) == [0, -1]


def test_a_box_beside_the_map_is_refused(run: Run, mission: Path, tmp_path: Path) -> None:
    """Protects from an empty file that is taken for an empty mine: mistaken axes are told."""
    before = tree(tmp_path)
    for corners in ((1000, 0, 0, 1001, 1, 1), (3.2, 0, 0, 9, 9, 9)):
        code, printed, errors = run("export", mission, tmp_path / "a.ot", "--box", *corners)
        assert (code, printed) == (2, "")
        assert errors == (
            f"--box {' '.join(f'{bound:g}' for bound in corners)}: nothing of the map is in this box; "
            "`companion map info` says how far the map reaches\n"
        )
    assert tree(tmp_path) == before


def test_an_export_without_anything_occupied_says_so(run: Run, mission: Path, tmp_path: Path) -> None:
    """Protects from files without a single point, which other programs cannot open and do not explain."""
    inside = "--box", 0.5, 0.5, 0.2, 1, 1, 0.8
    code, printed, errors = run("export", mission, tmp_path / "a.ply", tmp_path / "a.bt", *inside)
    assert (code, printed.count("bytes")) == (0, 2)
    assert errors == "no voxel is occupied: there are no points and no surface to write\n"
    assert labels(tmp_path / "a.bt", np.array([[0.75, 0.75, 0.5]])) == [0]
    with Journal.open(tmp_path / "new.journal", HEADER):
        pass
    assert run("export", tmp_path / "new.journal", tmp_path / "b.ply")[2] == errors


def test_export_replaces_only_when_told(run: Run, mission: Path, tmp_path: Path) -> None:
    """Protects files that are there; and of several targets none is written when one is refused."""
    there, new = tmp_path / "there.ply", tmp_path / "new.ply"
    there.write_bytes(b"mine")
    code, _, errors = run("export", mission, new, there)
    assert (code, there.read_bytes(), new.exists()) == (2, b"mine", False)
    assert errors == f"{there}: exists already; give another name, or --overwrite\n"
    assert run("export", mission, new, there, "--overwrite")[0] == 0
    assert there.read_bytes().startswith(b"ply")


def test_a_format_that_cannot_hold_the_map_is_named(run: Run, tmp_path: Path) -> None:
    """Protects an export of several files: which of them cannot be written is said, and what else can be done."""
    with Journal.open(tmp_path / "far.journal", HEADER) as journal:
        journal.append(MapPiece(np.array([[3000, 0, 0]], np.int32), np.full((1, 4096), np.int16(1000))))
    code, printed, errors = run("export", tmp_path / "far.journal", tmp_path / "a.ply", tmp_path / "a.bt")
    assert (code, printed.count("\n"), errors.count("\n")) == (2, 1, 1)
    assert errors.startswith(f"{tmp_path / 'a.bt'}: the map reaches further than 3276.8 m")
    assert not (tmp_path / "a.bt").exists()
