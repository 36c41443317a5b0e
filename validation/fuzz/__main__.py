"""`python -m validation.fuzz --seconds 600 --seed N`: the cases of each target from seed N on, until the time is up."""

from __future__ import annotations

import argparse
import logging
import sys
import time
import traceback
import warnings

from validation.fuzz.targets import TARGETS, run

SLOW, EVERY = ("flood",), 20
"""Takes as long as all others together, so that it has its turn only with every so many seeds."""


def main() -> int:
    """1 when a case failed; what it was stands on the error output, and the others go on."""
    parser = argparse.ArgumentParser(prog="python -m validation.fuzz", description=__doc__)
    parser.add_argument("--seconds", type=float, default=600.0, help="stop after this long; 0: one case of each target")
    parser.add_argument("--seed", type=int, default=1_000_000, help="of the first case")
    parser.add_argument("--only", choices=list(TARGETS), action="append", help="a target; may be repeated")
    arguments = parser.parse_args()
    warnings.simplefilter("error")
    logging.disable(logging.WARNING)
    names = arguments.only or list(TARGETS)
    until_s, seed, failed, cases = time.monotonic() + arguments.seconds, arguments.seed, 0, 0
    while True:
        for name in names:
            if name in SLOW and name not in (arguments.only or ()) and (seed - arguments.seed) % EVERY:
                continue
            # Before it runs: what ends the interpreter itself tells nothing any more.
            sys.stderr.write(f"\r{cases} cases, {failed} failed; now {name} {seed}    ")
            sys.stderr.flush()
            cases += 1
            try:
                run(name, seed)
            except Exception:  # noqa: BLE001 - whatever it is, it is what was looked for
                failed += 1
                again = f"python -m validation.fuzz --only {name} --seed {seed} --seconds 0"
                sys.stderr.write(f"\nFAILED: {again}\n{traceback.format_exc()}\n")
        seed += 1
        if time.monotonic() >= until_s:
            sys.stderr.write(f"\n{cases} cases, {failed} failed\n")
            return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
