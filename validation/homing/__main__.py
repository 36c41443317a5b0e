"""Flights that come home, over MAVLink on the stub autopilot, one after the other, and a table of what came of them.

python -m validation.homing [--autopilot px4|ardupilot ...] [--no-gps] [--world NAME ...] [--count N] [--time-limit S]
    [--battery-minutes M] [--json FILE] [--keep DIR] [--list]

Without options: five flights in `room` on each of the two, that turn back after 30 s. A flight takes real time. The
exit code is 0 when every flight came home as it must, 1 when one did not.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from companion.text_table import columns
from validation.fault_matrix.injection import PERSONALITIES
from validation.fault_matrix.results import write_whole
from validation.homing.flight import Flown, Task, fly
from validation.real.program import say

WITHIN_M = 0.5
PROMISE_PERCENT = 3.0
HEAD = (
    *("autopilot", "gps", "world", "seed", "exploring ended", "way home ended", "off the start, m", "contacts"),
    *("least d, m", "way home, m", "home in, s", "battery promised/came, %", "replay", "duration, s"),
)


def problems(flown: Flown) -> list[str]:
    """What was not as it must be."""
    if flown.problem is not None:
        return [flown.problem]
    end, out = flown.end or {}, []
    if not end.get("arrived"):
        out.append(f"{flown.ended_because}; the way home: {end.get('ended_because', 'none')}")
    if flown.off_start_m is None or flown.off_start_m > WITHIN_M:
        out.append(f"landed {_text(flown.off_start_m, 2)} m off")
    if flown.contacts:
        out.append(f"{flown.contacts} contacts")
    promised, came = end.get("charge_promised_percent"), end.get("charge_came_percent")
    if promised is not None and came is not None and came < promised - PROMISE_PERCENT:
        out.append(f"{promised:.0f} % promised, {came:.0f} % came")
    if flown.replay_differing != 0:
        out.append(f"replay: {_text(flown.replay_differing, 0)} setpoints differ")
    return out


def table(flights: Sequence[Flown]) -> str:
    """A row for each flight, and below it what was wrong."""
    wrong = [f"- {one.task.name}: {'; '.join(found)}" for one in flights if (found := problems(one))]
    rows = columns([HEAD, *map(_row, flights)], left=(0, 1, 2, 4, 5))
    return "\n".join([*rows, "", *(wrong or ["every flight was as it must be"])])


def _row(flown: Flown) -> tuple[str, ...]:
    task, end = flown.task, flown.end or {}
    charge = f"{_text(end.get('charge_promised_percent'), 0)}/{_text(end.get('charge_came_percent'), 0)}"
    return (
        *(task.personality, "yes" if task.gps else "no", task.world, str(task.seed)),
        *(flown.ended_because or "-", end.get("ended_because") or "-", _text(flown.off_start_m, 2)),
        *(_text(flown.contacts, 0), _text(flown.least_m, 2), _text(end.get("way_home_m"), 1)),
        *(_text(end.get("homing_s"), 0), charge, _text(flown.replay_differing, 0), f"{flown.lasted_s:.0f}"),
    )


def _text(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Fly; the exit code."""
    parser = argparse.ArgumentParser(prog="python -m validation.homing", allow_abbrev=False)
    parser.add_argument("--autopilot", nargs="+", choices=PERSONALITIES, default=PERSONALITIES, help="by default both")
    parser.add_argument("--no-gps", action="store_true", help="by external odometry")
    parser.add_argument("--world", nargs="+", default=["room"], metavar="NAME")
    parser.add_argument("--count", type=int, default=5, metavar="N", help="flights of each kind")
    parser.add_argument("--time-limit", type=float, default=30.0, metavar="S", help="of the exploring")
    parser.add_argument("--battery-minutes", type=float, default=10.0, metavar="M", help="from full to empty")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the results here after every flight")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="keep the folders of the flights in this one")
    parser.add_argument("--list", action="store_true", help="the flights, without flying")
    given = parser.parse_args(arguments)
    tasks = [
        Task(personality, not given.no_gps, world, seed, given.time_limit, given.battery_minutes)
        for world in given.world
        for seed in range(1, given.count + 1)
        for personality in given.autopilot
    ]
    if given.list:
        say("\n".join(task.name for task in tasks))
        return 0
    done: list[Flown] = []
    for number, task in enumerate(tasks, 1):
        flown = _flown(task, given.keep)
        done.append(flown)
        write_whole(given.json, [asdict(one) for one in done])
        words = "; ".join(problems(flown)) or "ok"
        say(f"[{number}/{len(tasks)}] {task.name}: {words} ({flown.lasted_s:.0f} s)")
    say("\n" + table(done))
    return 1 if any(map(problems, done)) else 0


def _flown(task: Task, keep: Path | None) -> Flown:
    if keep is not None:
        keep.mkdir(parents=True, exist_ok=True)
        return fly(task, Path(tempfile.mkdtemp(prefix=f"{task.name}-", dir=keep)))
    with tempfile.TemporaryDirectory(prefix=f"{task.name}-", ignore_cleanup_errors=True) as folder:
        return fly(task, Path(folder))


if __name__ == "__main__":
    raise SystemExit(main())
