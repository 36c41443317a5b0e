"""The command `companion sim`: what it writes, how it ends, and that it leaves nothing behind when it fails."""

from __future__ import annotations

import contextlib
import io
import json
import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import laspy
import numpy as np
import pytest

from companion.cli.main import main
from companion.config.load import load_settings
from companion.control.known_ground import KnownGround
from companion.mapping.files import Georeference, MapFileError, open_map, write
from companion.mapping.files.facts import facts_of
from companion.mapping.files.ground_file import ground_content, read_known_ground
from companion.mapping.voxels.piece import MapSource
from sitl.cli import sim
from sitl.report import run_folder
from sitl.sim import simulation
from sitl.sim.flight_log import COLUMNS
from sitl.sim.simulation import Simulation
from tests.sitl.scene.test_render import box

COMPANION = """
import signal
signal.signal(signal.SIGINT, signal.default_int_handler)  # a job in the background is started with SIGINT ignored
from companion.cli.start import main
main()
"""
QUICK = """
sensors:
  camera: {width_px: 64, height_px: 48}
mapping: {voxel_m: 0.3}
"""
MAP_FILES = {"map.ply", "map.pcd", "map.bt", "map.laz", "map.journal"}
FILES = MAP_FILES | {"trajectory.csv", "summary.json", "report.html", "settings.yaml", "overview.png"}
FILES |= {"graph.json", "known_ground.npz"}
EACH_HAS = ("trajectory.csv", "graph.json", "known_ground.npz")
"""Of several vehicles, each has its own."""
SUMMARY = {
    "world", "seed", "preset", "completeness", "precision", "accuracy_m", "completed_at_s", "sim_time_s", "wall_time_s",
    "times_real_time", "path_length_m", "contacts", "least_d_m", "time_below_d_s_fraction", "mode_changes", "draws",
    "ended_because", "versions",
}  # fmt: skip
"""What whoever compares runs relies on."""

LIMIT_S = 6.0


@dataclass(frozen=True)
class Done:
    """One command that has ended."""

    code: int
    out: str
    err: str
    folder: Path

    @property
    def summary(self) -> dict[str, object]:
        """The content of summary.json, which holds nothing that is not JSON."""

        def refuse(constant: str) -> None:
            raise AssertionError(constant)

        text = (self.folder / "summary.json").read_text(encoding="utf-8")
        content: dict[str, object] = json.loads(text, parse_constant=refuse)
        return content

    @property
    def files(self) -> set[str]:
        """Everything in the folder, hidden files too."""
        return {path.name for path in self.folder.iterdir()}


def fly(place: Path, *arguments: str) -> Done:
    """Runs `companion sim` in this process, with the quick settings and the folder ``place``/flight."""
    config = place / "quick.yaml"
    config.write_text(QUICK, encoding="utf-8")
    folder = place / "flight"
    given = ["--config", str(config)] if "--config" not in arguments else []
    given += ["--out", str(folder)] if "--out" not in arguments else []
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), pytest.raises(SystemExit) as ended:
        main(["sim", *given, *arguments])
    return Done(int(ended.value.code or 0), out.getvalue(), err.getvalue(), folder)


def left_in(place: Path) -> set[str]:
    """What is in a folder but for the settings that the test has put there."""
    return {path.name for path in place.iterdir()} - {"quick.yaml"}


def shorten(monkeypatch: pytest.MonkeyPatch) -> None:
    """Drawing takes seconds: where the report is not what the test is about, it is a word."""
    monkeypatch.setattr(run_folder, "write_report", lambda path, _: path.write_text("report", encoding="utf-8"))
    monkeypatch.setattr(run_folder, "overview_png", lambda *_: b"picture")


@pytest.fixture
def short_report(monkeypatch: pytest.MonkeyPatch) -> None:
    shorten(monkeypatch)


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Done:
    """A few seconds in the room, ended by the time limit."""
    with pytest.MonkeyPatch.context() as monkeypatch:
        shorten(monkeypatch)
        return fly(tmp_path_factory.mktemp("sim"), "--world", "room", "--seed", "4", "--time-limit", str(LIMIT_S))


