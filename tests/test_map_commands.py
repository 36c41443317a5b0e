"""`companion map`: what it prints, what it writes, and what it refuses without touching anything."""

from __future__ import annotations

import dataclasses
import errno
import io
import json
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import octomap
import pytest
from numpy.typing import NDArray
from rich.console import Console

from companion import cli
from companion.config.mapping import MapSettings
from companion.map_commands import convert, look, sources
from companion.map_commands import progress as progress_module
from companion.map_commands.progress import LINE_PERIOD_S, PATIENCE_S, Progress
from companion.mapping.chunks import NOTHING, OFFSETS
from companion.mapping.files import write
from companion.mapping.journal import Header, Journal
from companion.mapping.piece import MapPiece

Run = Callable[..., tuple[int, str, str]]

HEADER = Header.of(MapSettings(voxel_m=0.1))
COMMANDS = ("info", "export", "merge", "view")


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


@pytest.fixture
def mission(tmp_path: Path) -> Path:
    """A mission's folder with a journal."""
    folder = tmp_path / "mission"
    folder.mkdir()
    journal_at(folder / "map.journal")
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


def test_info_says_what_the_map_holds(run: Run, mission: Path) -> None:
    """Protects the figures at a glance, for a mission's folder as for its journal."""
    code, printed, errors = run("info", mission)
    assert (code, errors) == (0, "")
    rows = {line[:13].strip(): line[14:] for line in printed.splitlines()}
    assert rows["voxel"] == "0.1 m"
    assert rows["frame"] == "east-north-up"
    assert rows["voxels"] == f"{32 * 22 * 12 - 6000:,} occupied, 6,000 free, 0 undecided"
    assert rows["free space"] == "6.0 m³"
    assert rows["bounds"] == "x -0.10 to 3.10, y -0.10 to 2.10, z -0.10 to 1.10 m"
    assert rows["extent"] == "3.20 x 2.20 x 1.20 m"
    assert "occupied from 0.70 on, clamps 0.12 and 0.97" in rows["sensor model"]
    assert rows["damage"] == "none found"
    assert run("info", mission / "map.journal")[1] == printed


def test_info_for_programs(run: Run, mission: Path) -> None:
    """Protects scripts: the JSON holds the same as the table, and every name has its unit."""
    found = json.loads(run("info", mission, "--json")[1])
    assert found["facts"]["free"] == 6000
    assert found["facts"]["surface_m2"] == pytest.approx(2 * (3 * 2 + 3 * 1 + 2 * 1), rel=0.02)
    assert found["extent_m"] == pytest.approx([3.2, 2.2, 1.2])
    assert found["header"]["voxel_m"] == 0.1
    assert found["bytes_on_disk"] == sum(file.stat().st_size for file in (mission / "map.journal").iterdir())
    assert (found["losses"], found["lost_bytes"], found["torn_bytes"]) == (0, 0, 0)


def test_info_of_an_octomap_file(run: Run, mission: Path, tmp_path: Path) -> None:
    """Protects maps of other programs: what their file does not say is not made up."""
    run("export", mission, tmp_path / "map.ot")
    code, printed, _ = run("info", tmp_path / "map.ot")
    assert code == 0
    assert "frame         not said in the file" in printed
    assert "6,000 free" in printed


