"""`companion safety`: the tables, the exit codes, and that the safety case shows what the command prints."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from companion.cli import main as cli
from companion.config.load import load_settings
from companion.gate.faults import Fault, Stage
from companion.text_table import WIDTH

ROOT = Path(__file__).parents[2]
SAFETY_CASE = ROOT / "docs" / "safety.md"

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    """Runs `companion safety ...` and gives its exit code, stdout and stderr."""

    def run_command(*arguments: str) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as ended:
            cli.main(["safety", *arguments])
        printed = capsys.readouterr()
        return int(ended.value.code or 0), printed.out, printed.err

    return run_command


def marked(name: str) -> str:
    """What stands between the markers of that name in the safety case."""
    text = SAFETY_CASE.read_text(encoding="utf-8")
    return text.partition(f"<!-- {name}:begin -->")[2].partition(f"<!-- {name}:end -->")[0]


def test_budget_of_the_default(run: Run) -> None:
    code, printed, errors = run("budget")
    assert (code, errors) == (0, "")
    assert max(map(len, printed.splitlines())) <= WIDTH
    for name in (*Fault, "gate killed", "computer dead", "link cut"):
        assert (f"\n{name} " in printed) == (name is not Fault.NOT_OBEYED), "nothing bounds who does not obey"
    assert "A vehicle that does not obey is bounded by nothing." in " ".join(printed.split())
    assert "no wall can be reached" in printed
    assert "d_s = 1 m, d_c = 0.8 m" in printed


def test_budget_of_one_in_which_a_wall_can_be_reached(run: Run) -> None:
    """The table is printed all the same: it shows how much is missing."""
    code, printed, errors = run("budget", "--preset", "table_i")
    assert code == 2
    assert "A WALL CAN BE REACHED: setpoint_late" in printed
    assert errors.startswith("a wall can be reached:\n- setpoint_late: ")


def test_budget_for_programs(run: Run) -> None:
    code, printed, _ = run("budget", "--json")
    lines = {line["fault"]: line for line in json.loads(printed)}
    assert code == 0
    assert len(lines) == len(set(Fault) - {Fault.NOT_OBEYED}) + 3
    assert lines["depth_stale"]["remaining_m"] == pytest.approx(0.112, abs=1e-3)
    assert lines["depth_stale"]["reaches_wall"] is False


def test_budget_of_a_file(run: Run, tmp_path: Path) -> None:
    file = tmp_path / "vehicle.yaml"
    file.write_text("safety: {reactions: {map: {first: land}}}\n", encoding="utf-8")
    assert "only told" in run("budget")[1]
    assert "only told" not in run("budget", "--config", str(file))[1]


def test_faults(run: Run) -> None:
    """Thresholds that the file leaves out are shown as the numbers that hold."""
    code, printed, _ = run("faults")
    assert code == 0
    rows = {line.split()[0]: line for line in printed.splitlines() if line}
    assert {fault.value for fault in Fault} <= set(rows)
    assert " 0.12 s " in rows["setpoint_late"]
    assert " 0.575 m " in rows["distance"]
    assert " never " in rows["ground_stop"]


def test_example_is_a_file_that_can_be_flown(run: Run, tmp_path: Path) -> None:
    code, printed, _ = run("example")
    assert code == 0
    file = tmp_path / "vehicle.yaml"
    file.write_text(printed, encoding="utf-8")
    assert load_settings(file).safety.fence.radius_m == 250.0
    assert run("budget", "--config", str(file))[0] == 0


def test_example_of_a_vehicle_can_be_flown(run: Run) -> None:
    assert run("budget", "--config", str(ROOT / "docker" / "vehicle.example.yaml"))[0] == 0


@pytest.mark.parametrize("name", ["budget", "faults"])
def test_the_safety_case_shows_what_the_command_prints(run: Run, name: str) -> None:
    """A table in the documents that is not the program's is a lie about safety."""
    assert marked(name) == f"\n```\n{run(name)[1]}```\n", f"docs/safety.md: put `companion safety {name}` in"


def test_the_safety_case_has_a_place_for_the_matrix_and_names_every_fault() -> None:
    text = SAFETY_CASE.read_text(encoding="utf-8")
    assert "<!-- matrix:begin -->" in text
    assert "<!-- matrix:end -->" in text
    for fault in Fault:
        assert f"| `{fault}` |" in text


def test_every_row_of_the_budget_can_be_added_up(run: Run) -> None:
    """Protects the reader's check: speed, three times, brake and creep on paper give the distance that is shown."""
    rows = 0
    for line in run("budget", "--preset", "table_i")[1].splitlines():
        cells = line.split()
        numbers = [float(cell) for cell in cells if cell.lstrip("-").replace(".", "", 1).isdigit()]
        if len(numbers) < 10:
            continue
        speed, detection, reaction, autopilot, brake, creep, begun, distance, stands, _left = numbers
        assert speed * (detection + reaction + autopilot) + speed**2 / (2.0 * brake) + creep == pytest.approx(
            distance, abs=0.02
        )
        assert begun - distance == pytest.approx(stands, abs=0.011)
        rows += 1
    assert rows == len(set(Fault) - {Fault.NOT_OBEYED, Fault.MAP}) + 3


def test_every_text_of_the_gate_is_in_the_safety_case() -> None:
    """Protects the pilot, who reads a text once and has to know what to do: each has a row that says so."""
    rows = [line for line in SAFETY_CASE.read_text(encoding="utf-8").splitlines() if line.startswith("| `gate: ")]
    assert all(len(row.strip("|").split("|")) == 3 for row in rows)
    told = {re.sub(r"[^a-z_].*", "", row.removeprefix("| `gate: ")) for row in rows}
    stages = {stage.name.lower() for stage in Stage}
    assert told == {*Fault, *stages, "hands", "setpoint"}
    fault_words = {row.removeprefix("| `gate: ").split("`")[0] for row in rows}
    assert {"hands off: mode position", "hands off: autopilot's failsafe hold"} <= fault_words
    rejected = next(row for row in rows if "setpoint rejected" in row)
    for asked in ("speed", "climb", "yaw", "jumps by", "not finite", "in frame", "with type mask", "for 7/1"):
        assert f"`{asked}" in rejected
    for asked in ("in phase", "path not observed", "leaves the geofence"):
        assert f"`{asked}" in rejected
    battery = next(row for row in rows if "gate: battery" in row)
    assert all(words in battery for words in ("14 %", "10.20 V", "`critical, says the autopilot`", "`low, says"))
