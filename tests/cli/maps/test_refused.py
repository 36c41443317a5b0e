"""What every command of `companion map` refuses, without touching anything."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest

from companion.cli.maps import sources
from companion.mapping.files import write
from companion.mapping.journal import Journal
from tests.cli.maps.conftest import HEADER, Run, journal_at, room, tree

COMMANDS = ("info", "export", "merge", "view")


def bad_sources(tmp_path: Path) -> Iterator[tuple[Path, str]]:
    """Everything that is no map, with what is to be said of it."""
    yield tmp_path / "nowhere", "no such file or folder"
    empty = tmp_path / "empty"
    empty.mkdir()
    yield empty, "is an empty folder"
    other = tmp_path / "other"
    other.mkdir()
    (other / "holiday.jpg").write_bytes(b"\xff\xd8")
    yield other, "no map journal is here"
    picture = tmp_path / "holiday.jpg"
    picture.write_bytes(b"\xff\xd8")
    yield picture, "not a map that can be read"
    wrong = tmp_path / "wrong.bt"
    wrong.write_bytes(b"not a tree\n")
    yield wrong, "not an OctoMap file"
    cut = tmp_path / "cut.ot"
    with Journal.open(tmp_path / "whole.journal", HEADER) as journal:
        journal.append(room())
        write(journal, cut)
    cut.write_bytes(cut.read_bytes()[:-100])
    yield cut, "cut off"
    damaged = journal_at(tmp_path / "damaged.journal")
    for file in damaged.iterdir():
        file.write_bytes(b"\0" * file.stat().st_size)
    yield damaged, "damaged.journal"


@pytest.mark.parametrize("command", COMMANDS)
def test_what_is_no_map_is_refused(run: Run, mission: Path, tmp_path: Path, command: str) -> None:
    """Protects the user from tracebacks: one line that names the file, exit code 2, and nothing is changed."""
    bad = list(bad_sources(tmp_path))
    before = tree(tmp_path)
    for source, said in bad:
        arguments: dict[str, tuple[object, ...]] = {
            "info": (source,),
            "export": (source, tmp_path / "out.ply"),
            "merge": (mission, source, "-o", tmp_path / "out.journal"),
            "view": (source, "--picture", tmp_path / "out.png"),
        }
        code, printed, errors = run(command, *arguments[command])
        assert (code, printed) == (2, ""), source
        assert said in errors, source
        assert str(source) in errors
        assert errors.count("\n") == 1
        assert tree(tmp_path) == before


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read and write everything")
def test_without_permission(run: Run, mission: Path, tmp_path: Path) -> None:
    """Protects from a traceback where a file belongs to somebody else."""
    closed = tmp_path / "closed"
    closed.mkdir(mode=0o500)
    assert "permission denied" in run("export", mission, closed / "out.ply")[2]
    mission.chmod(0)
    code, _, errors = run("info", mission)
    mission.chmod(0o700)
    assert (code, "permission denied" in errors) == (2, True)


def test_permission_is_asked_for_before_any_work(
    run: Run, mission: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Protects the same where the tests run as root: what the system says of access is heeded, for both ends."""
    for closed, arguments in ((tmp_path, ("export", mission, tmp_path / "out.ply")), (mission, ("info", mission))):
        refusing = SimpleNamespace(access=lambda path, _, closed=closed: path != closed, R_OK=4, W_OK=2, X_OK=1)
        monkeypatch.setattr(sources, "os", refusing)
        code, _, errors = run(*arguments)
        assert code == 2
        assert "permission" in errors
        assert errors.count("\n") == 1


def bad_targets(mission: Path, tmp_path: Path) -> Iterator[tuple[tuple[object, ...], str]]:
    """Commands whose target cannot be, with what is to be said."""
    folder = tmp_path / "folder.ply"
    folder.mkdir()
    missing = tmp_path / "missing"
    yield ("export", mission, tmp_path / "out.xyz"), "the suffix '.xyz' names no format"
    yield ("export", mission, tmp_path / "out"), "the suffix '' names no format"
    yield ("export", mission, tmp_path / "out.las", "--mesh"), "a mesh is written as .ply or .obj"
    yield ("export", mission, missing / "out.ply"), f"there is no folder {missing}"
    yield ("export", mission, folder, "--overwrite"), "is a folder"
    yield ("export", mission, tmp_path / "a.ply", tmp_path / "a.ply"), "given twice"
    yield ("export", mission, tmp_path / "a.ply", *("--box", "1", "0", "0", "0", "1", "1")), "is no box"
    yield ("export", mission, mission / "map.journal" / "out.ply"), "is the map that is read"
    other = journal_at(tmp_path / "b.journal")
    yield ("merge", mission, other, "-o", tmp_path / "out.ply"), "a merged map is a folder NAME.journal"
    yield ("merge", mission, other, "-o", other, "--overwrite"), "is the map that is read"
    yield ("merge", mission, other, "-o", missing / "out.ot"), f"there is no folder {missing}"
    yield ("view", mission, "--picture", tmp_path / "out.jpg"), "a picture is a .png"
    yield ("export", mission, tmp_path / f"{300 * 'x'}.ply"), "File name too long; give another name"
    yield ("merge", mission, other, "-o", tmp_path / f"{300 * 'x'}.journal"), "File name too long; give another name"
    yield ("view", mission, "--picture", missing / "out.png"), f"there is no folder {missing}"


def test_what_cannot_be_written_is_refused(run: Run, mission: Path, tmp_path: Path) -> None:
    """Protects from work for nothing: every target is judged before the map is read, and nothing is changed."""
    bad = list(bad_targets(mission, tmp_path))
    before = tree(tmp_path)
    for arguments, said in bad:
        code, printed, errors = run(*arguments)
        assert (code, printed) == (2, ""), arguments
        assert said in errors, arguments
        assert errors.count("\n") == 1
        assert tree(tmp_path) == before


def test_the_same_file_in_and_out(run: Run, mission: Path, tmp_path: Path) -> None:
    """Protects a map from being written while it is read, also where --overwrite is given."""
    run("export", mission, tmp_path / "a.ot")
    before = tree(tmp_path)
    code, _, errors = run("export", tmp_path / "a.ot", tmp_path / "a.ot", "--overwrite")
    assert (code, "is the map that is read" in errors) == (2, True)
    assert tree(tmp_path) == before
