"""The fault matrix, or a part of it: each fault is injected into a real flight of real processes towards a wall.

python -m validation.fault_matrix [--jobs N] [--only NAME ...] [--personality P] [--json FILE [--resume]] [--keep DIR]
                              [--write-docs] [--list]

Autopilot, relay, gate, application, relay, world: everything runs on this computer, over MAVLink and the sensors'
stream, as on a vehicle. What is measured is what went over the wire and where the vehicle truly was.

The outcomes are in the file after every flight, so that an hour of flights can be broken off and gone on with. The exit
code is 0 when every flight ended as it must, 1 when one did not, 2 for wrong input.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

from companion.errors import CompanionError
from validation.fault_matrix import results
from validation.fault_matrix.faults import BY_NAME, CELLS, FAULTS
from validation.fault_matrix.injection import PERSONALITIES
from validation.fault_matrix.outcome import AIM_S, Outcome
from validation.fault_matrix.report import ReportError, markdown, write_into_docs
from validation.fault_matrix.run import end_with_parent, fly_in_pool

CORES_PER_FLIGHT = 2
STOOD_S = 0.1
"""The computer is said to have stood still."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Fly; the exit code."""
    given = _arguments(arguments)
    if given.list:
        for fault in FAULTS:
            _say(f"{fault.group:12} {fault.name:32} {'+'.join(fault.personalities):14} {fault.what}")
        return 0
    cells = [
        (name, personality)
        for name, personality in CELLS
        if (not given.only or name in given.only) and given.personality in (None, personality)
    ]
    outcomes = results.read(given.json) if given.resume else {}
    left = [cell for cell in cells if cell not in outcomes]
    errors: list[str] = []
    for number, (cell, found) in enumerate(_flown(left, given.jobs, given.keep), 1):
        progress = f"[{number}/{len(left)}] {cell[0]}, {cell[1]}: "
        if isinstance(found, Outcome):
            outcomes[cell] = found
            _say(progress + line(found))
            results.write(given.json, outcomes.values())
        else:
            errors.append(f"{cell[0]}, {cell[1]}")
            _say(f"{progress}NOT FLOWN: {found}")
    in_order = [outcomes[cell] for cell in cells if cell in outcomes]
    if in_order:
        _say("\n" + markdown(in_order))
    if given.write_docs:
        try:
            write_into_docs(in_order)
        except ReportError as error:
            _say(str(error))
            return 2
    return 0 if not errors and all(one.ok for one in in_order) else 1


def _flown(
    cells: Sequence[tuple[str, str]], jobs: int, keep: Path | None
) -> Iterator[tuple[tuple[str, str], Outcome | Exception]]:
    """Each flight when it is over, in a process of its own: what one flight takes another must not wait for."""
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(jobs, mp_context=context, initializer=end_with_parent) as pool:
        flights = {pool.submit(fly_in_pool, *cell, keep): cell for cell in cells}
        for flight in as_completed(flights):
            try:
                yield flights[flight], flight.result()
            except (CompanionError, AssertionError, OSError) as error:
                yield flights[flight], error


def line(outcome: Outcome) -> str:
    """An outcome for who looks on."""
    brake = "no brake" if outcome.brake_s is None else f"brake after {outcome.brake_s:.3f} s"
    if outcome.brake_s is not None and outcome.brake_s > AIM_S and BY_NAME[outcome.name].needs_stop:
        brake += f" (aim {AIM_S:g})"
    again = "" if outcome.attempts == 1 else f", attempt {outcome.attempts}"
    if outcome.stood_still_s > STOOD_S:
        again += f", the computer stood still for {outcome.stood_still_s:.2f} s"
    return (
        f"{'ok' if outcome.ok else 'FAILED: ' + str(outcome.problem)}; {brake}, {outcome.speed_mps:.2f} m/s at "
        f"{outcome.wall_m:.2f} m, went on {outcome.travelled_m:.2f} m, least {outcome.least_m:.2f} m, "
        f"{outcome.final}{again}; gate: {' | '.join(outcome.gate) or 'silent'}"
    )


def _arguments(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m validation.fault_matrix", allow_abbrev=False)
    parser.add_argument("--jobs", type=int, default=max(1, (os.cpu_count() or 1) // CORES_PER_FLIGHT), metavar="N")
    parser.add_argument("--only", nargs="+", choices=tuple(BY_NAME), metavar="NAME", help="faults; else all")
    parser.add_argument("--personality", choices=PERSONALITIES)
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the outcomes here")
    parser.add_argument("--resume", action="store_true", help="go on where --json FILE was broken off")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="keep the folders of the flights in this one")
    parser.add_argument("--write-docs", action="store_true", help="put the table into docs/safety.md")
    parser.add_argument("--list", action="store_true", help="the faults, without flying")
    given = parser.parse_args(arguments)
    if given.resume and given.json is None:
        parser.error("--resume needs --json FILE")
    return given


def _say(words: str) -> None:
    sys.stdout.write(f"{time.strftime('%H:%M:%S')} {words}\n" if words.startswith("[") else f"{words}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    raise SystemExit(main())
