"""The cache of compiled functions: fresh as long as all sources are from which they were compiled."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from companion import compiled
from companion.mapping.frontiers.flood import follow_map
from companion.mapping.voxels import chunks

ROOT = Path(compiled.__file__).parents[1]


@pytest.fixture
def sources(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A package in which a imports b, b imports c and a again, and d stands alone."""
    folder = tmp_path / "companion" / "room"
    folder.mkdir(parents=True)
    (folder / "a.py").write_text("from companion.room import (\n    b,\n)\n", encoding="utf-8")
    (folder / "b.py").write_text("from companion.room.c import EDGE  # of a chunk\nimport companion.room.a\n", "utf-8")
    (folder / "c.py").write_text("EDGE = 16\n", encoding="utf-8")
    (folder / "d.py").write_text("", encoding="utf-8")
    monkeypatch.setattr(compiled, "_ROOT", tmp_path)
    return folder


@pytest.mark.parametrize(("changed", "stale"), [("a", True), ("b", True), ("c", True), ("d", False)])
def test_a_change_of_what_a_function_is_compiled_from_is_seen(sources: Path, changed: str, stale: bool) -> None:
    """Protects a flight from machine code of yesterday, also where only a number in another file is another."""
    before = compiled.source_stamp(sources / "a.py")
    (sources / f"{changed}.py").write_text("from companion.room.c import EDGE\nEDGE_M = 1.7\n", encoding="utf-8")
    compiled._source.cache_clear()
    assert (compiled.source_stamp(sources / "a.py") != before) == stale


def test_numba_asks_for_the_stamp() -> None:
    """Protects from a numba that does not know the setting any more: it would look at one file alone again."""
    functions: tuple[Any, ...] = follow_map, chunks.place_of
    for function in functions:
        file = Path(function.py_func.__code__.co_filename).resolve()
        assert compiled.source_stamp(file) in function._cache._cache_file._index_name


def test_what_is_stale_is_removed(tmp_path: Path) -> None:
    """Protects from an index that names a type that is no more, which nothing could read, and from a full disk."""
    names = [f"flood.add-{end}" for end in ("3.old.py311.nbi", "3.old.py311.1.nbc", "5.py311.nbi", "3.new.py311.nbi")]
    for name in [*names, "flood_work.wait-3.old.py311.nbi"]:
        (tmp_path / name).touch()
    compiled._sweep(tmp_path, "flood", "new")
    assert {path.name for path in tmp_path.iterdir()} == {names[-1], "flood_work.wait-3.old.py311.nbi"}


def test_everything_is_compiled_in_the_one_way() -> None:
    """Protects from a function whose cache is numba's own."""
    files = [path for room in ("companion", "sitl", "bench") for path in (ROOT / room).rglob("*.py")]
    assert [path.name for path in files if "njit" in path.read_text(encoding="utf-8")] == ["compiled.py"]
