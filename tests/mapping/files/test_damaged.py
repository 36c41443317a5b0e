"""Files that are no maps, or were: one clear error each, in bounded time and memory."""

from __future__ import annotations

from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.errors import InputError
from companion.mapping.files import MapFileError, open_map, write
from companion.mapping.files.octree import BINARY_NAME, FULL_NAME
from companion.mapping.journal import Header, Journal
from companion.mapping.voxels.piece import MapPiece
from tests.mapping.files.sources import contents, of_voxels, scattered

SMALL = scattered(5, chunks=8)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """A small map in both formats."""
    folder = tmp_path_factory.mktemp("maps")
    for suffix in ("bt", "ot"):
        write(SMALL, folder / f"map.{suffix}")
    return {suffix: (folder / f"map.{suffix}").read_bytes() for suffix in ("bt", "ot")}


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder for files that are written over and over."""
    return tmp_path_factory.mktemp("damaged")


@pytest.mark.parametrize("suffix", ["bt", "ot"])
@settings(max_examples=150, deadline=None)
@given(data=st.data())
def test_damage_is_an_error_or_a_map(files: dict[str, bytes], place: Path, suffix: str, data: st.DataObject) -> None:
    """Protects whoever opens a file from a card that failed: never a crash, never another error, never for ever."""
    whole = files[suffix]
    damaged = bytearray(whole)
    for _ in range(data.draw(st.integers(0, 4))):
        at = data.draw(st.integers(0, len(whole) - 1))
        damaged[at] = data.draw(st.integers(0, 255))
    damaged = damaged[: data.draw(st.one_of(st.just(len(whole)), st.integers(0, len(whole))))]
    path = place / f"map.{suffix}"
    path.write_bytes(damaged)
    error = _error_of(path)
    assert error is None or (str(path) in error and bytes(damaged) != whole)


@pytest.mark.parametrize("suffix", ["bt", "ot"])
@settings(max_examples=100, deadline=None)
@given(tree=st.binary(max_size=60), size=st.integers(0, 60))
def test_any_bytes_are_an_error_or_a_map(place: Path, suffix: str, tree: bytes, size: int) -> None:
    """Protects from files that somebody made on purpose."""
    name = BINARY_NAME if suffix == "bt" else FULL_NAME
    path = place / f"map.{suffix}"
    path.write_bytes(f"{name}\nid OcTree\nsize {size}\nres 0.1\ndata\n".encode() + tree)
    error = _error_of(path)
    assert error is None or str(path) in error


def _error_of(path: Path) -> str | None:
    """What is said against a file; some pieces are read, as all can be many."""
    try:
        for piece in islice(open_map(path).pieces(100), 5):
            assert piece.values.shape == (len(piece.chunks), 4096)
    except MapFileError as error:
        return str(error)
    return None


@pytest.mark.parametrize("suffix", ["bt", "ot"])
def test_every_cut_is_noticed(files: dict[str, bytes], place: Path, suffix: str) -> None:
    """Protects from half a map that passes for a whole one, wherever the copy stopped."""
    path = place / f"map.{suffix}"
    for length in np.linspace(0, len(files[suffix]) - 1, 300, dtype=int):
        path.write_bytes(files[suffix][:length])
        with pytest.raises(MapFileError, match=r"OctoMap|end"):
            open_map(path)


HEAD = f"{FULL_NAME}\nid OcTree\nsize 13\nres 0.1\n"
NODE = b"\0\0\0\0"
TREE_AT = len(HEAD) + len("data\n")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "no end"),
        (b"ply", "no end"),
        (b"ply\nformat\n", "begins neither"),
        (HEAD.replace("OcTree\ns", "CountingOcTree\ns").encode() + b"data\n", "'CountingOcTree'; 'OcTree' and 'Col"),
        (HEAD.replace("OcTree\ns", "SemanticOcTree\ns").encode() + b"data\n", "of the kind 'SemanticOcTree'"),
        (HEAD.replace("id OcTree\n", "").encode() + b"data\n", "of the kind ''"),
        (HEAD.replace("0.1", "0").encode() + b"data\n", "res = 0 m must be"),
        (HEAD.replace("0.1", "nan").encode() + b"data\n", "res in the header is nan"),
        (HEAD.replace("res 0.1\n", "").encode() + b"data\n", "res in the header is missing"),
        (HEAD.replace("13", "many").encode() + b"data\n", "size in the header is many"),
        (HEAD.replace("13", "0").encode() + b"data\n\0", f"byte {TREE_AT - 1}: there is more after the end"),
        (HEAD.encode() + b"data\n" + b"\0\0\x80\x7f\0", f"byte {TREE_AT}: log-odds that are not a finite number"),
        (HEAD.encode() + b"data\n" + (NODE + b"\1") * 17, f"byte {TREE_AT + 80}: a node below the voxels"),
        (HEAD.encode() + b"data\n" + (NODE + b"\1") * 5, f"byte {TREE_AT + 25}: the file ends in the middle"),
        (
            HEAD.encode() + b"data\n" + (NODE + b"\1") * 12 + NODE * 2,
            f"byte {TREE_AT + 65}: there is more after the end",
        ),
        (HEAD.encode() + b"data\n" + (NODE + b"\1") * 13 + NODE + b"\0", "says 13 nodes, the tree has 14"),
        (HEAD.encode() + b"data\n" + NODE + b"\0", "more than 1048576 chunks"),
        (HEAD.encode() + b"# " + b"x" * 5000, "no end"),
        (HEAD.encode() + b"# x\n" * 20_000, "no end"),
        (HEAD.replace("id", "# occupied from log-odds of -3 on\nid").encode() + b"data\n", "threshold of -3"),
        (
            HEAD.replace(FULL_NAME, BINARY_NAME).encode() + b"data\n\0\0",
            f"byte {TREE_AT + 7}: an inner node without children",
        ),
    ],
)
def test_each_damage_has_its_message(content: bytes, message: str, tmp_path: Path) -> None:
    """Protects the person who must find out what is wrong: file, offset and what it is."""
    path = tmp_path / "map.ot"
    path.write_bytes(content)
    with pytest.raises(MapFileError, match=message) as caught:
        open_map(path)
    assert str(path) in str(caught.value)


def test_a_file_that_was_written_anew_is_not_read_on(tmp_path: Path) -> None:
    """Protects from half of the old map and half of the new one."""
    path = tmp_path / "map.ot"
    write(SMALL, path)
    opened = open_map(path)
    write(of_voxels({(0, 0, 0): 5}), path)
    with pytest.raises(MapFileError, match="written anew since it was opened"):
        list(opened.pieces())


@pytest.mark.parametrize("name", ["map.stl", "map", "map.journal"])
def test_what_cannot_be_read_is_said(name: str, tmp_path: Path) -> None:
    """Protects from guessing which files hold a map."""
    with pytest.raises(InputError, match=r"map\.journal.*\.bt, \.ot, \.ply, \.pcd, \.las or \.laz"):
        open_map(tmp_path / name)


def test_a_missing_file_is_said(tmp_path: Path) -> None:
    """Protects from a traceback for a name that was mistyped."""
    with pytest.raises(MapFileError, match="there is no such file"):
        open_map(tmp_path / "map.OT")


def test_a_journal_is_a_map(tmp_path: Path) -> None:
    """Protects what a mission kept: its journal is opened as a map is, and written as a file."""
    header = Header(voxel_m=0.1, threshold=847, lowest=-2000, highest=3511, frame="map", settings={})
    with Journal.open(tmp_path / "map.journal", header) as journal:
        journal.append(MapPiece(SMALL.chunks, SMALL.values))
        journal.commit()
    opened = open_map(tmp_path / "map.journal")
    try:
        assert contents(opened) == contents(SMALL)
        write(opened, tmp_path / "map.ot")
        assert contents(open_map(tmp_path / "map.ot")) == contents(SMALL)
    finally:
        assert isinstance(opened, Journal)
        opened.close()
