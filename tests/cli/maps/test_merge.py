"""`companion map merge`: the sum, what replaces what, and maps that do not go together."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from companion.mapping.journal import Journal
from companion.mapping.voxels.chunks import NOTHING, OFFSETS
from tests.cli.maps.missions import HEADER, Run, journal_at, labels, tree


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