class TestFolder:
    """What a flight brings home."""

    def test_everything_is_there_and_nothing_else(self, flight: Done) -> None:
        """Protects the promise of the command; the folder can be read by others, and no partial one is beside it."""
        assert flight.files == FILES
        assert all((flight.folder / name).stat().st_size > 0 for name in FILES)
        assert left_in(flight.folder.parent) == {"flight"}
        assert flight.folder.stat().st_mode & 0o777 == 0o755

    def test_the_summary_has_every_figure(self, flight: Done) -> None:
        """Protects whoever reads summary.json: the keys, and that what is not known is null and not NaN."""
        summary = flight.summary
        assert summary.keys() >= SUMMARY
        assert (summary["world"], summary["seed"], summary["preset"]) == ("room", 4, "flight")
        assert summary["ended_because"] == "time limit"
        assert summary["completed_at_s"] is None
        assert summary["contacts"] == 0
        assert LIMIT_S - 0.001 <= float(str(summary["sim_time_s"])) <= LIMIT_S + 0.05 + 0.001
        for name in ("completeness", "precision", "time_below_d_s_fraction"):
            assert 0.0 <= float(str(summary[name])) <= 1.0, name
        assert isinstance(summary["versions"], dict)

    def test_all_maps_hold_the_same_points(self, flight: Done) -> None:
        """Protects the map files from being partial or of different maps."""
        voxels = flight.summary["occupied_voxels"]
        assert isinstance(voxels, int)
        assert voxels > 100
        assert f"element vertex {voxels}\n".encode() in (flight.folder / "map.ply").read_bytes()[:2000]
        assert f"POINTS {voxels}\n".encode() in (flight.folder / "map.pcd").read_bytes()[:2000]
        with laspy.open(flight.folder / "map.laz") as las:
            assert las.header.point_count == voxels
        assert (flight.folder / "map.bt").read_bytes().startswith(b"# Octomap OcTree binary file")

    def test_the_trajectory_has_every_tick(self, flight: Done) -> None:
        """Protects the record of the flight, the true distances included."""
        lines = (flight.folder / "trajectory.csv").read_text(encoding="utf-8").splitlines()
        home = flight.summary["home"]
        assert isinstance(home, list)
        flown_s = float(str(flight.summary["sim_time_s"])) + home[0]["time_s"]
        assert len(lines) == 1 + round(flown_s / 0.05)
        heading, first = lines[0].split(","), lines[1].split(",")
        assert heading == ["t_s", "mode", *COLUMNS[1:]]
        assert float(first[heading.index("true_d_m")]) > 0.0

    def test_the_settings_fly_the_same_mission_again(self, flight: Done) -> None:
        """Protects repeatability: settings.yaml holds every setting, with those of the user's file in it."""
        again = load_settings(flight.folder / "settings.yaml")
        assert again == load_settings(flight.folder.parent / "quick.yaml")
        assert again.sensors.camera.width_px == 64

    def test_it_says_what_happened_and_where_to_look(self, flight: Done) -> None:
        """Protects the last lines on the screen: the end, the map, and the path of the report as it will be."""
        assert "time limit" in flight.out
        assert f"look at: {flight.folder / 'report.html'}" in flight.out
        assert "\x1b" not in flight.out


