"""What tells a computer that stood still from a gate that did."""

from __future__ import annotations

import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from companion.config.settings import Settings
from validation.fault_matrix import run
from validation.fault_matrix.faults import BY_NAME
from validation.fault_matrix.injection import Final
from validation.fault_matrix.outcome import Outcome
from validation.fault_matrix.run import ATTEMPTS, StoodStillError, fly, patience_s, stood_still
from validation.fault_matrix.standstill import HOST, LOOK_S, NOBODY, WIRES, Standstill, Wait

GATE = 17


@pytest.fixture(autouse=True)
def processors(tmp_path: Path) -> None:
    stolen(tmp_path, 0)


def stolen(proc: Path, ticks: int) -> None:
    """The kernel says how long the second processor was given to others, in hundredths of a second."""
    lines = [f"{name} 1 2 3 4 5 6 7 {found} 9 10\n" for name, found in (("cpu", 777), ("cpu0", 50), ("cpu1", ticks))]
    (proc / "stat").write_text("".join([*lines, "intr 17 4 2 9 8 7 6 5 4 3 2\n"]))


def told(proc: Path, thread: int, waited_s: float, of: int = GATE) -> None:
    """The kernel says how long a thread has waited for a processor since it began."""
    folder = proc / str(of) / "task" / str(thread)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "schedstat").write_text(f"123456789 {round(waited_s * 1e9)} 42\n")


def test_it_finds_the_longest_wait_of_any_thread(tmp_path: Path) -> None:
    """Protects the verdict on the gate: a writer of its log that is not run may hold up the thread that steers."""
    standstill = Standstill({"the gate": GATE}, tmp_path)
    told(tmp_path, 17, 5.0)
    told(tmp_path, 18, 0.0)
    standstill.look(10.0)
    assert standstill.longest(0.0, 100.0) == NOBODY, "what it waited before is no wait of this flight"
    told(tmp_path, 17, 5.1)
    standstill.look(10.02)
    told(tmp_path, 18, 0.6)
    standstill.look(10.04)
    told(tmp_path, 17, 5.3)
    standstill.look(10.06)

    longest = standstill.longest(10.0, 11.0)
    assert (longest.ended_s, longest.who) == (10.04, "the gate")
    assert longest.lasted_s == pytest.approx(0.6)
    assert standstill.longest(10.05, 11.0).lasted_s == pytest.approx(0.2)
    assert standstill.longest(10.07, 11.0) == NOBODY


def test_a_thread_that_begins_or_a_process_that_ends_is_no_standstill(tmp_path: Path) -> None:
    """Protects the flights in which a process is killed: they must be judged."""
    standstill = Standstill({"the gate": GATE, "nobody there": 18}, tmp_path)
    standstill.look(10.0)
    told(tmp_path, 17, 3.0)
    standstill.look(10.02)
    (tmp_path / str(GATE) / "task" / "17" / "schedstat").unlink()
    standstill.look(10.04)
    assert standstill.longest(0.0, 100.0) == NOBODY


def test_it_notes_when_it_was_not_run_itself(tmp_path: Path) -> None:
    """Protects against a computer that stands still as a whole, where no thread is told to have waited."""
    standstill = Standstill({}, tmp_path)
    standstill.look(10.0)
    standstill.look(10.0 + LOOK_S + 0.7)
    assert standstill.longest(0.0, 100.0).lasted_s == pytest.approx(0.7)
    assert str(standstill.longest(0.0, 100.0)) == f"{WIRES} for 0.70 s"


def test_it_notes_a_processor_that_the_host_has_taken_away(tmp_path: Path) -> None:
    """Protects against a virtual machine that is held up: the gate ran by the clock of the kernel, and did not."""
    standstill = Standstill({}, tmp_path)
    standstill.look(10.0)
    stolen(tmp_path, 60)
    standstill.look(10.02)
    assert standstill.longest(0.0, 100.0) == Wait(10.02, 0.6, HOST)

    for look in range(1, 40):
        stolen(tmp_path, 60 + 2 * (look // 2))
        standstill.look(10.1 + LOOK_S * look)
    in_pieces = standstill.longest(10.7, 11.0)
    assert in_pieces.who == HOST
    assert in_pieces.lasted_s == pytest.approx(0.25, abs=0.03), "half of the time, in any half second"


def test_it_reads_what_the_kernel_really_tells() -> None:
    """Protects against a file of another form: then no wait would ever be found."""
    columns = Path("/proc/self/schedstat").read_text(encoding="ascii").split()
    assert len(columns) == 3
    assert all(column.isdecimal() for column in columns)
    with Standstill({}) as standstill:
        time.sleep(3.0 * LOOK_S)
    assert standstill._looked_s is not None


def flight(*waits: Wait) -> Any:
    standstill = Standstill({})
    standstill._waits.extend(waits)
    return SimpleNamespace(settings=Settings(), standstill=standstill)


def test_a_flight_is_not_judged_when_the_computer_stood_still_for_longer_than_the_autopilot_waits() -> None:
    """Protects both verdicts: a failsafe that the computer caused is no fault of the gate, and any other one is."""
    limit_s = patience_s(Settings())
    assert 0.3 < limit_s < Settings().autopilot.silence_s

    assert stood_still(flight(Wait(5.0, limit_s, "the gate")), 4.0, 6.0) == limit_s, "the gate should have coped"
    assert stood_still(flight(Wait(3.9, 1.0, "the gate")), 4.0, 6.0) == 0.0, "before the fault"
    with pytest.raises(StoodStillError, match=r"the autopilot for 0\.60 s"):
        stood_still(flight(Wait(5.0, 0.6, "the autopilot")), 4.0, 6.0)


def outcome(attempts: int = 1) -> Outcome:
    fault = BY_NAME["SIGKILL application"]
    return Outcome(
        fault.name, fault.group, "px4", 0.4, 1.4, 0.0, 0.2, 1.2, 0, Final.HELD, ("brake",), None, attempts=attempts
    )


def test_it_flies_again_and_not_for_ever(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Protects the promise that nothing unjudged passes: the last attempt that shows nothing is an error."""
    flown: list[Path] = []

    def second_time_lucky(_injection: object, _personality: str, folder: Path) -> Outcome:
        flown.append(folder)
        if len(flown) < 2:
            raise StoodStillError("the gate for 0.60 s")
        return outcome()

    monkeypatch.setattr(run, "_fly", second_time_lucky)
    assert fly("SIGKILL application", "px4", tmp_path) == outcome(attempts=2)
    assert len(flown) == 2

    def never(*_: object) -> Outcome:
        flown.append(tmp_path)
        raise StoodStillError("the gate for 0.60 s")

    flown.clear()
    monkeypatch.setattr(run, "_fly", never)
    with pytest.raises(StoodStillError):
        fly("SIGKILL application", "px4", tmp_path)
    assert len(flown) == ATTEMPTS
