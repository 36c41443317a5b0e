"""`companion map build`: maps of data sets and of recorded flights."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from companion.cli.maps.progress import Progress
from companion.config.mission import RecordSettings
from companion.mapping.files import open_map
from companion.mapping.journal import Journal
from companion.mapping.voxels.chunks import NOTHING, OFFSETS
from companion.mapping.voxels.voxel_map import VoxelMap
from companion.model import FloatArray
from companion.recording import RECORDING_NAME, open_recording
from tests.cli.maps.conftest import Run, tree
from tests.mapping.datasets import rooms
from tests.mapping.files.sources import contents
from tests.recording.flights import SETTINGS, fly_in_room

OPTICS = ("--intrinsics", *rooms.OPTICS)


def _centres_m(path: Path, *, occupied: bool) -> FloatArray:
    source = open_map(path)
    found: list[FloatArray] = [np.zeros((0, 3))]
    for piece in source.pieces():
        known = piece.values >= source.threshold if occupied else (piece.values < 0) & (piece.values != NOTHING)
        row, place = np.nonzero(known)
        found.append(np.asarray((16 * piece.chunks[row] + OFFSETS[place] + 0.5) * source.voxel_m, np.float64))
    if isinstance(source, Journal):
        source.close()
    return np.concatenate(found)


def _refuse_another_room(path: Path, within_m: float) -> None:
    """The walls are where they were, all six of them, and inside it is free."""
    walls = _centres_m(path, occupied=True)
    off_m = np.minimum(np.abs(walls - rooms.LOW_M), np.abs(walls - rooms.HIGH_M)).min(axis=1)
    assert off_m.max() <= within_m
    for axis in range(3):
        for wall_m in (rooms.LOW_M[axis], rooms.HIGH_M[axis]):
            assert np.count_nonzero(np.abs(walls[:, axis] - wall_m) <= within_m) > 50
    free = _centres_m(path, occupied=False)
    assert ((free > rooms.LOW_M - within_m) & (free < rooms.HIGH_M + within_m)).all()
    assert len(free) * 0.1**3 > 0.7 * np.prod(rooms.HIGH_M - rooms.LOW_M)


@pytest.mark.parametrize("target", ["a.journal", "a.ot", "a.laz"])
def test_a_sequence_of_tum(run: Run, tmp_path: Path, target: str) -> None:
    """Protects maps of other people's data: the room as it was, in every format that a map has."""
    folder = rooms.tum(tmp_path / "fr1_room")
    out = tmp_path / target
    code, printed, errors = run("build", out, "--from", folder, "--format", "tum", *OPTICS)
    assert (code, errors) == (0, "")
    assert printed.endswith(f" chunks from {len(rooms.VIEWS_DEG)} depth images\n")
    assert {path.name for path in tmp_path.iterdir()} == {"fr1_room", target}
    if target != "a.laz":
        _refuse_another_room(out, 0.11)
        assert run("info", out)[0] == 0
    if target == "a.journal":
        assert "frame         TUM RGB-D, z up" in run("info", out)[1]


@pytest.mark.parametrize(("up", "world"), [(None, rooms.Y_DOWN), ("z", np.eye(3)), ("y", rooms.Y_UP)])
def test_a_sequence_of_7_scenes(run: Run, tmp_path: Path, up: str | None, world: rooms.Matrix) -> None:
    """Protects worlds in which something else is up: the floor is below, and nothing is mirrored."""
    folder = rooms.seven_scenes(tmp_path / "seq-01", world)
    arguments = () if up is None else ("--up", up)
    assert run("build", tmp_path / "a.ot", "--from", folder, "--format", "7scenes", *OPTICS, *arguments)[0] == 0
    _refuse_another_room(tmp_path / "a.ot", 0.11)


