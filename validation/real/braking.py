"""How the real PX4 and the real ArduCopter follow velocities and yaw rates, and how they stop, at higher speeds.

PX4_BINARY=... ARDUCOPTER_BINARY=... scripts/own-network .venv/bin/python -m validation.real.braking
    [--autopilot px4|ardupilot] [--gps] [--speeds 0.5,1.0,1.5,2.0] [--yaw-rates 0.6,1.0] [--repeats N]
    [--json FILE [--resume]] [--keep DIR] [--list] [--param NAME=VALUE ...]

In the open, by setpoints alone, with the parameters that pre-flight demands: each speed is stopped from by
zero velocity, by silence, and by the modes that the gate orders; each yaw rate is turned with on the spot and in
flight. A flight takes some nine minutes. Ways are true ones, as the simulators tell them.

Results are in the file after every flight, and one that fails does not stop the rest. The exit code is 0 when no stop
was longer than the stopping budget counts, 1 when one was or a flight failed, 2 for wrong input.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from companion.errors import CompanionError, InputError
from sitl.launch.real import RealAutopilot, find
from validation.fault_matrix.injection import PERSONALITIES
from validation.fault_matrix.results import write_whole
from validation.real.braking_flight import Sortie, fly
from validation.real.braking_report import Flown, problems, report
from validation.real.manoeuvres import Order, Stopped, Turned
from validation.real.program import flights, parameters, prepare, say
from validation.real.track import Cruise, Stop, Turn

SPEEDS_MPS, YAW_RATES_RADPS, REPEATS = "0.5,1.0,1.5,2.0", "0.6,1.0", 3


def main(arguments: Sequence[str] | None = None) -> int:
    """Fly; the exit code."""
    parser = argparse.ArgumentParser(prog="python -m validation.real.braking", allow_abbrev=False)
    flights(parser)
    parser.add_argument("--speeds", default=SPEEDS_MPS, metavar="M/S,...", help=f"by default {SPEEDS_MPS}")
    parser.add_argument("--yaw-rates", default=YAW_RATES_RADPS, metavar="RAD/S,...", help="none: an empty text")
    parser.add_argument("--repeats", type=int, default=REPEATS, metavar="N", help="flights on each")
    parser.add_argument("--gps", action="store_true", help="by GPS; else by external odometry, as underground")
    given = parser.parse_args(arguments)
    wanted = [(name, number) for number in range(1, given.repeats + 1) for name in given.autopilot or PERSONALITIES]
    if given.list:
        say("\n".join(f"{name} {number}" for name, number in wanted))
        return 0
    try:
        prepare()
        speeds_mps, yaw_rates_radps = numbers("--speeds", given.speeds), numbers("--yaw-rates", given.yaw_rates)
        sortie = Sortie(speeds_mps, yaw_rates_radps, given.gps, parameters(given))
        if not sortie.speeds_mps:
            raise InputError("--speeds: at least one is needed")
        autopilots = {name: find(name) for name in dict.fromkeys(name for name, _ in wanted)}
        done = read(given.json) if given.resume else []
    except InputError as error:
        say(str(error))
        return 2
    left = [one for one in wanted if one not in [(flown.autopilot, flown.number) for flown in done]]
    for number, (name, repeat) in enumerate(left, 1):
        flown = _flown(autopilots[name], repeat, sortie, given.keep)
        done.append(flown)
        write_whole(given.json, [asdict(one) for one in done])
        say(f"[{number}/{len(left)}] {name} {repeat}: {'; '.join(problems([flown])) or 'ok'}; load {flown.load:.1f}")
    say("\n" + report(done))
    return 1 if problems(done) else 0


def numbers(option: str, text: str) -> tuple[float, ...]:
    """A list with commas.

    Raises:
        InputError: one is no positive number.
    """
    found = []
    for part in filter(None, text.split(",")):
        try:
            value = float(part)
        except ValueError:
            value = math.nan
        if not 0.0 < value < math.inf:
            raise InputError(f"{option} {text}: {part!r} is no positive number; give numbers with commas: 0.5,1.0")
        found.append(value)
    return tuple(found)


def read(file: Path) -> list[Flown]:
    """What was written; nothing when there is no file."""
    return [_read(one) for one in json.loads(file.read_text(encoding="utf-8"))] if file.exists() else []


def _read(one: Mapping[str, Any]) -> Flown:
    stops = [
        Stopped(
            **stop | {"order": Order(stop["order"]), "cruise": Cruise(**stop["cruise"]), "stop": Stop(**stop["stop"])}
        )
        for stop in one["stops"]
    ]
    turns = [Turned(**turned | {"turn": Turn(**turned["turn"])}) for turned in one["turns"]]
    return Flown(**{**one, "stops": tuple(stops), "turns": tuple(turns)})


def _flown(real: RealAutopilot, number: int, sortie: Sortie, keep: Path | None) -> Flown:
    prefix = f"braking-{real.personality}-{number}-"
    if keep is not None:
        return _flown_in(real, number, sortie, Path(tempfile.mkdtemp(prefix=prefix, dir=keep)))
    with tempfile.TemporaryDirectory(prefix=prefix, ignore_cleanup_errors=True) as folder:
        return _flown_in(real, number, sortie, Path(folder))


def _flown_in(real: RealAutopilot, number: int, sortie: Sortie, folder: Path) -> Flown:
    """Never raises for what goes wrong in the flight: that is told, with what had been measured until then."""
    done: list[Stopped | Turned] = []
    problem = None
    try:
        for one in fly(real, sortie, folder):
            say(f"  {real.personality} {number}: {one}")
            done.append(one)
    except (CompanionError, AssertionError, OSError) as error:
        problem = f"{type(error).__name__}: {error}"
    stops = tuple(one for one in done if isinstance(one, Stopped))
    turns = tuple(one for one in done if isinstance(one, Turned))
    return Flown(real.personality, number, stops, turns, os.getloadavg()[1], problem)


if __name__ == "__main__":
    raise SystemExit(main())
