"""Each row of "when home cannot be reached", flown over MAVLink on the stub, and a table of what happened.

python -m validation.homing.rows [--only NAME ...] [--autopilot px4|ardupilot ...] [--json FILE [--resume]] [--keep DIR]
    [--list]

The vehicle explores a drift until it is some metres out, is ordered home, and three seconds later it happens. A flight
takes real time, one to six minutes; all of them take an hour. The exit code is 0 when each ended as docs/flying.md
says, 1 when one did not.
"""

from __future__ import annotations

import argparse
import json
import signal
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from companion.mavlink.ids import MavCmd
from companion.text_table import columns
from validation.fault_matrix.injection import PERSONALITIES
from validation.fault_matrix.results import write_whole
from validation.homing.row_flight import Came, Row, Underway, fly
from validation.real.program import say

HOME_M = 0.5
WHERE_IT_IS_M = 2.0
"""It lands where it is: from full speed it stands after half a metre, and drifts a little without a pose."""

BACK_AFTER_S = 3.0
"""Shorter than the gate waits until it holds."""

KILLS = 4
"""Once more than the map is started again."""

HEAD = (
    *("row", "autopilot", "the way home ended", "then", "after, s", "from home, m", "from there, m", "contacts"),
    "as it must",
)


def _depth_gone(flight: Underway) -> None:
    flight.tell_world(signal.SIGSTOP)


def _depth_back(flight: Underway) -> None:
    flight.tell_world(signal.SIGSTOP)
    time.sleep(BACK_AFTER_S)
    flight.tell_world(signal.SIGCONT)


def _kill_map(flight: Underway) -> None:
    for _ in range(KILLS):
        flight.wait("a process of the map", flight.kill_map, 60.0)
        time.sleep(1.0)


def _interrupt_again(flight: Underway) -> None:
    # The order to come home came by command, so the first signal asks for the end that is under way already.
    for _ in range(2):
        flight.gate.send_signal(signal.SIGINT)
        time.sleep(1.0)


ROWS = (
    Row("depth back", "depth is lost for 3 s", ("home",), _depth_back, "stopped: no depth", (0.0, HOME_M),
        personalities=("px4",)),
    Row("depth gone", "depth and ranges are lost", ("inputs lost", "gate took over"), _depth_gone, "stopped: no depth",
        from_m=WHERE_IT_IS_M, has_truth=False),
    Row("pose gone", "the fix is lost", ("gate took over", "autopilot failsafe took over", "inputs lost"),
        lambda flight: flight.tell_autopilot("gps off"), from_m=WHERE_IT_IS_M),
    Row("home taken", "rock has fallen where it took off", ("home",), lambda _flight: None,
        "where it took off cannot be got to", (1.0, 8.0), world="hazard:roof-fall", out_m=13.0, most_s=240.0,
        personalities=("px4",)),
    Row("way closed", "a door has closed", ("way home closed",), lambda _flight: None, "the way home is closed",
        (5.0, 13.0), world="hazard:door", out_m=14.0, most_s=400.0, personalities=("px4",)),
    Row("too long", "a person has it wait on the way, and forgets it", ("time limit",),
        lambda flight: flight.order(MavCmd.DO_PAUSE_CONTINUE), "paused", from_m=WHERE_IT_IS_M, most_s=420.0,
        personalities=("ardupilot",)),
    Row("battery short", "the battery has 24 % left and falls by 25 % a minute", ("battery low",),
        lambda flight: flight.tell_autopilot("battery 24"), "the battery will not last until home", (1.0, 20.0),
        out_m=14.0, battery_minutes=4.0),
    Row("pilot", "the pilot's switch", ("pilot took over",), lambda flight: flight.tell_autopilot("takeover"),
        lands=False),
    Row("autopilot gone", "the autopilot dies", ("autopilot lost", "gate took over"),
        lambda flight: flight.crew.autopilot.process.kill(), lands=False),
    Row("map gone", "the map's process dies, again and again", ("home",), _kill_map, lies=(0.0, HOME_M),
        personalities=("ardupilot",)),
    Row("landing", "a person orders a landing", ("stopped",), lambda flight: flight.order(MavCmd.NAV_LAND),
        from_m=WHERE_IT_IS_M),
    Row("second stop", "Ctrl-C, twice", ("stopped",), _interrupt_again, from_m=WHERE_IT_IS_M, personalities=("px4",)),
)  # fmt: skip
BY_NAME = {row.name: row for row in ROWS}
CELLS = tuple((row.name, personality) for row in ROWS for personality in row.personalities)


