"""Faults on the real PX4 and the real ArduCopter: each in a flight towards a wall, one after the other, and a table.

PX4_BINARY=... ARDUCOPTER_BINARY=... scripts/own-network .venv/bin/python -m validation.real.faults
    [--autopilot px4|ardupilot] [--only NAME ...] [--json FILE [--resume]] [--keep DIR] [--list]
    [--world-option=OPTION ...] [--param NAME=VALUE ...] [--skip CHECK ...]

The flights are those of validation.fault_matrix, without GPS unless the fault is one of GPS. Results are in the file
after every flight, and one that fails does not stop the rest. The exit code is 0 when every flight ended as it must, 1
when one did not, 2 for wrong input.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Sequence
from dataclasses import replace

from companion.config.load import merge
from companion.errors import CompanionError, InputError
from companion.text_table import columns
from sitl.launch.real import RealAutopilot, find
from validation.fault_matrix import results
from validation.fault_matrix.injection import PERSONALITIES
from validation.fault_matrix.outcome import Outcome
from validation.fault_matrix.run import fly_on
from validation.fault_matrix.stand import RealStand
from validation.real.flight import Ways
from validation.real.program import common, prepare, say, ways
from validation.real.real_faults import BY_NAME, CELLS, FAULTS, with_gps

ATTEMPTS = 2
SIMULATED = {
    # A joystick of the ground station is the transmitter; and a ground station is missed as soon as PX4 can.
    "px4": {"COM_RC_IN_MODE": 1, "COM_DL_LOSS_T": 5},
    "ardupilot": {},
}
HEAD = (
    *("fault", "autopilot", "speed, m/s", "standing after, s", "travelled, m", "least distance, m", "mode in the end"),
    "in the end",
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Fly; the exit code."""
    parser = argparse.ArgumentParser(prog="python -m validation.real.faults", allow_abbrev=False)
    common(parser)
    parser.add_argument("--only", nargs="+", choices=tuple(BY_NAME), metavar="NAME", help="faults; else all")
    given = parser.parse_args(arguments)
    cells = [
        (name, personality)
        for name, personality in CELLS
        if name in (given.only or BY_NAME) and personality in (given.autopilot or PERSONALITIES)
    ]
    if given.list:
        say("\n".join(f"{f.group:32} {f.name:54} {'+'.join(f.personalities):14} {f.what}" for f in FAULTS))
        return 0
    try:
        prepare()
        autopilots = {name: find(name) for name in dict.fromkeys(personality for _, personality in cells)}
        how = ways(given)
    except InputError as error:
        say(str(error))
        return 2
    outcomes = results.read(given.json) if given.resume else {}
    left = [cell for cell in cells if cell not in outcomes]
    not_flown: list[str] = []
    for number, (name, personality) in enumerate(left, 1):
        progress = f"[{number}/{len(left)}] {name}, {personality}: "
        try:
            outcome = _fly(name, autopilots[personality], how, given)
        except (CompanionError, AssertionError, OSError) as error:
            not_flown.append(f"{name} ({personality}): {error}")
            say(f"{progress}NOT FLOWN: {error}")
            continue
        outcomes[name, personality] = outcome
        results.write(given.json, outcomes.values())
        say(progress + _line(outcome))
    in_order = [outcomes[cell] for cell in cells if cell in outcomes]
    say("\n" + table(in_order))
    for one in not_flown:
        say(f"- not flown: {one.splitlines()[0]}")
    return 0 if not not_flown and all(one.ok for one in in_order) else 1


def _fly(name: str, real: RealAutopilot, how: Ways, given: argparse.Namespace) -> Outcome:
    fault = BY_NAME[name]
    skip = {"mission": {"skip_checks": ["clock", *how.skip]}}
    stand = RealStand(
        real,
        gps=with_gps(fault),
        world_options=how.world_options,
        parameters={**SIMULATED[real.personality], **how.parameters},
    )
    return fly_on(stand, replace(fault, settings=merge(dict(fault.settings), skip)), given.keep, ATTEMPTS)


def table(outcomes: Sequence[Outcome]) -> str:
    """A table for each group of faults, and what was said and wrong below it."""
    parts = []
    for group, found in itertools.groupby(outcomes, key=lambda outcome: outcome.group):
        rows = list(found)
        said = [
            f"- {one.name} ({one.personality}): gate: {' | '.join(one.gate) or 'silent'}; "
            f"autopilot: {' | '.join(one.texts) or 'silent'}"
            for one in rows
        ]
        parts += [group.capitalize(), *columns([HEAD, *map(_row, rows)], left=(0, 1, 6, 7)), *said, ""]
    wrong = [f"- FAILED: {one.name} ({one.personality}): {one.problem}" for one in outcomes if not one.ok]
    return "\n".join([*parts, *wrong, f"{len(outcomes)} flights, {len(outcomes) - len(wrong)} ended as they must"])


def _row(outcome: Outcome) -> tuple[str, ...]:
    standing = "-" if outcome.standing_s is None else f"{outcome.standing_s:.2f}"
    return (
        *(outcome.name, outcome.personality, f"{outcome.speed_mps:.2f}", standing, f"{outcome.travelled_m:.2f}"),
        *(f"{outcome.least_m:.2f}", outcome.mode, outcome.final.value if outcome.ok else f"FAILED: {outcome.final}"),
    )


def _line(outcome: Outcome) -> str:
    standing = "never stood" if outcome.standing_s is None else f"stood after {outcome.standing_s:.2f} s"
    return (
        f"{'ok' if outcome.ok else 'FAILED: ' + str(outcome.problem)}; {standing}, {outcome.speed_mps:.2f} m/s at "
        f"{outcome.wall_m:.2f} m, went on {outcome.travelled_m:.2f} m, least {outcome.least_m:.2f} m, {outcome.final}, "
        f"mode {outcome.mode}"
    )


if __name__ == "__main__":
    raise SystemExit(main())
