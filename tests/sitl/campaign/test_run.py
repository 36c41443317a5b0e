"""Missions flown by processes: none is lost, none is flown twice, and what dies is noticed."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import pytest

from companion.interruption import ENDS
from sitl.campaign.flight import fly as fly_really
from sitl.campaign.folder import claimed
from sitl.campaign.mission import Mission, Row, Site
from sitl.campaign.run import run
from sitl.campaign.workers import LocalWorkers
from tests.sitl.campaign import missions
from tests.sitl.campaign.missions import campaign, mission

ROOT = Path(__file__).parents[3]
FLY_A_CAMPAIGN = """
import sys
from pathlib import Path
from sitl.campaign.folder import claimed
from sitl.campaign.run import run
from sitl.campaign.workers import LocalWorkers
from tests.sitl.campaign import missions

if __name__ == "__main__":
    place, count = Path(sys.argv[1]), int(sys.argv[2])
    campaign = missions.campaign(count, str(place / "notes"))
    with claimed(place / "flown", campaign) as ledger, LocalWorkers(2) as workers:
        left = [mission for mission in campaign.missions if mission.number not in ledger.rows]
        run(left, workers, missions.slow, ledger.append)
"""


def waited_for(happened: Callable[[], bool], limit_s: float = 60.0) -> None:
    until_s = time.monotonic() + limit_s
    while not happened():
        assert time.monotonic() < until_s
        time.sleep(0.02)


def alive(process: int) -> bool:
    """Whether a process does something: one that has ended and that nobody has asked about does not."""
    try:
        return Path(f"/proc/{process}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def row_of(flown: Mission) -> Row:
    """The row of a mission that `missions.once` flies."""
    return {**flown.given(), **missions.once(flown), "settings": flown.settings_json}


def test_rows_depend_neither_on_workers_nor_on_order(tmp_path: Path) -> None:
    """Protects every comparison, and the last seconds: how many fly, and which of them is first, changes no row.

    Signals of the terminal, which go to the whole group, do not reach workers: the command alone decides.
    """
    asked = [mission(number, str(tmp_path)) for number in range(6)]
    rows: list[Row] = []
    with LocalWorkers(2) as workers:
        run(asked, workers, missions.uneven, rows.append)
        blocked = workers.submit(missions.blocked_signals, mission(0)).result()
    assert rows[0]["mission"] != 0
    assert sorted(rows, key=lambda row: int(str(row["mission"]))) == [row_of(one) for one in asked]
    assert blocked["signals"] == sorted(ENDS)


def test_what_goes_wrong_with_a_mission_leaves_the_others_alone(tmp_path: Path) -> None:
    """Protects a night's campaign from one bad mission: it is a row with its error, and all others are flown once.

    Where its process died, it is tried a second time.
    """
    asked = [mission(number, str(tmp_path / "notes")) for number in range(6)]
    rows: list[Row] = []
    with LocalWorkers(2) as workers:
        run(asked, workers, missions.bad, rows.append)
    found = {int(str(row["mission"])): row for row in rows}
    assert len(rows) == len(found) == 6
    assert {number: row["ended_because"] for number, row in found.items() if row["ended_because"] != "complete"} == {
        1: "failed",
        3: "failed",
    }
    assert (found[1]["seed"], found[1]["error"]) == (2, "ZeroDivisionError: of number 1")
    assert "missions.py" in str(found[1]["error_details"])
    assert "died, 2 times" in str(found[3]["error"])
    times = Counter((tmp_path / "notes").read_text(encoding="utf-8").split())
    assert times == {"0": 1, "1": 1, "2": 2, "3": 2, "4": 1, "5": 1}


def test_a_campaign_that_is_killed_goes_on(tmp_path: Path) -> None:
    """Protects a night of flying from a power cut: what had ended is not flown again, and nothing is missing.

    SIGKILL to the command ends its workers too, in the middle of a mission.
    """
    script, ledger, notes = tmp_path / "fly.py", tmp_path / "flown" / "missions.jsonl", tmp_path / "notes"
    script.write_text(FLY_A_CAMPAIGN, encoding="utf-8")
    count, quick = 10, 8
    command = [sys.executable, str(script), str(tmp_path), str(count)]
    with subprocess.Popen(command, cwd=ROOT, env=os.environ | {"PYTHONPATH": str(ROOT)}) as process:
        waited_for(lambda: ledger.exists() and ledger.read_bytes().count(b"\n") == quick)
        waited_for(lambda: notes.read_text(encoding="utf-8").count("\n") == count)
        workers = {int(line.partition(",")[2]) for line in notes.read_text(encoding="utf-8").split()}
        assert len(workers) == 2
        assert all(map(alive, workers))
        process.kill()
        process.wait()
    waited_for(lambda: not any(map(alive, workers)), limit_s=20.0)
    with ledger.open("ab") as file:
        file.write(b'{"mission": 8, "ended_beca')  # the one that it was about to write

    asked = campaign(count, str(notes))
    with claimed(tmp_path / "flown", asked) as there, LocalWorkers(1) as again:
        assert set(there.rows) == set(range(quick))
        left = [one for one in asked.missions if one.number not in there.rows]
        run(left, again, missions.once, there.append)
    with claimed(tmp_path / "flown", asked) as there:
        assert there.rows == {one.number: row_of(one) for one in asked.missions}


def test_a_real_mission_leaves_its_figures_and_a_bad_one_its_error() -> None:
    """Protects the row: every figure of the summary, how fast it flew, and of an error where it happened."""
    short = Mission(0, "room", Site(), 4, "flight", "", {}, missions.SETTINGS_JSON, 1, 0.5)
    row = fly_really(short)
    assert (row["world"], row["seed"], row["ended_because"], row["contacts"]) == ("room", 4, "time limit", 0)
    assert {"estimated_completeness", "done_at_s", "completeness_when_done", "left_out"} <= row.keys()
    estimated, true = float(str(row["estimated_completeness"])), float(str(row["completeness"]))
    assert row["estimate_error"] == pytest.approx(estimated - true, abs=2e-5)
    assert {"least_d_m", "speed_mps", "slow_share", "in_d_c_share", "path_length_m", "versions"} <= row.keys()
    again = fly_really(short)
    timing = ("wall_time_s", "times_real_time")
    assert {name: again[name] for name in row if name not in timing} == {
        name: row[name] for name in row if name not in timing
    }
    in_rock = Mission(0, "room", Site((-5.0, 0.0, 1.5, 0.0)), 4, "flight", "", {}, missions.SETTINGS_JSON, 1, 0.5)
    failed = fly_really(in_rock)
    assert failed["ended_because"] == "failed"
    assert str(failed["error"]).startswith("InputError: ")
    assert "Traceback" in str(failed["error_details"])