def problems(came: Came) -> list[str]:
    """What was not as it must be."""
    if came.problem is not None:
        return [came.problem]
    row, out = BY_NAME[came.row], []
    if came.ended not in row.ends:
        out.append(f"ended: {came.ended}")
    if came.contacts:
        out.append(f"{came.contacts} contacts")
    if not came.said:
        out.append(f"did not say: {row.says}")
    if came.lay_m is None or not row.lies[0] <= came.lay_m <= row.lies[1]:
        out.append(f"lay {_text(came.lay_m, 2)} m from home")
    if row.from_m is not None and (came.went_m is None or came.went_m > row.from_m):
        out.append(f"lay {_text(came.went_m, 2)} m from where it was")
    if row.lands == came.armed:
        out.append("armed" if came.armed else "disarmed")
    return out


def table(flights: Sequence[Came]) -> str:
    """A row for each flight, and below it what was wrong."""
    wrong = [f"- {one.row}, {one.personality}: {'; '.join(found)}" for one in flights if (found := problems(one))]
    rows = columns([HEAD, *map(_row, flights)], left=(0, 1, 2, 3))
    return "\n".join([*rows, "", *(wrong or ["every flight ended as it must"])])


def _row(came: Came) -> tuple[str, ...]:
    then = "-" if came.mode is None else f"{came.mode}{'' if came.armed else ', disarmed'}"
    return (
        *(came.row, came.personality, came.ended or "-", then, _text(came.after_s, 0), _text(came.lay_m, 1)),
        *(_text(came.went_m, 1), _text(came.contacts, 0), "no" if problems(came) else "yes"),
    )


def _text(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Fly; the exit code."""
    parser = argparse.ArgumentParser(prog="python -m validation.homing.rows", allow_abbrev=False)
    parser.add_argument("--only", nargs="+", choices=tuple(BY_NAME), metavar="NAME", help="rows; else all")
    parser.add_argument("--autopilot", nargs="+", choices=PERSONALITIES, default=PERSONALITIES, help="by default both")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the results here after every flight")
    parser.add_argument("--resume", action="store_true", help="go on where --json FILE was broken off")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="keep the folders of the flights in this one")
    parser.add_argument("--list", action="store_true", help="the flights, without flying")
    given = parser.parse_args(arguments)
    if given.resume and given.json is None:
        parser.error("--resume needs --json FILE")
    cells = [cell for cell in CELLS if cell[0] in (given.only or BY_NAME) and cell[1] in given.autopilot]
    if given.list:
        say("\n".join(f"{name:16} {personality:10} {BY_NAME[name].what}" for name, personality in cells))
        return 0
    done = _read(given.json) if given.resume else {}
    left = [cell for cell in cells if cell not in done]
    for number, (name, personality) in enumerate(left, 1):
        came = _flown(BY_NAME[name], personality, given.keep)
        done[name, personality] = came
        write_whole(given.json, [asdict(one) for one in done.values()])
        say(f"[{number}/{len(left)}] {name}, {personality}: {'; '.join(problems(came)) or 'ok'}")
    flights = [done[cell] for cell in cells if cell in done]
    say("\n" + table(flights))
    return 1 if any(map(problems, flights)) else 0


def _read(file: Path) -> dict[tuple[str, str], Came]:
    """What was flown; a flight that came to nothing, as on a computer that was busy with others, is flown again."""
    found = json.loads(file.read_text(encoding="utf-8")) if file.exists() else []
    return {(one["row"], one["personality"]): Came(**one) for one in found if one["problem"] is None}


def _flown(row: Row, personality: str, keep: Path | None) -> Came:
    prefix = f"{row.name.replace(' ', '-')}-{personality}-"
    if keep is not None:
        keep.mkdir(parents=True, exist_ok=True)
        return fly(row, personality, Path(tempfile.mkdtemp(prefix=prefix, dir=keep)))
    with tempfile.TemporaryDirectory(prefix=prefix, ignore_cleanup_errors=True) as folder:
        return fly(row, personality, Path(folder))


if __name__ == "__main__":
    raise SystemExit(main())
