"""The application, as the gate starts it: a process of its own that has no other way to the autopilot.

    python -m companion.flight run|check --settings-fd N --preset NAME [--seed N] [--fix] [--skip CHECK ...]
        [--resume-map FOLDER]

It reads its settings from what it inherited. Nobody starts it by hand: without a gate there is no flight. Its last word
to the gate is a goodbye with the exit code; whatever ends without that word is taken for dead.
"""

from __future__ import annotations

import argparse
import asyncio
import logging
import signal
from collections.abc import Sequence
from pathlib import Path

import typer

from companion.errors import EXIT_INTERRUPTED, CompanionError, InputError
from companion.flight.gate_socket import GateSocket

_SIGNALS = (signal.SIGINT, signal.SIGTERM)


class ChecksFailedError(CompanionError):
    """A pre-flight check failed."""


class FlightFailedError(CompanionError):
    """The flight did not end as it should."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Check or fly, and say goodbye to the gate.

    Args:
        arguments: the command line without the program's name; by default that of the process.

    Returns:
        The exit code, as `companion check` and `companion run` document it.
    """
    logging.basicConfig(level=logging.WARNING, format="%(asctime)s %(levelname)s %(name)s: %(message)s")
    # While nothing flies, the end of the service is the same as Ctrl-C.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    given = _parser().parse_args(arguments)
    try:
        gate = GateSocket.from_environment()
        if gate is None:
            raise InputError("there is no gate, and without it nothing flies: start with `companion run`")
    except InputError as error:
        typer.echo(str(error), err=True)
        return error.exit_code
    try:
        code = _work(given, gate)
    except CompanionError as error:
        typer.echo(str(error), err=True)
        code = error.exit_code
    except KeyboardInterrupt:
        code = EXIT_INTERRUPTED
    # It is over: a late signal must not make a death of it.
    for number in _SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    gate.goodbye(code)
    return code


def _work(given: argparse.Namespace, gate: GateSocket) -> int:
    # Here, where Ctrl-C is waited for already: it takes seconds.
    from companion.config.settings import Settings
    from companion.flight import mission as app
    from companion.flight.launch import unsealed
    from companion.flight.preflight import refusal, render
    from companion.flight.preflight.run import Options

    settings = Settings.model_validate_json(unsealed(given.settings_fd), strict=True)
    if given.start is not None:
        settings = settings.model_copy(update={"mission": settings.mission.model_copy(update={"start": given.start})})
    options = Options(preset=given.preset, seed=given.seed, fix=given.fix, skip=tuple(given.skip))
    if given.what == "check":
        results = asyncio.run(app.check(settings, options, gate, lambda line: typer.echo(line, err=True)))
        typer.echo(render(results))
        if (why := refusal(results)) is not None:
            raise ChecksFailedError(why)
        return 0
    summary = asyncio.run(app.fly(settings, options, gate, typer.echo, given.resume_map))
    if summary["interrupted"]:
        return EXIT_INTERRUPTED
    if not summary["as_it_should"]:
        raise FlightFailedError(f"the flight ended because: {summary['ended_because']}")
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="companion.flight", allow_abbrev=False)
    parser.add_argument("what", choices=("run", "check"))
    parser.add_argument("--settings-fd", type=int, required=True)
    parser.add_argument("--preset", required=True)
    parser.add_argument("--start", choices=("now", "key", "command"))
    parser.add_argument("--seed", type=int)
    parser.add_argument("--fix", action="store_true")
    parser.add_argument("--skip", action="append", default=[])
    parser.add_argument("--resume-map", type=Path)
    return parser


if __name__ == "__main__":
    raise SystemExit(main())
