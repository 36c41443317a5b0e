"""`companion map export` and `companion map merge`: what is written, and what does not go together."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from companion.mapping.journal import Journal
from companion.mapping.voxels.chunks import NOTHING, OFFSETS
from companion.mapping.voxels.piece import MapPiece
from tests.cli.maps.conftest import HEADER, Run, journal_at, labels, tree


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


# `companion map merge`: the sum, what replaces what, and maps that do not go together.


def test_merge_adds_the_maps(run: Run, tmp_path: Path) -> None:
    """Protects the merged map: what either has seen is in it, and where they disagree the evidence is added up."""
    first, second = journal_at(tmp_path / "a.journal"), journal_at(tmp_path / "b.journal", shift=10)
    code, printed, errors = run("merge", first, second, "-o", tmp_path / "both.journal")
    assert (code, errors) == (0, "")
    assert "from 2 maps" in printed
    run("export", tmp_path / "both.journal", tmp_path / "both.ot")
    # Free in both; seen by the second only; wall of the first, free in the second: they weigh the same; unknown.
    points = np.array([[1.55, 1.05, 0.55], [3.55, 1.05, 0.55], [3.05, 1.05, 0.55], [9.0, 9.0, 9.0]])
    assert labels(tmp_path / "both.ot", points)[:2] == [0, 0]
    with Journal.read_only(tmp_path / "both.journal") as both:
        found = {
            tuple((np.array(chunk) * 16 + OFFSETS[place]).tolist()): int(piece.values[row, place])
            for piece in both.pieces()
            for row, chunk in enumerate(piece.chunks.tolist())
            for place in np.flatnonzero(piece.values[row] != NOTHING)
        }
    assert (both.header.frame, both.header.voxel_m) == ("east-north-up", 0.1)
    assert found[15, 10, 5] == HEADER.lowest, "free in both, clamped"
    assert found[35, 10, 5] == -1000
    assert found[30, 10, 5] == 0
    assert (50, 10, 5) not in found


def test_merge_into_a_tree_takes_trees(run: Run, tmp_path: Path) -> None:
    """Protects maps of other programs: OctoMap files merge with journals and with each other."""
    journal = journal_at(tmp_path / "a.journal")
    journal_at(tmp_path / "b.journal", shift=10)
    run("export", tmp_path / "b.journal", tmp_path / "b.ot")
    assert run("merge", journal, tmp_path / "b.ot", "-o", tmp_path / "one.ot")[0] == 0
    assert run("merge", tmp_path / "b.ot", tmp_path / "one.ot", "-o", tmp_path / "two.ot")[0] == 0
    points = np.array([[0.55, 1.05, 0.55], [3.55, 1.05, 0.55], [9.0, 9.0, 9.0]])
    for name in ("one.ot", "two.ot"):
        assert labels(tmp_path / name, points) == [0, 0, -1]
    assert {path.name for path in tmp_path.iterdir()} == {"a.journal", "b.journal", "b.ot", "one.ot", "two.ot"}


def test_merge_replaces_a_map_only_when_told(run: Run, tmp_path: Path) -> None:
    """Protects the map that is there, and a folder of something else even then."""
    first, second = journal_at(tmp_path / "a.journal"), journal_at(tmp_path / "b.journal", shift=10)
    there, other = journal_at(tmp_path / "there.journal", shift=3), tmp_path / "other.journal"
    other.mkdir()
    (other / "thesis.txt").write_text("years of work", encoding="utf-8")
    before = tree(tmp_path)
    assert run("merge", first, second, "-o", there)[0] == 2
    code, _, errors = run("merge", first, second, "-o", other, "--overwrite")
    assert (code, errors) == (2, f"{other}: is there and holds no map; --overwrite replaces maps only\n")
    assert tree(tmp_path) == before
    assert run("merge", first, second, "-o", there, "--overwrite")[0] == 0
    with Journal.read_only(there) as journal:
        assert journal.read(np.array([[0, 0, 0]], np.int32)).values.min(initial=0) < -1000


HEADERS = {
    "other voxels": (dataclasses.replace(HEADER, voxel_m=0.05), "only maps with voxels of one size can be merged"),
    "other frame": (dataclasses.replace(HEADER, frame="mine grid"), "frame is mine grid, not east-north-up"),
    "other clamps": (dataclasses.replace(HEADER, highest=2000), "highest is 2000, not 3476"),
    "other threshold": (dataclasses.replace(HEADER, threshold=0), "threshold is 0, not 847"),
}


@pytest.mark.parametrize("which", HEADERS)
def test_merge_refuses_maps_that_do_not_go_together(run: Run, tmp_path: Path, which: str) -> None:
    """Protects from a sum of what cannot be added: both maps are named, and what differs."""
    header, said = HEADERS[which]
    first, second = journal_at(tmp_path / "a.journal"), journal_at(tmp_path / "b.journal", header=header)
    before = tree(tmp_path)
    code, _, errors = run("merge", first, second, "-o", tmp_path / "both.journal")
    assert code == 2
    assert said in errors
    assert str(first) in errors
    assert str(second) in errors
    assert errors.count("\n") == 1
    assert tree(tmp_path) == before


def test_merge_refuses_one_map_twice(run: Run, mission: Path, tmp_path: Path) -> None:
    """Protects from counting what was seen once as seen twice; also by two names of one journal."""
    for second in (mission, mission / "map.journal"):
        code, _, errors = run("merge", mission, second, "-o", tmp_path / "both.journal")
        assert (code, errors) == (2, "the same map is given twice: what it says would count twice\n")
    assert run("merge", mission, "-o", tmp_path / "both.journal")[2] == "give at least two maps to merge\n"
