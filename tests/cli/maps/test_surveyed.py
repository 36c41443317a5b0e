"""Maps that are written where they were surveyed: `companion map export --offset --crs`."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import laspy
import numpy as np
import pytest

from companion.cli.maps.extra import EXTRA
from tests.cli.maps.conftest import Run, tree

UTM = (500000.5, 6000000.25, -400)
LOW_M = np.array([-0.05, -0.05, -0.05])
"""Of the room in the mission: the centre of its lowest voxel."""


def _lowest_m(path: Path) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    return np.asarray(laspy.read(path).xyz.min(axis=0))


def test_a_map_is_written_where_it_was_surveyed(run: Run, mission: Path, tmp_path: Path) -> None:
    """Protects the place of a map: in a .laz, with its system, and the map's own coordinates in the other formats."""
    code, _, errors = run(
        "export", mission, tmp_path / "a.laz", tmp_path / "a.ot", "--offset", *UTM, "--crs", "EPSG:25832"
    )
    assert (code, errors) == (0, "")
    assert np.abs(_lowest_m(tmp_path / "a.laz") - LOW_M - UTM).max() < 0.001
    assert laspy.read(tmp_path / "a.laz").header.parse_crs().to_epsg() == 25832
    assert "x -0.10 to 3.10" in run("info", tmp_path / "a.ot")[1]


def test_a_run_in_a_mesh_far_away_goes_back_there(run: Run, mission: Path, tmp_path: Path) -> None:
    """Protects maps of surveyed meshes: the run's summary knows by how much the mesh was moved; what is said wins."""
    (mission / "summary.json").write_text(json.dumps({"world": "utm", "origin_m": UTM}))
    for source, name in ((mission, "a.las"), (mission / "map.journal", "b.las")):
        code, _, errors = run("export", source, tmp_path / name, tmp_path / f"{name}.ply")
        assert (code, errors) == (
            0,
            "the map's origin is at 500000.5 6000000.25 -400 m (origin_m in summary.json beside it)\n",
        )
        assert np.abs(_lowest_m(tmp_path / name) - LOW_M - UTM).max() < 0.001
    assert run("export", mission, tmp_path / "c.las", "--offset", 0, 0, 0)[0] == 0
    assert np.abs(_lowest_m(tmp_path / "c.las") - LOW_M).max() < 0.001
    assert run("export", mission, tmp_path / "c.ply")[2] == ""


@pytest.mark.parametrize(
    "summary",
    [
        '{"world": "complex, seed 1"}',
        '{"origin_m": [0.0, 0.0, 0.0]}',
        '{"origin_m": [1, 2]}',
        '{"origin_m": [1, 2, NaN]}',
        '{"origin_m": null}',
        "[1]",
        "{",
    ],
)
def test_a_summary_that_says_nothing_of_it_is_no_hindrance(
    run: Run, mission: Path, tmp_path: Path, summary: str
) -> None:
    """Protects every other run, and summaries of other programs."""
    (mission / "summary.json").write_text(summary)
    assert run("export", mission, tmp_path / "a.las")[::2] == (0, "")
    assert np.abs(_lowest_m(tmp_path / "a.las") - LOW_M).max() < 0.001


def test_what_cannot_be_is_refused(run: Run, mission: Path, tmp_path: Path) -> None:
    """Protects from a system that no file says, and from one that a map cannot be in."""
    before = tree(tmp_path)
    for arguments, says in (
        (("a.ply", "--crs", "EPSG:25832"), "--crs EPSG:25832: only .las and .laz hold a coordinate system"),
        (("a.las", "--crs", "EPSG:4326"), "EPSG:4326 (WGS 84) is no projected system"),
        (("a.las", "--offset", "nan", 0, 0), "--offset nan 0 0: must be three finite numbers"),
    ):
        code, printed, errors = run("export", mission, tmp_path / str(arguments[0]), *arguments[1:])
        assert (code, printed) == (2, "")
        assert says in errors
    assert tree(tmp_path) == before


def test_a_forgotten_place_is_said(run: Run, mission: Path, tmp_path: Path) -> None:
    """Protects from a mine in the Gulf of Guinea: the file is written, and what is odd of it is said."""
    code, _, errors = run("export", mission, tmp_path / "a.las", "--crs", "EPSG:25832")
    assert code == 0
    assert "the map lies at 4.51° east, 0.00° north: is --offset where its origin is" in errors


def test_what_is_to_be_installed_is_said(
    run: Run, mission: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Protects the user of a plain installation: everything but --crs works, and that names what it needs."""
    monkeypatch.setitem(sys.modules, "pyproj", None)
    monkeypatch.delitem(sys.modules, "pyproj.exceptions", raising=False)
    assert run("export", mission, tmp_path / "a.las", "--offset", *UTM)[0] == 0
    code, _, errors = run("export", mission, tmp_path / "b.las", "--crs", "EPSG:25832")
    assert (code, errors.count("\n")) == (1, 1)
    assert f"`companion map export --crs` needs pip install '{EXTRA}'" in errors
