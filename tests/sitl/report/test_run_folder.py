"""The folder of a simulated flight: its name, and that nothing in it is lost on the way there."""

from __future__ import annotations

import errno
import os
from datetime import datetime, tzinfo
from pathlib import Path

import numpy as np
import pytest

from companion.errors import CompanionError
from sitl.report import run_folder


class StoppedClock(datetime):
    """A clock without a battery."""

    @classmethod
    def now(cls, tz: tzinfo | None = None) -> StoppedClock:
        return cls(2000, 1, 1, tzinfo=tz)


class TestNewFolder:
    """Where the files go."""

    def test_an_empty_folder_may_be_used(self, tmp_path: Path) -> None:
        """Protects whoever makes the folder first."""
        (tmp_path / "flight").mkdir()
        with run_folder.new_folder(tmp_path / "flight") as folder:
            (folder.path / "file").write_text("new", encoding="utf-8")
        assert (tmp_path / "flight" / "file").read_text(encoding="utf-8") == "new"
        assert {path.name for path in tmp_path.iterdir()} == {"flight"}

    def test_folders_above_are_made(self, tmp_path: Path) -> None:
        """Protects the default, a folder below runs/ that may not be there yet."""
        with run_folder.new_folder(tmp_path / "runs" / "a") as folder:
            (folder.path / "file").touch()
        assert (tmp_path / "runs" / "a" / "file").exists()

    def test_the_name_appears_only_when_it_is_whole(self, tmp_path: Path) -> None:
        """Protects whoever waits for the folder."""
        with run_folder.new_folder(tmp_path / "flight"):
            assert not (tmp_path / "flight").exists()
        assert (tmp_path / "flight").is_dir()

    def test_the_present_folder_may_be_meant(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        """Protects `--out .` in an empty folder: refused before the flight or filled after it, never lost."""
        monkeypatch.chdir(tmp_path)
        with run_folder.new_folder(Path()) as folder:
            (folder.path / "file").touch()
        assert (tmp_path / "file").exists()

    def test_a_link_to_an_empty_folder_may_be_meant(self, tmp_path: Path) -> None:
        """Protects a link to another disk: refused before the flight or filled after it, never lost."""
        (tmp_path / "disk").mkdir()
        (tmp_path / "flight").symlink_to(tmp_path / "disk", target_is_directory=True)
        with run_folder.new_folder(tmp_path / "flight") as folder:
            (folder.path / "file").touch()
        assert (tmp_path / "flight" / "file").exists()

    def test_the_default_name_says_what_was_flown(self) -> None:
        """Protects the list of runs: sorted by time, with world and seed, and a name for every file system."""
        assert run_folder.default_folder(run_folder.flown("random:7", 3)).name.endswith("-random-7-3")
        named = run_folder.default_folder(run_folder.flown("worlds/my mine.ply", 1))
        assert named.parent == Path("runs")
        assert named.name.endswith("-my mine-1")
        assert ":" not in str(named)
        assert np.char.isdigit(named.name[:8])

    def test_a_name_that_is_taken_gets_a_number(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        """Protects the second of two missions of the same second, and whoever's clock was set back."""
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr(run_folder, "datetime", StoppedClock)
        for name in ("20000101-000000-room-1", "20000101-000000-room-1-2"):
            assert run_folder.default_folder("room-1") == Path("runs") / name
            with run_folder.new_folder(run_folder.default_folder("room-1")) as folder:
                (folder.path / "file").touch()
            assert folder.target == Path("runs") / name

    def test_a_name_that_was_taken_meanwhile_is_left_to_whoever_has_it(self, tmp_path: Path) -> None:
        """Protects both of two missions: before, the files of the one were put over those of the other."""
        with (
            run_folder.new_folder(tmp_path / "flight") as first,
            run_folder.new_folder(tmp_path / "flight") as second,
        ):
            (first.path / "map").write_text("first", encoding="utf-8")
            (second.path / "map").write_text("second", encoding="utf-8")
        assert (second.target, first.target) == (tmp_path / "flight", tmp_path / "flight-2")
        assert [(folder.target / "map").read_text(encoding="utf-8") for folder in (first, second)] == [
            "first",
            "second",
        ]

    def test_what_cannot_have_its_name_stays_where_it_is(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        """Protects an hour of flight from a disk that went away: before, everything was deleted."""

        def refused(_self: Path, _target: Path) -> None:
            raise OSError(errno.EROFS, "Read-only file system")

        monkeypatch.setattr(Path, "replace", refused)
        with pytest.raises(CompanionError) as said, run_folder.new_folder(tmp_path / "flight") as folder:
            (folder.path / "map").touch()
        assert str(said.value) == f"{tmp_path / 'flight'}: Read-only file system; the results are in {folder.path}"
        assert (folder.path / "map").exists()

    def test_another_disk_may_be_meant(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        """Protects `--out` of an empty disk: nothing can be moved there by its name alone."""
        (tmp_path / "disk").mkdir()
        rename = os.rename

        def across(source: str, target: str) -> None:
            if Path(target).parent == tmp_path / "disk":
                raise OSError(errno.EXDEV, "Invalid cross-device link")
            rename(source, target)

        monkeypatch.setattr(os, "rename", across)
        monkeypatch.setattr(Path, "replace", lambda self, target: across(str(self), str(target)))
        with run_folder.new_folder(tmp_path / "disk") as folder:
            (folder.path / "map").write_text("map", encoding="utf-8")
            (folder.path / "map.journal").mkdir()
            (folder.path / "map.journal" / "segment").write_text("segment", encoding="utf-8")
        assert {path.name for path in tmp_path.iterdir()} == {"disk"}
        assert (tmp_path / "disk" / "map.journal" / "segment").read_text(encoding="utf-8") == "segment"
