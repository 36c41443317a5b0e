"""The command `companion montecarlo`: what it writes, how it ends, and that it goes on where it was left."""

from __future__ import annotations

import contextlib
import io
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import psutil
import pytest
from pyarrow import parquet

from companion.cli.main import main
from sitl.campaign import ledger
from sitl.campaign.mission import Mission, Row
from sitl.cli import montecarlo
from tests.sitl.campaign import missions

ROOT = Path(__file__).parents[3]
FILES = {"campaign.json", "missions.jsonl", "missions.parquet", "report.html", "again"}
TIMING = ("wall_time_s", "times_real_time")
COMPANION = """
import signal
signal.signal(signal.SIGINT, signal.default_int_handler)  # a job in the background is started with SIGINT ignored
from companion.cli.start import main
if __name__ == "__main__":
    main()
"""


@dataclass(frozen=True)
class Done:
    """One command that has ended."""

    code: int
    out: str
    err: str
    folder: Path

    @property
    def rows(self) -> list[Row]:
        """The table."""
        rows: list[Row] = parquet.read_table(self.folder / "missions.parquet").to_pylist()
        return rows

    @property
    def files(self) -> set[str]:
        """Everything in the folder, hidden files too."""
        return {path.name for path in self.folder.iterdir()}


@pytest.fixture
def flown(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Missions fly in no time, in this process; their numbers as they do."""
    numbers: list[int] = []

    def once(mission: Mission) -> Row:
        numbers.append(mission.number)
        return missions.once(mission)

    monkeypatch.setattr("sitl.report.style.DPI", 40)
    monkeypatch.setattr(montecarlo, "LocalWorkers", missions.Here)
    monkeypatch.setattr(montecarlo, "fly", once)
    return numbers


def fly(place: Path, *arguments: str) -> Done:
    """Runs `companion montecarlo` in this process, in the folder ``place``/flown."""
    out, err = io.StringIO(), io.StringIO()
    folder = place / "flown"
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), pytest.raises(SystemExit) as ended:
        main(["montecarlo", "--worlds", "room", "--out", str(folder), *arguments])
    return Done(int(ended.value.code or 0), out.getvalue(), err.getvalue(), folder)


def test_a_campaign_leaves_a_table_and_a_report(tmp_path: Path, flown: list[int]) -> None:
    """Protects the promise of the command: one row a mission with its settings, and code 0 when all are complete."""
    done = fly(tmp_path, "--seeds", "5..7", "--set", "control.choice=coin,informed", "--time-limit", "60")
    assert (done.code, done.err) == (0, "")
    assert done.files == FILES
    assert [(row["mission"], row["seed"], row["control.choice"]) for row in done.rows] == [
        (number, 5 + number // 2, ("coin", "informed")[number % 2]) for number in range(6)
    ]
    assert {json.loads(str(row["settings"]))["control"]["choice"] for row in done.rows} == {"coin", "informed"}
    assert "6 of 6 missions: 6 complete, 0 with a contact, 0 failed" in done.out
    assert f"look at: {done.folder / 'report.html'}" in done.out
    assert flown == list(range(6))


def test_the_same_command_flies_only_what_is_missing(
    tmp_path: Path, flown: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Protects what was flown: after Ctrl-C table and report hold it, the code is 130, and the next command goes on."""

    def interrupted(mission: Mission) -> Row:
        if mission.number == 2:
            raise KeyboardInterrupt
        return missions.once(mission)

    with monkeypatch.context() as patch:
        patch.setattr(montecarlo, "fly", interrupted)
        done = fly(tmp_path, "--seeds", "4")
    assert done.code == 130
    assert "Traceback" not in done.err
    assert "to go on: " in done.err
    assert done.files == FILES
    assert [row["mission"] for row in done.rows] == [0, 1]
    before = {row["mission"]: row for row in done.rows}

    done = fly(tmp_path, "--seeds", "4")
    assert done.code == 0
    assert flown == [2, 3]
    assert [row["mission"] for row in done.rows] == [0, 1, 2, 3]
    assert {number: done.rows[int(str(number))] for number in before} == before

    assert fly(tmp_path, "--seeds", "4").code == 0
    assert flown == [2, 3]


def test_tours_are_planned_once_and_joined_to_the_rows(
    tmp_path: Path, flown: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Protects ratios: a tour that is in the folder is not planned again, and one that failed is, when asked."""
    planned: list[int] = []

    def tour(mission: Mission) -> Row:
        planned.append(mission.number)
        if len(planned) == 1:
            raise ValueError("no room")
        return {"ended_because": "planned", "tour_time_s": 5.0, "tour_length_m": 2.0, "tour_share": 0.99}

    monkeypatch.setattr("sitl.campaign.tours.plan_tour", tour)
    done = fly(tmp_path, "--seeds", "2", "--tours")
    assert (done.code, done.files) == (0, FILES | {"tours.jsonl"})
    assert "no tour of room: ValueError: no room" in done.err
    assert [row["time_ratio"] for row in done.rows] == [None, None]
    for _ in range(2):
        done = fly(tmp_path, "--seeds", "2", "--tours", "--retry-failed")
        assert done.err == ""
        assert [(row["time_ratio"], row["way_ratio"]) for row in done.rows] == [(2.0, 2.0), (4.0, 4.0)]
    assert (planned, flown) == ([0, 0], [0, 1])


def test_another_campaign_in_the_folder_is_refused(tmp_path: Path, flown: list[int]) -> None:
    """Protects the rows that are there; the message names what differs."""
    fly(tmp_path, "--seeds", "2")
    done = fly(tmp_path, "--seeds", "3", "--time-limit", "9")
    assert done.code == 2
    assert 'seeds: there "1..2", here "1..3"' in done.err
    assert "time_limit_s: there null, here 9.0" in done.err
    assert len(done.rows) == 2
    assert flown == [0, 1]


def test_failed_missions_are_flown_again_when_asked(
    tmp_path: Path, flown: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Protects from a full disk in the night: a failure stays one, until --retry-failed flies it anew."""
    with monkeypatch.context() as patch:
        patch.setattr(montecarlo, "fly", missions.raises)
        done = fly(tmp_path, "--seeds", "3")
    assert done.code == 1
    assert done.err == "1 of 3 missions did not end with a complete map: 1 failed\n"
    assert done.rows[1]["error"] == "ZeroDivisionError: of number 1"
    assert fly(tmp_path, "--seeds", "3").code == 1
    assert flown == []
    done = fly(tmp_path, "--seeds", "3", "--retry-failed")
    assert (done.code, flown) == (0, [1])
    assert {row["ended_because"] for row in done.rows} == {"complete"}


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--worlds", "rom"), "--worlds: world rom"),
        (("--seeds", "0"), "--seeds: 0 seeds"),
        (("--seeds", "x"), '--seeds: "x" is no seed'),
        (("--set", "control.margin_m=0.1"), "--set control.margin_m: out of range: value 0.1, bound >= 0.3"),
        (("--set", "control.margin_m"), '--set "control.margin_m": expected KEY=VALUE'),
        (("--set", "control.margin_m=1", "--set", "control.margin_m=1.2"), "--set control.margin_m: given twice"),
        (("--set", "control.margin_m=!x 1"), "--set control.margin_m:1: value: tags such as"),
        (("--set", "control.margin_m={1"), "--set control.margin_m:1: not valid YAML"),
        (("--set", "control.choice=[coin, dice]"), '--set control.choice: not usable: value "dice"'),
        (("--draw", "control.margin_m=1"), "--draw control.margin_m: [1] cannot be drawn from"),
        (("--time-limit", "0"), "--time-limit: 0.0: must be a time above 0"),
        (("--vehicles", "9"), "--vehicles 9: fleet.largest_group = 3"),
        (("--preset", "fligt"), "--preset: no preset is called"),
        (("--config", "none.yaml"), "none.yaml: no such file"),
        (("none.yaml",), "none.yaml: no such file"),
        (("--jobs", "2", "--scheduler", "tcp://127.0.0.1:1"), "--jobs with --scheduler"),
        (("--scheduler", "here"), "--scheduler here: no scheduler answers there"),
        (("--jobs", "0"), "--jobs"),
        (("--tours", "--vehicles", "2"), "--tours: a tour is one vehicle's, and --vehicles 2 fly here"),
    ],
)
@pytest.mark.usefixtures("flown")
def test_wrong_input_is_one_message_and_leaves_nothing(tmp_path: Path, arguments: tuple[str, ...], said: str) -> None:
    """Protects from a campaign of something else: code 2, and no folder."""
    done = fly(tmp_path, *arguments)
    assert done.code == 2
    assert said in done.err
    assert "Traceback" not in done.err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("flown")
