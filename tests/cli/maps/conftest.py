"""Missions with a map, the command itself, and how files are compared."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import octomap
import pytest
from numpy.typing import NDArray

from companion.cli import main as cli
from companion.cli.maps import progress as progress_module
from companion.config.mapping import MapSettings
from companion.mapping.journal import Header, Journal
from companion.mapping.voxels.chunks import NOTHING, OFFSETS
from companion.mapping.voxels.piece import MapPiece

Run = Callable[..., tuple[int, str, str]]

HEADER = Header.of(MapSettings(voxel_m=0.1))


def room(shift: int = 0) -> MapPiece:
    """A room of 3 x 2 x 1 m with walls of one voxel, moved by ``shift`` voxels along x."""
    chunks = np.stack(np.meshgrid([-1, 0, 1, 2], [-1, 0, 1], [-1, 0], indexing="ij"), axis=-1).reshape(-1, 3)
    voxels = chunks[:, None] * 16 + OFFSETS - [shift, 0, 0]
    inside = ((voxels >= 0) & (voxels < [30, 20, 10])).all(axis=-1)
    around = ((voxels >= -1) & (voxels < [31, 21, 11])).all(axis=-1)
    values = np.full(inside.shape, NOTHING)
    values[around], values[inside] = 1000, -1000
    return MapPiece(chunks.astype(np.int32), values)


def journal_at(folder: Path, shift: int = 0, header: Header = HEADER) -> Path:
    """A journal with a room in it."""
    with Journal.open(folder, header) as journal:
        journal.append(room(shift))
    return folder


def tree(folder: Path) -> dict[str, bytes]:
    """Every file below a folder: equal if nothing has changed."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def labels(path: Path, points: NDArray[np.float64]) -> list[int]:
    """What OctoMap says of points in a .bt or .ot file."""
    if path.suffix == ".bt":
        read = octomap.OcTree(1.0)
        assert read.readBinary(str(path).encode())
    else:
        read = octomap.OcTree.read(str(path).encode())
    return [int(label) for label in read.getLabels(points)]


# A mission with a map, and the command itself.


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Run:
    """Runs `companion map ...` and gives its exit code, stdout and stderr, without progress on a slow machine."""
    monkeypatch.setattr(progress_module, "PATIENCE_S", math.inf)

    def run_command(*arguments: object) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as ended:
            cli.main(["map", *map(str, arguments)])
        printed = capsys.readouterr()
        return int(ended.value.code or 0), printed.out, printed.err

    return run_command


@pytest.fixture
def mission(tmp_path: Path) -> Path:
    """A mission's folder with a journal."""
    folder = tmp_path / "mission"
    folder.mkdir()
    journal_at(folder / "map.journal")
    return folder