@pytest.mark.usefixtures("short_report")
class TestEnd:
    """Exit codes of missions that flew."""

    def test_a_time_limit_is_a_failure(self, flight: Done) -> None:
        """Protects scripts: the code is 1, with one line about why and how much of the map there is."""
        assert flight.code == 1
        assert flight.err.count("\n") == 1
        assert "time limit" in flight.err
        assert f"{float(str(flight.summary['completeness'])):.1%}" in flight.err

    def test_a_complete_map_is_a_success(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        """Protects scripts: the code is 0 and nothing is complained of. Complete is taken for 20 % here, for speed."""
        monkeypatch.setattr(simulation, "COMPLETE_SHARE", 0.2)
        done = fly(tmp_path, "--world", "room", "--time-limit", "120")
        assert (done.code, done.err) == (0, "")
        assert done.summary["ended_because"] == "complete"
        assert done.summary["completed_at_s"] == done.summary["sim_time_s"]

    def test_a_contact_is_a_failure(self, tmp_path: Path) -> None:
        """Protects scripts: a crash is never a success, and its record is kept."""
        fast = tmp_path / "fast.yaml"
        fast.write_text(
            "control: {speed_mps: 3, max_yaw_rate_radps: 0.1, law: paper, speed_law: paper,\n"
            "  allow_turning_radius_above_margin: true}\nsim: {dynamics: {command_latency_s: 1}}\n" + QUICK.strip(),
            encoding="utf-8",
        )
        done = fly(tmp_path, "--world", "room", "--config", str(fast), "--time-limit", "90")
        assert done.code == 1
        assert "contact" in done.err
        assert (done.summary["contacts"], done.summary["config"]) == (1, str(fast))
        assert done.files == FILES

    def test_several_vehicles_have_a_trajectory_each(self, tmp_path: Path) -> None:
        """Protects the records of a fleet from overwriting each other."""
        done = fly(tmp_path, "--world", "room", "--vehicles", "2", "--time-limit", "0.5")
        assert done.code == 1
        assert done.files == {name for name in FILES if name not in EACH_HAS} | {
            f"{Path(name).stem}-{number}{Path(name).suffix}" for name in EACH_HAS for number in (1, 2)
        }
        assert done.summary["vehicles"] == 2

    def test_a_mesh_of_the_user(self, tmp_path: Path) -> None:
        """Protects flights in scanned mines: mesh and start are given by hand, a preset by its name."""
        mesh = off_file(tmp_path / "hall.off", box((0.0, 0.0, 0.0), (8.0, 8.0, 3.0)))
        done = fly(tmp_path, "--world", str(mesh), "--start", "3", "4", "1.5", "0.5", "--preset", "table_i",
                   "--time-limit", "0.5")  # fmt: skip
        assert (done.code, done.summary["world"], done.summary["preset"]) == (1, "hall", "table_i")
        heading, first = ((done.folder / "trajectory.csv").read_text(encoding="utf-8").splitlines()[i] for i in (0, 1))
        row = dict(zip(heading.split(","), first.split(","), strict=True))
        assert [float(row[name]) for name in ("x_m", "y_m", "z_m", "yaw_rad")] == [3.0, 4.0, 1.5, 0.5]

    @pytest.mark.usefixtures("short_report")
    def test_a_mesh_in_millimetres_far_away(self, tmp_path: Path) -> None:
        """Protects the way back to a survey's coordinates: the shift is said, and kept in the summary."""
        mesh = off_file(tmp_path / "hall.off", box((0.0, 0.0, 0.0), (8.0, 8.0, 3.0)), 1000.0, (5e8, 6e9, 0))
        done = fly(tmp_path, "--world", str(mesh), "--scale", "0.001", "--time-limit", "0.5",
                   "--start", "500003000", "6000004000", "1500", "0.5")  # fmt: skip
        assert done.code == 1, done.err
        assert done.summary["origin_m"] == [500_000.0, 6_000_000.0, 0.0]
        assert "12 triangles, 8 x 8 x 3 m (x 500000.00 to 500008.00" in done.out
        assert "500000, 6000000, 0 m is the origin" in done.out
        trajectory = (done.folder / "trajectory.csv").read_text(encoding="utf-8").splitlines()
        row = dict(zip(trajectory[0].split(","), trajectory[1].split(","), strict=True))
        assert [float(row[name]) for name in ("x_m", "y_m", "z_m")] == pytest.approx([3.0, 4.0, 1.5])
        assert done.folder.joinpath("map.bt").is_file()
        low, high = (laspy.read(done.folder / "map.laz").header.mins, laspy.read(done.folder / "map.laz").header.maxs)
        assert np.all(low > [499_999.0, 5_999_999.0, -1.0])
        assert np.all(high < [500_009.0, 6_000_009.0, 4.0])


def off_file(path: Path, world: object, factor: float = 1.0, shift: tuple[float, float, float] = (0, 0, 0)) -> Path:
    """The mesh of a world as an OFF file, in another unit and elsewhere if wanted."""
    vertices, triangles = getattr(world, "vertices_m"), getattr(world, "triangles")  # noqa: B009
    lines = ["OFF", f"{len(vertices)} {len(triangles)} 0"]
    lines += [
        " ".join(f"{factor * x + d:.12g}" for x, d in zip(vertex, shift, strict=True)) for vertex in vertices.tolist()
    ]
    lines += [" ".join(map(str, [3, *triangle])) for triangle in triangles.tolist()]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


class TestWrongInput:
    """Exit code 2, one message, nothing left."""

    def refused(self, place: Path, *arguments: str) -> str:
        """The one message; beside it nothing may have been said, and nothing may be left that was not there before."""
        before = left_in(place)
        done = fly(place, *arguments)
        assert done.code == 2, done.err
        assert done.out == ""
        assert left_in(place) == before
        assert done.err.count("\n") == 1, done.err
        assert "Traceback" not in done.err
        return done.err

    def test_an_unknown_world(self, tmp_path: Path) -> None:
        """Protects from a typing error: the message names the worlds that there are."""
        said = self.refused(tmp_path, "--world", "rom")
        assert "world rom" in said
        assert "room" in said

    @pytest.mark.parametrize("name", ["missing.ply", "text.ply", "text.stl", "text.pdf", "empty.obj"])
    def test_a_mesh_that_is_none(self, tmp_path: Path, name: str) -> None:
        """Protects from files that are missing, empty, damaged or of another kind; the message names the file."""
        if name != "missing.ply":
            (tmp_path / name).write_text("" if "empty" in name else "this is no mesh\n", encoding="utf-8")
        assert name in self.refused(tmp_path, "--world", str(tmp_path / name), "--start", "0", "0", "1.5", "0")

    @pytest.mark.parametrize("options", [("--scale", "0"), ("--scale", "2"), ("--cloud-voxel", "9"), ("--up", "y")])
    def test_what_is_for_mesh_files_only_or_out_of_bounds(self, tmp_path: Path, options: tuple[str, ...]) -> None:
        """Protects from options that would be passed over in silence."""
        assert options[0] in self.refused(tmp_path, "--world", "room", *options)

    @pytest.mark.parametrize("start", [("-1", "1.8", "1.5", "0"), ("2", "0.1", "1.5", "0"), ("2", "1.8", "nan", "0")])
    def test_a_start_inside_a_wall(self, tmp_path: Path, start: tuple[str, ...]) -> None:
        """Protects from a mission that begins in rock, or nowhere."""
        done = fly(tmp_path, "--world", "room", "--start", *start)
        assert done.code == 2
        assert "start" in done.err
        assert "Traceback" not in done.err
        assert left_in(tmp_path) == set()

    def test_a_start_outside_of_a_mine_that_says_first_where_that_is(self, tmp_path: Path) -> None:
        """Protects whoever does not know that the file has another unit, axis or origin than was thought."""
        mesh = off_file(tmp_path / "hall.off", box((0.0, 0.0, 0.0), (8.0, 8.0, 3.0)))
        done = fly(tmp_path, "--world", str(mesh), "--up", "y", "--start", "4", "4", "1.5", "0")
        assert done.code == 2
        assert "12 triangles, 8 x 3 x 8 m (x 0.00 to 8.00, y -3.00 to 0.00, z 0.00 to 8.00), the file's y" in done.out
        assert "no floor below it" in done.err

    def test_a_folder_with_something_in_it(self, tmp_path: Path) -> None:
        """Protects what is there: an earlier flight is never overwritten or mixed with a new one."""
        (tmp_path / "flight").mkdir()
        (tmp_path / "flight" / "summary.json").write_text("old", encoding="utf-8")
        assert "exists already" in self.refused(tmp_path, "--world", "room")
        assert (tmp_path / "flight" / "summary.json").read_text(encoding="utf-8") == "old"
        assert {path.name for path in (tmp_path / "flight").iterdir()} == {"summary.json"}

    def test_a_file_in_the_place_of_the_folder(self, tmp_path: Path) -> None:
        """Protects a file of that name."""
        (tmp_path / "flight").write_text("mine", encoding="utf-8")
        assert "exists already" in self.refused(tmp_path, "--world", "room")
        assert (tmp_path / "flight").read_text(encoding="utf-8") == "mine"

    def test_a_folder_below_a_file(self, tmp_path: Path) -> None:
        """Protects from learning after an hour that nothing can be written there."""
        (tmp_path / "file").write_text("mine", encoding="utf-8")
        assert "--out" in self.refused(tmp_path, "--world", "room", "--out", str(tmp_path / "file" / "flight"))

    @pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
    def test_a_folder_that_may_not_be_written(self, tmp_path: Path) -> None:
        """Protects from learning it after an hour."""
        (tmp_path / "locked").mkdir(mode=0o555)
        assert "--out" in self.refused(tmp_path, "--world", "room", "--out", str(tmp_path / "locked" / "flight"))

    @pytest.mark.parametrize("limit", ["0", "-1", "nan", "inf"])
    def test_a_time_limit_that_is_none(self, tmp_path: Path, limit: str) -> None:
        """Protects from missions that end at once, or never."""
        assert f"--time-limit {limit}" in self.refused(tmp_path, "--world", "room", "--time-limit", limit)

    def test_too_many_vehicles(self, tmp_path: Path) -> None:
        """Protects the height layers of law (11): more vehicles than they have room for must be configured first."""
        said = self.refused(tmp_path, "--world", "room", "--vehicles", "9")
        assert "--vehicles 9" in said
        assert "fleet.largest_group" in said

    @pytest.mark.parametrize("config", ["missing.yaml", "bad.yaml"])
    def test_settings_that_cannot_be_used(self, tmp_path: Path, config: str) -> None:
        """Protects from flying with other settings than the user's."""
        (tmp_path / "bad.yaml").write_text("control: {margin_m: -1}\n", encoding="utf-8")
        assert config in self.refused(tmp_path, "--world", "room", "--config", str(tmp_path / config))

    @pytest.mark.parametrize(
        "arguments", [["--vehicles", "0"], ["--seed", "-1"], ["--start", "1", "2"], ["--wrld", "x"]]
    )
    def test_wrong_usage(self, tmp_path: Path, arguments: list[str]) -> None:
        """Protects from arguments that mean nothing: the message names the one that is wrong."""
        done = fly(tmp_path, *arguments)
        assert done.code == 2
        assert arguments[0] in done.err
        assert left_in(tmp_path) == set()


class TestInterrupted:
    """Ctrl-C, and failures on the way."""

    def ended_in_flight(self, folder: Path, number: signal.Signals, *options: str) -> Done:
        """A real process that was sent that signal while it flew: all is written, and the code is 130."""
        command = [sys.executable, "-c", COMPANION, "sim", "--world", "room", "--out", "flight", *options]
        with subprocess.Popen(
            command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        ) as process:
            assert process.stdout is not None
            for line in process.stdout:
                if "times real time" in line:
                    process.send_signal(number)
                    break
            out, err = process.communicate(timeout=60)
        done = Done(process.returncode, out, err, folder / "flight")
        assert done.code == 130
        assert "Traceback" not in done.err
        assert done.files == FILES
        assert done.summary["ended_because"] == "stopped by the user"
        return done

    def test_ctrl_c_in_flight_keeps_what_is_mapped(self, tmp_path: Path) -> None:
        """Protects an hour of flight: SIGINT to a real process ends with 130, and all files are whole, report too."""
        (tmp_path / "quick.yaml").write_text(QUICK, encoding="utf-8")
        done = self.ended_in_flight(tmp_path, signal.SIGINT, "--config", "quick.yaml", "--time-limit", "3000")
        assert left_in(tmp_path) == {"flight"}
        report = (done.folder / "report.html").read_text(encoding="utf-8").strip()
        assert report.lower().startswith("<!doctype html>")
        assert report.lower().endswith("</html>")
        assert "room, seed 1" in report
        png = (done.folder / "overview.png").read_bytes()
        assert png.startswith(b"\x89PNG")
        assert b"IEND" in png[-12:]

    @pytest.mark.parametrize("moment", ["load_world", "Simulation", "write_run"])
    def test_ctrl_c_before_and_after_leaves_nothing(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, moment: str
    ) -> None:
        """Protects from an empty folder: interrupted before anything is written, it ends with 130 and there is none."""

        def interrupted(*_arguments: object, **_named: object) -> None:
            raise KeyboardInterrupt

        monkeypatch.setattr(sim, moment, interrupted)
        done = fly(tmp_path, "--world", "room", "--time-limit", "0.1")
        assert done.code == 130
        assert "Traceback" not in done.err
        assert left_in(tmp_path) == set()

    @pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
    def test_a_supervisor_and_a_closed_terminal_are_ctrl_c(self, tmp_path: Path, number: signal.Signals) -> None:
        """Protects an hour of flight from a computer that shuts down: the map is written, and the code is 130."""
        self.ended_in_flight(tmp_path, number)

    def test_who_interrupts_twice_at_once_loses_nothing(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
    ) -> None:
        """Protects an hour of flight from a key that is held down: there is no moment between flight and writing."""
        tick, complete = Simulation._tick, Simulation._exact_completeness

        def asked(self: Simulation, dt_s: float) -> None:
            tick(self, dt_s)
            if self.t_s > 1.0:
                os.kill(os.getpid(), signal.SIGINT)

        def asked_again(self: Simulation) -> float:
            os.kill(os.getpid(), signal.SIGINT)
            return complete(self)

        monkeypatch.setattr(Simulation, "_tick", asked)
        monkeypatch.setattr(Simulation, "_exact_completeness", asked_again)
        done = fly(tmp_path, "--world", "room", "--time-limit", "60")
        assert done.code == 130
        assert done.files == FILES
        assert done.summary["ended_because"] == "stopped by the user"
        assert "ending the flight: a moment" in capfd.readouterr().err

    def test_who_kills_it_in_flight_finds_what_was_flown(self, tmp_path: Path) -> None:
        """Protects an hour of flight from SIGKILL, which no program can answer: rows and map are on the disk."""
        (tmp_path / "quick.yaml").write_text(QUICK, encoding="utf-8")
        words = ["sim", "--world", "room", "--config", "quick.yaml", "--out", "flight", "--time-limit", "30000"]
        endless = "from sitl.sim import simulation\nsimulation.COMPLETE_SHARE = 2.0\n" + COMPANION
        with subprocess.Popen(
            [sys.executable, "-c", endless, *words], cwd=tmp_path, stdout=subprocess.DEVNULL
        ) as process:
            while process.poll() is None and not list(tmp_path.glob("flight.unfinished-*/map.journal/*.segment")):
                time.sleep(0.01)
            time.sleep(0.2)
            process.kill()
        (left,) = tmp_path.glob("flight*")
        assert left.name.startswith("flight.unfinished-")
        assert {path.name for path in left.iterdir()} == {"trajectory.csv", "map.journal"}
        rows = (left / "trajectory.csv").read_text(encoding="utf-8").splitlines()
        assert len(rows) > 20
        assert {row.count(",") for row in rows} == {len(COLUMNS)}
        assert facts_of(open_map(left / "map.journal")).occupied > 0

    def test_nobody_who_reads_is_no_reason_to_lose_a_mission(self, tmp_path: Path) -> None:
        """Protects an hour of flight from `| head -1`, and from a log on a full disk."""
        (tmp_path / "quick.yaml").write_text(QUICK + "sim: {time_limit_s: 1.0}\n", encoding="utf-8")
        with open("/dev/full", "wb") as full:  # noqa: PTH123 - as a shell redirects
            done = subprocess.run(
                [sys.executable, "-c", COMPANION, "sim", "--out", "flight", "--config", "quick.yaml"],
                cwd=tmp_path,
                stdout=full,
                stderr=subprocess.PIPE,
                text=True,
                check=False,
            )
        assert done.returncode == 1
        assert done.stderr.startswith("standard output: No space left on device")
        assert "Traceback" not in done.stderr
        assert {path.name for path in (tmp_path / "flight").iterdir()} == FILES


class TestWhatCannotBeWritten:
    """Results are never thrown away: each file by itself."""

    @pytest.mark.parametrize("moment", ["overview_png", "write_report", "write_map_file"])
    def test_a_mistake_of_ours_keeps_what_was_written_before(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, moment: str
    ) -> None:
        """Protects the flight from a bug in a picture: its traceback stays, and the summary names what is missing."""

        def broken(*_arguments: object, **_named: object) -> None:
            raise ZeroDivisionError

        monkeypatch.setattr(run_folder, moment, broken)
        with pytest.raises(ZeroDivisionError):
            fly(tmp_path, "--world", "room", "--time-limit", "0.1")
        there = left_in(tmp_path / "flight")
        assert {"map.journal", "trajectory.csv", "settings.yaml", "summary.json"} <= there
        unwritten = json.loads((tmp_path / "flight" / "summary.json").read_text(encoding="utf-8"))["unwritten"]
        assert there | set(unwritten) == FILES
        assert set(unwritten.values()) == {"ZeroDivisionError()"}

    @pytest.mark.parametrize("error", [OSError(28, "No space left on device"), MapFileError("too far away for it")])
    def test_a_file_that_cannot_be_written_costs_that_file_alone(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception
    ) -> None:
        """Protects from a format that cannot hold the mine, and from a full disk: named in one line, all else there."""

        def refused(source: MapSource, path: Path, georeference: Georeference | None = None) -> None:
            if path.suffix == ".laz":
                path.write_bytes(b"half")
                raise error
            write(source, path, georeference=georeference)

        monkeypatch.setattr(run_folder, "write_map_file", refused)
        done = fly(tmp_path, "--world", "room", "--time-limit", "0.1")
        assert done.code == 1
        assert "map.laz" in done.err
        assert str(error) in done.err
        assert "Traceback" not in done.err
        assert done.files == FILES - {"map.laz"}
        assert done.summary["unwritten"] == {"map.laz": str(error)}

    def test_a_flight_that_fails_is_written(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        """Protects an hour of flight from a mistake of ours in its last minute."""
        tick = Simulation._tick

        def fails(self: Simulation, dt_s: float) -> None:
            if self.t_s > 1.0:
                raise ZeroDivisionError
            tick(self, dt_s)

        monkeypatch.setattr(Simulation, "_tick", fails)
        with pytest.raises(ZeroDivisionError):
            fly(tmp_path, "--world", "room", "--time-limit", "5")
        assert left_in(tmp_path / "flight") == FILES
        summary = json.loads((tmp_path / "flight" / "summary.json").read_text(encoding="utf-8"))
        assert "ZeroDivisionError" in summary["ended_because"]
        assert summary["sim_time_s"] == pytest.approx(1.05, abs=0.1)

    def test_who_interrupts_while_it_writes_is_told_to_wait_and_the_next_time_it_ends(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
    ) -> None:
        """Protects the map from impatience, and the impatient from a hanging disk."""
        asked = 0

        def interrupted(path: Path, *_: object) -> None:
            nonlocal asked
            path.touch()
            asked += 1
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0.01)

        monkeypatch.setattr(run_folder, "write_map_file", lambda _, path, **_named: interrupted(path))
        done = fly(tmp_path, "--world", "room", "--time-limit", "0.1")
        assert (done.code, asked) == (130, 2)
        assert capfd.readouterr().err.count("a moment; interrupt once more") == 1
        assert {"map.journal", "trajectory.csv", "settings.yaml", "summary.json"} <= done.files
        unwritten = done.summary["unwritten"]
        assert isinstance(unwritten, dict)
        assert set(unwritten) >= {"map.bt", "report.html", "overview.png"}
        assert not done.files & set(unwritten), "half a file is taken for a whole one"
        assert "what had been written is in" in done.err


@pytest.mark.usefixtures("short_report")
def test_a_mission_goes_on_from_an_earlier_one(tmp_path: Path) -> None:
    """Map, known ground and start are those of the first; the last line of each says how to go on."""
    first = fly(tmp_path, "--world", "room", "--seed", "3", "--time-limit", "3")
    last = first.out.strip().splitlines()[-1]
    assert re.fullmatch(r"\d+ places? left to explore: fly again with --resume .*flight", last)
    again = ("--world", "room", "--resume", str(first.folder))
    folder = tmp_path / "second"
    second = fly(tmp_path, *again, "--time-limit", "1", "--out", str(folder))
    assert beginning(folder) == beginning(first.folder), "whatever the seed"
    for how_much in (completeness, ground_free_m2, chunks_of_map):
        assert how_much(folder) >= how_much(first.folder) > 0.0
    assert second.out.strip().splitlines()[-1].endswith(f"fly again with --resume {folder}")


def beginning(folder: Path) -> list[str]:
    """Where the vehicle of a mission began."""
    return (folder / "trajectory.csv").read_text("utf-8").splitlines()[1].split(",")[2:6]


def completeness(folder: Path) -> float:
    return float(json.loads((folder / "summary.json").read_text("utf-8"))["completeness"])


def ground_free_m2(folder: Path) -> float:
    return read_known_ground(folder / "known_ground.npz").free_m2


def chunks_of_map(folder: Path) -> int:
    return facts_of(open_map(folder / "map.journal")).chunks


@pytest.mark.usefixtures("short_report")
def test_what_a_mission_cannot_go_on_from_is_refused(tmp_path: Path) -> None:
    """Before it flies, with what is wrong: another mine, another kind of map, a folder that is none or is damaged."""
    first = fly(tmp_path, "--world", "room", "--time-limit", "1").folder
    fine = tmp_path / "fine.yaml"
    fine.write_text("mapping: {voxel_m: 0.2}\n", encoding="utf-8")

    def refused(*arguments: str, world: str = "room", folder: Path = first) -> str:
        out = tmp_path / "second"
        done = fly(tmp_path, "--world", world, "--resume", str(folder), *arguments, "--out", str(out))
        assert done.code == 2
        assert not out.exists()
        return done.err

    assert "flown in room, not in slope" in refused(world="slope")
    assert "leave out --vehicles" in refused("--vehicles", "2")
    assert "voxel_m is 0.2, not 0.3 (mapping)" in refused("--config", str(fine))
    assert "summary.json: No such file" in refused(folder=tmp_path / "nowhere")
    (first / "known_ground.npz").write_bytes(ground_content(KnownGround(cell_m=0.3).seen()))
    assert "its cells are 0.3 m wide" in refused()
    (first / "trajectory.csv").write_text("t_s\r\n")
    assert "trajectory.csv is damaged" in refused()
