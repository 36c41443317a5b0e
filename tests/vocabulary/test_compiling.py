"""Where compiled functions are kept when the usual places are closed, and what is said while they are compiled."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numba.core.caching as numba_caching
import pytest
from numba import config
from numba.core.event import Event, EventStatus

from companion import compiled, compiling
from companion.mapping.voxels import chunks

FILE = chunks.__file__
START, END = (
    Event("numba:compile", status)  # type: ignore[no-untyped-call]
    for status in (EventStatus.START, EventStatus.END)
)


@pytest.fixture
def _closed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither the package nor the home can be written, as on a read-only image and for a user without a home."""
    settings: Any = config
    monkeypatch.setattr(settings, "CACHE_DIR", "")
    usual = numba_caching._CacheLocator.ensure_cache_path

    def refused(self: Any) -> None:
        if not self.get_cache_path().startswith(str(tmp_path)):
            raise OSError("Read-only file system")
        usual(self)  # type: ignore[no-untyped-call]

    monkeypatch.setattr(numba_caching._CacheLocator, "ensure_cache_path", refused)


def answer() -> int:
    return 42


@pytest.mark.usefixtures("_closed")
def test_a_place_of_our_own_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects from a minute and a half at each start: before, nothing was kept, and nobody was told."""
    monkeypatch.setenv("CACHE_DIRECTORY", f"{tmp_path / 'cache'}:{tmp_path / 'other'}")
    place = compiling.find_place(answer, FILE)
    assert Path(place.get_cache_path()).parent == tmp_path / "cache"
    assert (tmp_path / "cache").stat().st_mode & 0o777 == 0o700
    monkeypatch.delenv("CACHE_DIRECTORY")
    assert compiling.own_place() == Path(f"/var/tmp/companion-{os.getuid()}")  # noqa: S108 - only its name


@pytest.mark.usefixtures("_closed")
def test_a_place_that_others_can_write_is_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects from machine code of somebody else: what lies in the cache is run."""
    (tmp_path / "cache").mkdir()
    (tmp_path / "cache").chmod(0o777)
    monkeypatch.setenv("CACHE_DIRECTORY", str(tmp_path / "cache"))
    assert compiling.find_place(answer, FILE) is None
    (tmp_path / "link").symlink_to(tmp_path)
    monkeypatch.setenv("CACHE_DIRECTORY", str(tmp_path / "link"))
    assert compiling.find_place(answer, FILE) is None


@pytest.mark.usefixtures("_closed")
def test_without_any_place_it_is_compiled_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects whoever has no place: numba would refuse to begin."""
    monkeypatch.setenv("CACHE_DIRECTORY", "/proc/nowhere")
    answer_compiled: Any = compiled.compiled(answer)
    assert answer_compiled() == 42


def test_what_lies_beside_the_sources_is_brought(tmp_path: Path) -> None:
    """Protects a read-only image, in which everything was compiled when it was built, from compiling it again."""
    before, folder = tmp_path / "__pycache__", tmp_path / "cache"
    for place in (before, folder):
        place.mkdir()
    names = ["chunks.place_of-3.new.py311.nbi", "chunks.place_of-3.new.py311.1.nbc"]
    for name in (*names, "chunks.place_of-3.old.py311.nbi", "chunk_table.find-3.new.py311.nbi"):
        (before / name).write_text("before", encoding="utf-8")
    (folder / names[0]).write_text("own", encoding="utf-8")
    compiling.bring(before, folder, "chunks", "new")
    assert {path.name: path.read_text("utf-8") for path in folder.iterdir()} == {names[0]: "own", names[1]: "before"}


def test_who_waits_for_the_compiler_is_told_after_two_seconds_and_then_now_and_then() -> None:
    """Protects from a start that looks as if it hung, and from lines about what is over at once."""
    now_s = [0.0]
    said: list[str] = []
    patience = compiling.Patience(said.append, lambda: now_s[0])

    def compile_for(duration_s: float, *, within: int = 0) -> None:
        patience.on_start(START)
        for _ in range(within):
            compile_for(duration_s / within)
        now_s[0] += 0.0 if within else duration_s
        patience.on_end(END)

    for _ in range(3):
        compile_for(0.6)
        now_s[0] += 100.0
    assert said == []
    compile_for(0.6)
    assert len(said) == 1
    assert "NUMBA_CACHE_DIR" in said[0]
    patience.kept_in = "/some/where"
    compile_for(20.0, within=4)
    assert [line.split(",")[1] for line in said] == [" 2 s so far", " 12 s so far", " 22 s so far"]
    assert "kept for the next start in /some/where" in said[2]
