"""Whole flights on the real PX4 and the real ArduCopter, one after the other, and a table of what came of them.

PX4_BINARY=... ARDUCOPTER_BINARY=... scripts/own-network .venv/bin/python -m validation.real.flights
    [--autopilot px4|ardupilot] [--gps|--no-gps] [--world NAME ...] [--count N] [--time-limit S]
    [--json FILE [--resume]] [--keep DIR] [--list]
    [--skip CHECK ...] [--world-option=OPTION ...] [--param NAME=VALUE ...]

Without options: in `room` and in `slope` three flights each without GPS and one with it, and 15 minutes in `complex`,
on each of the two. A flight takes real time. Results are in the file after every flight, and one that fails does not
stop the rest. The exit code is 0 when every flight was as it must be, 1 when one was not, 2 for wrong input.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from companion.errors import InputError
from companion.text_table import columns
from sitl.launch.real import RealAutopilot, find
from validation.fault_matrix.injection import PERSONALITIES
from validation.fault_matrix.results import write_whole
from validation.real.flight import Flown, Task, Ways, fly
from validation.real.program import common, prepare, say, ways

LANDED_WITHIN_M, HOME_WITHIN_M = 0.3, 0.5
WITHOUT_GPS, WITH_GPS = 3, 1
"""Flights in each of the small worlds."""
SMALL_WORLDS, LARGE_WORLD = ("room", "slope"), "complex"
SMALL_S, LARGE_S = 600.0, 900.0
HEAD = (
    *("autopilot", "gps", "world", "seed", "exit", "complete", "contacts", "least d, m", "landed off, m"),
    *("off the start, m", "setpoints p99/longest, ms", "replay", "flown, m", "duration, s"),
)


def tasks(
    personalities: Sequence[str],
    gps: bool | None = None,
    worlds: Sequence[str] | None = None,
    count: int | None = None,
    limit_s: float | None = None,
) -> list[Task]:
    """The flights of a campaign; what is not given is as the docstring of this file says."""
    found = []
    for with_gps in (False, True) if gps is None else (gps,):
        for world in worlds or (*SMALL_WORLDS, *([] if with_gps else [LARGE_WORLD])):
            large = world == LARGE_WORLD
            number = count or (1 if large else WITH_GPS if with_gps else WITHOUT_GPS)
            time_s = limit_s or (LARGE_S if large else SMALL_S)
            found += [
                Task(personality, with_gps, world, seed, time_s)
                for seed in range(1, number + 1)
                for personality in personalities
            ]
    return found


def problems(flown: Flown) -> list[str]:
    """What was not as it must be."""
    if flown.problem is not None:
        return [flown.problem]
    out = []
    in_time = flown.task.world != LARGE_WORLD
    if in_time and (flown.exit_code != 0 or not flown.complete):
        out.append(f"exit code {flown.exit_code}: {flown.ended_because}")
    if flown.contacts:
        out.append(f"{flown.contacts} contacts")
    if flown.landed_off_m is None or flown.landed_off_m > LANDED_WITHIN_M:
        out.append("landed " + ("nowhere" if flown.landed_off_m is None else f"{flown.landed_off_m:.2f} m off"))
    if flown.off_start_m is not None and flown.off_start_m > HOME_WITHIN_M:
        out.append(f"{flown.off_start_m:.2f} m from where it started")
    if not flown.disarmed:
        out.append("still armed")
    if flown.replay_differing != 0:
        out.append(f"replay: {flown.replay_differing} setpoints differ")
    return out


def table(flights: Sequence[Flown]) -> str:
    """A row for each flight, and below it what was wrong."""
    rows = [HEAD, *map(_row, flights)]
    wrong = [f"- {one.task.name}: {'; '.join(found)}" for one in flights if (found := problems(one))]
    return "\n".join([*columns(rows, left=(0, 1, 2)), "", *(wrong or ["every flight was as it must be"])])


def _row(flown: Flown) -> tuple[str, ...]:
    task = flown.task
    gaps = "-"
    if flown.setpoint_p99_s is not None and flown.setpoint_longest_s is not None:
        gaps = f"{flown.setpoint_p99_s * 1e3:.0f}/{flown.setpoint_longest_s * 1e3:.0f}"
    replayed = "-"
    if flown.replay_compared is not None:
        replayed = f"{flown.replay_differing} of {flown.replay_compared} differ"
    return (
        *(task.personality, "yes" if task.gps else "no", task.world, str(task.seed)),
        *(_text(flown.exit_code, 0), "-" if flown.complete is None else "yes" if flown.complete else "no"),
        *(_text(flown.contacts, 0), _text(flown.least_m, 2), _text(flown.landed_off_m, 2)),
        *(_text(flown.off_start_m, 2), gaps, replayed, _text(flown.path_m, 0), f"{flown.lasted_s:.0f}"),
    )


def _text(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def read(file: Path) -> list[Flown]:
    """What a campaign has written; nothing when there is no file."""
    if not file.exists():
        return []
    found = json.loads(file.read_text(encoding="utf-8"))
    return [Flown(**(one | {"task": Task(**one["task"]), "texts": tuple(one["texts"])})) for one in found]


def main(arguments: Sequence[str] | None = None) -> int:
    """Fly; the exit code."""
    parser = argparse.ArgumentParser(prog="python -m validation.real.flights", allow_abbrev=False)
    common(parser)
    parser.add_argument("--gps", action=argparse.BooleanOptionalAction, default=None)
    parser.add_argument("--world", nargs="+", metavar="NAME")
    parser.add_argument("--count", type=int, metavar="N", help="flights of each kind")
    parser.add_argument("--time-limit", type=float, metavar="S", help="of the exploring")
    given = parser.parse_args(arguments)
    wanted = tasks(given.autopilot or PERSONALITIES, given.gps, given.world, given.count, given.time_limit)
    if given.list:
        say("\n".join(task.name for task in wanted))
        return 0
    try:
        prepare()
        autopilots = {name: find(name) for name in dict.fromkeys(task.personality for task in wanted)}
        how = ways(given)
    except InputError as error:
        say(str(error))
        return 2
    done = read(given.json) if given.resume else []
    left = [task for task in wanted if task not in [one.task for one in done]]
    for number, task in enumerate(left, 1):
        flown = _flown(autopilots[task.personality], task, given.keep, how)
        done.append(flown)
        write_whole(given.json, [asdict(one) for one in done])
        say(f"[{number}/{len(left)}] {task.name}: {'; '.join(problems(flown)) or 'ok'} ({flown.lasted_s:.0f} s)")
    say("\n" + table(done))
    return 1 if any(map(problems, done)) else 0


def _flown(real: RealAutopilot, task: Task, keep: Path | None, how: Ways) -> Flown:
    if keep is not None:
        return fly(real, task, Path(tempfile.mkdtemp(prefix=f"{task.name}-", dir=keep)), how)
    with tempfile.TemporaryDirectory(prefix=f"{task.name}-", ignore_cleanup_errors=True) as folder:
        return fly(real, task, Path(folder), how)


if __name__ == "__main__":
    raise SystemExit(main())