def test_info_counts_what_is_damaged(run: Run, mission: Path) -> None:
    """Protects from a damaged map that looks whole: one flipped byte costs one record, and is said."""
    segment = max((mission / "map.journal").iterdir(), key=lambda file: file.stat().st_size)
    data = bytearray(segment.read_bytes())
    data[len(data) * 3 // 4] ^= 0xFF
    segment.write_bytes(data)
    before = tree(mission)
    code, printed, _ = run("info", mission)
    assert code == 0
    assert "1 places cannot be read" in printed
    assert json.loads(run("info", mission, "--json")[1])["losses"] == 1
    assert tree(mission) == before


def test_info_says_that_the_end_is_torn(run: Run, mission: Path) -> None:
    """Protects the report after a crash: a torn end is no damage, because nothing that was committed is lost."""
    segment = max((mission / "map.journal").iterdir(), key=lambda file: file.stat().st_size)
    segment.write_bytes(segment.read_bytes()[:-3])
    _, printed, _ = run("info", mission)
    assert "its writer was stopped in mid-write" in printed
    assert "cannot be read" not in printed


@pytest.mark.parametrize("format_", ["ply", "pcd", "las", "laz", "bt", "ot", "obj"])
def test_export_by_suffix(run: Run, mission: Path, tmp_path: Path, format_: str) -> None:
    """Protects every format that the help names."""
    target = tmp_path / f"out.{format_}"
    code, printed, errors = run("export", mission, target)
    assert (code, errors) == (0, "")
    assert printed == f"{target}: {target.stat().st_size:,} bytes\n"
    assert sorted(tmp_path.iterdir()) == [mission, target]


def test_export_writes_the_map(run: Run, mission: Path, tmp_path: Path) -> None:
    """Protects the content: another program finds walls, free and unknown space where they are."""
    targets = tmp_path / "a.bt", tmp_path / "a.ot"
    assert run("export", mission, *targets)[0] == 0
    for target in targets:
        assert labels(target, np.array([[1.55, 1.05, 0.55], [-0.05, 1.05, 0.55], [9.0, 9.0, 9.0]])) == [0, 1, -1]


def test_export_of_a_mesh(run: Run, mission: Path, tmp_path: Path) -> None:
    """Protects the surface: a .ply has faces when it is asked for, and points only when not."""
    run("export", mission, tmp_path / "points.ply")
    assert run("export", mission, tmp_path / "mesh.ply", "--mesh")[0] == 0
    assert b"element face" in (tmp_path / "mesh.ply").read_bytes()[:1000]
    assert b"element face" not in (tmp_path / "points.ply").read_bytes()[:1000]


def test_export_of_a_box(run: Run, mission: Path, tmp_path: Path) -> None:
    """Protects a part of the map: what is outside is unknown there."""
    assert run("export", mission, tmp_path / "a.ot", "--box", "0", "0", "0", "1", "1", "1")[0] == 0
    assert labels(tmp_path / "a.ot", np.array([[0.55, 0.55, 0.55], [1.55, 1.05, 0.55]])) == [0, -1]


def test_export_replaces_only_when_told(run: Run, mission: Path, tmp_path: Path) -> None:
    """Protects files that are there; and of several targets none is written when one is refused."""
    there, new = tmp_path / "there.ply", tmp_path / "new.ply"
    there.write_bytes(b"mine")
    code, _, errors = run("export", mission, new, there)
    assert (code, there.read_bytes(), new.exists()) == (2, b"mine", False)
    assert errors == f"{there}: exists already; give another name, or --overwrite\n"
    assert run("export", mission, new, there, "--overwrite")[0] == 0
    assert there.read_bytes().startswith(b"ply")


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


def test_a_full_disk(run: Run, mission: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects from half a file and from a traceback: one line, exit code 1, and what was there still is."""
    (tmp_path / "a.ply").write_bytes(b"old")
    before = tree(tmp_path)

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(convert, "write", full)
    code, _, errors = run("export", mission, tmp_path / "a.ply", "--overwrite")
    assert (code, errors) == (1, f"{tmp_path / 'a.ply'}: No space left on device; nothing was written there\n")
    assert tree(tmp_path) == before


@pytest.mark.parametrize("arguments", [("export", "out.ot"), ("merge", "other.journal", "-o", "out.journal")])
def test_ctrl_c_leaves_nothing_half(mission: Path, tmp_path: Path, arguments: tuple[str, ...]) -> None:
    """Protects the folder: interrupted in the midst of writing, the exit code is 130 and no file is left of it."""
    journal_at(tmp_path / "other.journal", shift=10)
    before = tree(tmp_path)
    command, *rest = arguments
    # Stops for good when some of it is written, and says so: then comes the Ctrl-C.
    program = (
        "import sys, time\n"
        "from companion import cli\n"
        "from companion.map_commands.progress import Progress\n"
        "def stuck(self, share):\n"
        "    if share:\n"
        "        print('writing', flush=True)\n"
        "        time.sleep(60)\n"
        "Progress.__call__ = stuck\n"
        "cli.main(sys.argv[1:])\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", program, "map", command, str(mission), *rest],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": str(Path(cli.__file__).parents[1])},
    ) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "writing\n"
            assert len(list(tmp_path.iterdir())) > 2, "something is being written, or this would show nothing"
            process.send_signal(signal.SIGINT)
            _, errors = process.communicate(timeout=60)
        finally:
            process.kill()
    assert process.returncode == 130
    assert "Traceback" not in errors
    assert tree(tmp_path) == before
    assert {path.name for path in tmp_path.iterdir()} == {"mission", "other.journal"}


def test_the_help_waits_for_nothing() -> None:
    """Protects the help from the seconds that compiled code and a web server take to load."""
    program = (
        "import sys; from companion import cli\n"
        "try: cli.main(['map', 'view', '--help'])\n"
        "except SystemExit: print(sorted({'numba', 'viser', 'PIL', 'numpy'} & set(sys.modules)), file=sys.stderr)"
    )
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert ended.stderr.strip() == "[]"
    assert "--picture" in ended.stdout


def test_a_missing_extra_is_named(run: Run, mission: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects the user of a plain installation: what to install, and exit code 1."""
    for name in ("PIL", "viser"):
        monkeypatch.setitem(sys.modules, name, None)
    for module in ("page", "picture", "paper"):
        monkeypatch.delitem(sys.modules, f"companion.ground.{module}", raising=False)
    for arguments in ((mission,), (mission, "--picture", tmp_path / "a.png")):
        code, _, errors = run("view", *arguments)
        assert code == 1
        assert f"needs pip install '{look.EXTRA}'" in errors
        assert errors.count("\n") == 1


class Clock:
    """A clock that is set by hand."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


def test_progress_is_silent_when_it_is_quick_and_has_lines_in_a_log() -> None:
    """Protects logs: nothing for what is over at once, then a line now and then, and no control characters."""
    clock = Clock()
    log = io.StringIO()
    with Progress("writing a.ply", Console(file=log), clock) as progress:
        progress(0.1)
        clock.now_s += PATIENCE_S
        progress(0.2)
        clock.now_s += 0.9 * LINE_PERIOD_S
        progress(0.5)
        clock.now_s += 0.1 * LINE_PERIOD_S
        progress(None)
    assert log.getvalue() == "writing a.ply: 20%\nwriting a.ply: still at it\n"


def test_progress_is_a_bar_on_a_terminal(tmp_path: Path) -> None:
    """Protects the terminal: a bar with the task and its share, which is taken away at the end."""
    clock = Clock()
    with (tmp_path / "tty").open("w", encoding="utf-8") as terminal:
        console = Console(file=terminal, force_terminal=True, width=80)
        with Progress("writing a.ply", console, clock) as progress:
            clock.now_s += PATIENCE_S
            progress(0.25)
            progress(0.5)
            time.sleep(0.15)  # the bar draws itself ten times a second, in a thread of rich's own
    shown = (tmp_path / "tty").read_text()
    assert "writing a.ply" in shown
    assert "\x1b[2K" in shown
