"""`python -m companion.gate --plan-fd N` is the gate; `companion run` becomes it."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence

from companion.errors import CompanionError, InputError
from companion.gate.plan import Plan
from companion.gate.runtime.main import run

MOST_BYTES = 1 << 20


def main(arguments: Sequence[str]) -> int:
    """Be the gate; gives the exit code: the application's own, 2 for what cannot be used, 70 for a fault of the gate.

    Args:
        arguments: ``--plan-fd`` and the number of a file descriptor with the plan.
    """
    try:
        return run(_plan(arguments))
    except CompanionError as error:
        os.write(2, f"{error}\n".encode(errors="replace"))
        return error.exit_code


def _plan(arguments: Sequence[str]) -> Plan:
    if len(arguments) != 2 or arguments[0] != "--plan-fd" or not arguments[1].isdecimal():
        raise InputError("the gate is started by `companion run` or `companion check`, with --plan-fd NUMBER")
    fd = int(arguments[1])
    try:
        text = os.pread(fd, MOST_BYTES, 0)
        os.close(fd)
        return Plan.loads(text.decode())
    except (OSError, ValueError) as error:
        raise InputError(f"the gate cannot read its plan: {error}") from error


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