def test_settings_of_the_map(run: Run, tmp_path: Path) -> None:
    """Protects the options that a map has anywhere else: the file's, and those of the command line over it."""
    folder = rooms.tum(tmp_path / "a", units_per_m=1000.0)
    (tmp_path / "v.yaml").write_text("mapping: {voxel_m: 0.2, max_range_m: 5.0}\n")
    base = ("--from", folder, "--format", "tum", "--depth-scale", 1000, *OPTICS)
    for out, options, voxel in (("b.ot", (), 0.2), ("c.ot", ("--voxel", 0.25, "--max-range", 4), 0.25)):
        assert run("build", tmp_path / out, *base, "--config", tmp_path / "v.yaml", *options)[0] == 0
        assert f"voxel         {voxel} m" in run("info", tmp_path / out)[1]
    code, _, errors = run("build", tmp_path / "d.ot", *base, "--voxel", 5)
    assert (code, errors.count("\n")) == (2, 1)
    assert errors.startswith("--voxel 5: mapping.voxel_m: Input should be less than or equal to 1")


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short flight in a simulated room, with images and planar scans."""
    file = tmp_path_factory.mktemp("flight") / "flight.mcap"
    assert fly_in_room(file, 3.0).problem is None
    return file


def test_a_recorded_flight_gives_the_map_that_it_made(run: Run, flight: Path, tmp_path: Path) -> None:
    """Protects a map that was lost with its disk: the recording has all that went into it, and its settings."""
    expected = VoxelMap(SETTINGS.mapping)
    for _, observation in open_recording(flight).observations():
        assert observation is not None
        if observation.frame is not None:
            expected.integrate(observation.frame)
        if observation.planar is not None:
            expected.integrate_scan(observation.planar)
    code, printed, errors = run("build", tmp_path / "a.journal", "--from", flight)
    assert (code, errors) == (0, "")
    assert "depth images and " in printed
    with Journal.read_only(tmp_path / "a.journal") as journal:
        assert contents(journal) == contents(expected)
        assert journal.header.frame == "east-north-up"


def test_the_folder_of_a_flight_means_its_recording(run: Run, flight: Path, tmp_path: Path) -> None:
    """Protects who gives the folder, as to every other command."""
    assert flight.name == RECORDING_NAME
    assert run("build", tmp_path / "a.ot", "--from", flight.parent)[0] == 0
    assert open_map(tmp_path / "a.ot").voxel_m == SETTINGS.mapping.voxel_m


def test_a_recording_that_is_cut_gives_what_it_has(run: Run, flight: Path, tmp_path: Path) -> None:
    """Protects the flight that ended in a crash: the map up to there, and that it ends there."""
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(flight.read_bytes()[: flight.stat().st_size * 2 // 3])
    code, printed, errors = run("build", tmp_path / "a.ot", "--from", cut, "--voxel", 0.2)
    assert code == 0
    assert errors.startswith(f"{cut}: ends early (")
    assert "depth images" in printed
    assert open_map(tmp_path / "a.ot").voxel_m == 0.2


def test_what_gives_no_map_is_refused(run: Run, flight: Path, tmp_path: Path) -> None:
    """Protects from an empty map, from options that mean nothing, and from half of a map: nothing is left behind."""
    folder = rooms.tum(tmp_path / "a")
    blind = tmp_path / "blind.mcap"
    fly_in_room(blind, 0.5, record=RecordSettings(depth=False))
    bad = rooms.tum(tmp_path / "bad")
    sorted((bad / "depth").iterdir())[5].write_bytes(b"\x89PNG")
    (tmp_path / "there.journal").mkdir()
    (tmp_path / "there.journal" / "holiday.jpg").write_bytes(b"")
    before = tree(tmp_path)
    tum = ("--from", folder, "--format", "tum")
    for out, arguments, says in (
        ("o.stl", (*tum, *OPTICS), "a map is a folder NAME.journal, or a file that ends in one of .ply"),
        ("o.ot", ("--from", folder), "of which format is this folder? Give --format tum or --format 7scenes"),
        ("o.ot", ("--from", folder, "--format", "7scenes"), "no image is called frame-000000.depth.png"),
        ("o.ot", tum, "is 96 x 72 px, the camera of this format has 640 x 480"),
        ("o.ot", (*tum, "--intrinsics", 0, 1, 2, 3), "--intrinsics 0 1 2 3: must be finite numbers"),
        ("o.ot", (*tum, *OPTICS, "--depth-scale", 1), "so there is no map: is the unit of the images right"),
        ("o.ot", ("--from", bad, "--format", "tum", *OPTICS), "is no PNG image, or damaged"),
        ("o.ot", ("--from", flight, "--format", "tum"), "--format: is for folders of data sets"),
        ("o.ot", ("--from", flight, "--up", "-y"), "--up: is for folders of data sets"),
        ("o.ot", ("--from", folder / "depth.txt"), "is no recording of a flight"),
        ("o.ot", ("--from", tmp_path / "nowhere"), "there is no such file or folder"),
        ("there.journal", (*tum, *OPTICS, "--overwrite"), "is there and holds no map"),
    ):
        code, printed, errors = run("build", tmp_path / out, *arguments)
        assert (code, printed, errors.count("\n")) == (2, "", 1), errors
        assert says in errors
    assert tree(tmp_path) == before


def test_ctrl_c_leaves_nothing_half(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects the folder: interrupted in the midst of the images, the exit code is 130 and nothing is left."""
    rooms.tum(tmp_path / "a")

    def interrupted(_: Progress, share: float | None) -> None:
        if share is not None and share > 0.5:
            assert len(list(tmp_path.iterdir())) == 2, "something is being built, or this would show nothing"
            raise KeyboardInterrupt

    monkeypatch.setattr(Progress, "__call__", interrupted)
    code, printed, _ = run("build", tmp_path / "o.journal", "--from", tmp_path / "a", "--format", "tum", *OPTICS)
    assert (code, printed) == (130, "")
    assert {path.name for path in tmp_path.iterdir()} == {"a"}