def test_a_full_disk_ends_it_with_one_message(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects what was flown before: code 1, and it is there."""
    append = ledger.Ledger.append

    def full(self: ledger.Ledger, row: Row) -> None:
        if row["mission"] == 2:
            raise ledger.LedgerError("missions.jsonl: No space left on device; make room")
        append(self, row)

    monkeypatch.setattr(ledger.Ledger, "append", full)
    done = fly(tmp_path, "--seeds", "4")
    assert done.code == 1
    assert "No space left on device" in done.err
    assert [row["mission"] for row in done.rows] == [0, 1]


def in_session(leader: int) -> list[int]:
    """Processes that do something in the session that a process began."""
    found = []
    for process in psutil.process_iter():
        with contextlib.suppress(OSError, psutil.Error):
            if os.getsid(process.pid) == leader and process.status() != psutil.STATUS_ZOMBIE:
                found.append(process.pid)
    return found


def figures(rows: list[Row]) -> list[Row]:
    return [{name: value for name, value in row.items() if name not in TIMING} for row in rows]


@pytest.mark.long
@pytest.mark.timeout(300)
def test_ctrl_c_to_real_workers_and_a_cluster_leave_the_same_rows(tmp_path: Path) -> None:
    """Protects campaigns on clusters: a scheduler and two workers as processes fly the same rows as workers here do.

    On the way the local command is interrupted, by a signal to its whole group as a terminal sends it: its workers end.
    """
    options = ("--seeds", "6", "--time-limit", "5", "--set", "sensors.camera.width_px=64",
               "--set", "sensors.camera.height_px=48")  # fmt: skip
    command = [sys.executable, "-c", COMPANION, "montecarlo", "--worlds", "room", "--jobs", "2", *options]
    lines = tmp_path / "flown" / "missions.jsonl"
    command += ["--out", str(tmp_path / "flown")]
    with subprocess.Popen(command, cwd=ROOT, start_new_session=True, stderr=subprocess.PIPE, text=True) as process:
        until_s = time.monotonic() + 200.0
        while not (lines.exists() and lines.read_bytes().count(b"\n") >= 1):
            assert time.monotonic() < until_s
            time.sleep(0.05)
        os.killpg(process.pid, signal.SIGINT)
        _, said = process.communicate(timeout=60)
        assert process.returncode == 130, said
        assert "Traceback" not in said
        until_s = time.monotonic() + 10.0
        while in_session(process.pid):
            assert time.monotonic() < until_s
            time.sleep(0.05)
    here = fly(tmp_path, "--jobs", "1", *options)
    assert here.code == 1
    assert [row["ended_because"] for row in here.rows] == ["time limit"] * 6

    with contextlib.ExitStack() as running:
        address = running.enter_context(cluster(tmp_path))
        elsewhere = fly(tmp_path, "--out", str(tmp_path / "elsewhere"), "--scheduler", address, *options)
    assert elsewhere.code == 1, elsewhere.err
    there = parquet.read_table(tmp_path / "elsewhere" / "missions.parquet").to_pylist()
    assert figures(there) == figures(here.rows)


@contextlib.contextmanager
def cluster(place: Path) -> Iterator[str]:
    """A scheduler and two workers, by the address of the scheduler."""
    file = place / "scheduler.json"
    dask = [sys.executable, "-m", "dask"]
    with contextlib.ExitStack() as running:

        def start(*words: str) -> None:
            process = running.enter_context(
                subprocess.Popen([*dask, *words], cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            )
            running.callback(process.terminate)

        quiet = ("--no-dashboard", "--scheduler-file", str(file))
        start("scheduler", "--host", "127.0.0.1", "--port", "0", "--no-show", *quiet)
        for _ in range(2):
            start("worker", "--no-nanny", "--nthreads", "1", "--local-directory", str(place), *quiet)
        until_s = time.monotonic() + 60.0
        while not file.exists():
            assert time.monotonic() < until_s
            time.sleep(0.05)
        yield str(json.loads(file.read_text(encoding="utf-8"))["address"])
