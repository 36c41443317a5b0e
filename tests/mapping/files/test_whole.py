"""Folders that are written beside their place, and change places with what was there."""

from __future__ import annotations

import ctypes
import errno
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from companion.mapping.files.whole import exchange, workshop


def two(tmp_path: Path) -> tuple[Path, Path]:
    """A new folder and an old one, each with a file that says so."""
    new, old = tmp_path / "new", tmp_path / "old"
    for folder in (new, old):
        folder.mkdir()
        (folder / "file").write_text(folder.name, encoding="utf-8")
    return new, old


class NoExchange:
    """A C library on a file system that cannot exchange."""

    def __init__(self, number: int) -> None:
        self._number = number

    def renameat2(self, *_: object) -> int:
        ctypes.set_errno(self._number)
        return -1


@pytest.mark.parametrize("number", [None, errno.EINVAL, errno.ENOSYS])
def test_what_was_there_changes_places_with_what_is_new(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int | None
) -> None:
    """Protects a good map from a kill between two renames: at no moment is there none, where the system can do that."""
    if number is not None:
        monkeypatch.setattr(ctypes, "CDLL", lambda *_, **__: NoExchange(number))
    new, old = two(tmp_path)
    exchange(new, old)
    assert ((old / "file").read_text("utf-8"), (new / "file").read_text("utf-8")) == ("new", "old")


@pytest.mark.parametrize("number", [errno.EACCES, errno.EINVAL])
def test_what_cannot_be_exchanged_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int) -> None:
    """Protects the old map from a disk that refuses the new one."""
    monkeypatch.setattr(ctypes, "CDLL", lambda *_, **__: NoExchange(number))
    new, old = two(tmp_path)
    replace = Path.replace

    def refused(self: Path, target: Path) -> Path:
        if self == new:
            raise OSError(errno.ENOSPC, "No space left on device")
        return replace(self, target)

    monkeypatch.setattr(Path, "replace", refused)
    with pytest.raises(OSError, match=r"Permission denied|No space left"):
        exchange(new, old)
    assert (old / "file").read_text("utf-8") == "old"


def test_what_a_killed_process_left_goes_away_with_the_next_one(tmp_path: Path) -> None:
    """Protects the disk from the halves of large maps; what somebody else is at, or was not put back, stays."""
    code = "import os, sys, pathlib, signal\nfrom companion.mapping.files.whole import workshop\n"
    code += "with workshop(pathlib.Path(sys.argv[1])):\n    os.kill(os.getpid(), signal.SIGKILL)\n"
    place = tmp_path / "m.journal"
    ended = subprocess.run([sys.executable, "-c", code, str(place)], check=False, env=os.environ)
    assert ended.returncode == -signal.SIGKILL
    (left,) = tmp_path.iterdir()
    kept = tmp_path / ".m.journal.x.unfinished"
    (kept / "merged.aside").mkdir(parents=True)
    with workshop(place) as first, workshop(place) as second:
        assert not left.exists()
        assert {first, second, kept} == set(tmp_path.iterdir())
    assert {kept} == set(tmp_path.iterdir())
