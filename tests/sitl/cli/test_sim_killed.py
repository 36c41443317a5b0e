"""`companion sim` ended at any moment of a mission and of its writing: what can be read afterwards.

`pytest -s -m long tests/sitl/cli/test_sim_killed.py` prints the table.
"""

from __future__ import annotations

import csv
import json
import random
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import laspy
import pytest

from companion.errors import CompanionError
from companion.mapping.files import open_map
from companion.mapping.files.facts import facts_of
from tests.sitl.cli.test_sim import COMPANION, FILES, QUICK

MOMENTS = 10
"""Half of them in the flight, half while its results are written."""
SIMULATED_S = 300.0
ENDLESS = "from sitl.sim import simulation\nsimulation.COMPLETE_SHARE = 2.0\n"
"""Only the time limit ends it."""
SURE_S = 2.5
"""From then on a mission that has begun to fly has kept something: it does so every second or two."""
WRITES = "flight.unfinished-*/settings.yaml"
"""The first of its files that is not there before it has landed."""


@dataclass(frozen=True)
class Ended:
    """A mission that was ended from outside.

    Attributes:
        code: its exit code.
        took_s: from the signal to its end.
        folder: where its results are; None: there is none.
        said: on standard error.
    """

    code: int
    took_s: float
    folder: Path | None
    said: str


def command(place: Path) -> subprocess.Popen[str]:
    """A mission that flies for `SIMULATED_S`."""
    (place / "quick.yaml").write_text(QUICK, encoding="utf-8")
    words = [
        sys.executable,
        "-c",
        ENDLESS + COMPANION,
        "sim",
        "--world",
        "room",
        "--config",
        "quick.yaml",
        "--out",
        "flight",
    ]
    return subprocess.Popen(
        [*words, "--time-limit", f"{SIMULATED_S:g}"],
        cwd=place,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.fixture(scope="module")
def spans_s(tmp_path_factory: pytest.TempPathFactory) -> tuple[float, float]:
    """How long a mission flies, and how long it writes: the second of two, as the first may compile."""
    return [spans(tmp_path_factory.mktemp("undisturbed")) for _ in range(2)][1]


def spans(place: Path) -> tuple[float, float]:
    """How long an undisturbed mission flies, and how long it writes, in s."""
    process = command(place)
    flies(process)
    flies_s = written_s = time.monotonic()
    while process.poll() is None:
        if written_s == flies_s and any(place.glob(WRITES)):
            written_s = time.monotonic()
        time.sleep(0.005)
    process.communicate()
    return written_s - flies_s, time.monotonic() - written_s


def flies(process: subprocess.Popen[str]) -> None:
    """Until the mission has been prepared, and begins."""
    assert process.stdout is not None
    for line in process.stdout:
        if "times real time" in line:
            return


def ended(place: Path, number: signal.Signals, after_s: float, *, writing: bool) -> Ended:
    """The same mission, with a signal ``after_s`` after it began to fly, or to write."""
    process = command(place)
    flies(process)
    while writing and process.poll() is None and not any(place.glob(WRITES)):
        time.sleep(0.002)
    time.sleep(after_s)
    process.send_signal(number)
    began_s = time.monotonic()
    _, said = process.communicate(timeout=100)
    left = [*place.glob("flight"), *place.glob("flight.unfinished-*")]
    assert len(left) <= 1
    return Ended(process.returncode, time.monotonic() - began_s, left[0] if left else None, said)


def readable(folder: Path) -> dict[str, str]:
    """What each file that is there holds; what cannot be read is "broken"."""
    found = {}
    for path in sorted(folder.iterdir()):
        try:
            found[path.name] = _read(path)
        except (OSError, ValueError, CompanionError, laspy.LaspyException) as error:
            found[path.name] = f"broken ({type(error).__name__})"
    return found


def _read(path: Path) -> str:
    if path.name == "map.journal" or path.suffix == ".bt":
        return f"{facts_of(open_map(path)).occupied} occupied"
    if path.suffix == ".laz":
        return f"{len(laspy.read(path).points)} points"
    if path.suffix == ".csv":
        rows = list(csv.reader(path.read_text(encoding="utf-8").splitlines()))
        return f"{len(rows)} rows" if len({len(row) for row in rows}) == 1 else "half a row"
    if path.suffix == ".json":
        return f"{len(json.loads(path.read_text(encoding='utf-8')))} figures"
    return f"{path.stat().st_size} bytes"


@pytest.mark.long
@pytest.mark.timeout(900)
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGKILL])
def test_at_any_moment_what_is_there_is_whole_or_does_not_look_so(
    tmp_path: Path, number: signal.Signals, spans_s: tuple[float, float]
) -> None:
    """Protects an hour of flight from whoever ends it, and its reader from half a file that looks whole."""
    draws = random.Random(int(number))  # noqa: S311 - moments, not secrets
    for moment in range(MOMENTS):
        place = tmp_path / str(moment)
        place.mkdir()
        writing = moment >= MOMENTS // 2
        span_s = spans_s[writing]
        after_s = draws.uniform(0.0, span_s)
        done = ended(place, number, after_s, writing=writing)
        held = {} if done.folder is None else readable(done.folder)
        when = f"{'writing' if writing else 'flight':7} + {after_s:4.1f} of {span_s:4.1f} s"
        name = "nothing" if done.folder is None else done.folder.name.partition("-")[0]
        keep = ("map.journal", "trajectory.csv", "summary.json", "map.bt", "report.html")
        words = ", ".join(f"{file} {held.get(file, '-')}" for file in keep)
        how = f"exit {done.code}, {done.took_s:.1f} s, {name}, {len(held)}/{len(FILES)} files"
        print(f"{number.name:7} {when}: {how}: {words}")  # noqa: T201 - the table
        assert "Traceback" not in done.said
        if number is signal.SIGKILL:
            # Whole where it has its name; else the one file that was being written may be half.
            broken = [file for file, what in held.items() if what.startswith(("broken", "half"))]
            assert name != "flight" or (not broken and set(held) == FILES)
            assert len(broken) <= 1
            assert writing or after_s < SURE_S or {"map.journal", "trajectory.csv"} <= set(held) - set(broken)
        elif done.code != -number:  # so it ends when it has done all, and Python itself is being left
            assert done.code in (1, 130), "the time limit, or the signal"
            assert name == "flight"
            assert set(held) == FILES
            assert not [file for file, what in held.items() if what.startswith(("broken", "half"))]
