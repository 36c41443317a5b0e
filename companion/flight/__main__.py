"""The application, as the gate starts it: a process of its own that has no other way to the autopilot.

    python -m companion.flight --request-fd N

It reads what is asked of it from the sealed memory that it inherited (`companion.flight.request`). Nobody starts it by
hand: without a gate there is no flight. Its last word to the gate is a goodbye with the exit code; whatever ends
without that word is taken for dead.
"""

from __future__ import annotations

import argparse
import asyncio
import logging
import signal
from collections.abc import Sequence

import typer

from companion.errors import EXIT_INTERRUPTED, CompanionError, InputError
from companion.flight.gate_socket import GateSocket
from companion.gate.runtime.processes import end_with_parent
from companion.interruption import signals_are_ctrl_c
from companion.output import lossy_output

_SIGNALS = (signal.SIGINT, signal.SIGTERM)


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
    signals_are_ctrl_c(_SIGNALS)
    # Of a terminal that is closed the gate hears too, and asks for the end of the flight: this is no death in the air.
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    # Who loads and compiles looks at no socket, for a minute; from then on the end of the socket is that of the gate.
    end_with_parent(signal.SIGTERM)
    parser = argparse.ArgumentParser(prog="companion.flight", allow_abbrev=False)
    parser.add_argument("--request-fd", type=int, required=True)
    given = parser.parse_args(arguments)
    try:
        gate = GateSocket.from_environment()
    except InputError as error:
        typer.echo(str(error), err=True)
        return error.exit_code
    # A flight goes on when nobody can read what is said of it.
    with lossy_output():
        try:
            code = _work(given.request_fd, gate)
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


def _work(request_fd: int, gate: GateSocket) -> int:
    # Here, where Ctrl-C is waited for already: it takes seconds.
    from companion.flight import mission
    from companion.flight.preflight import refusal, render
    from companion.flight.preflight.run import FlightRefusedError
    from companion.flight.request import FlightRequest

    request = FlightRequest.unsealed(request_fd)
    if request.what == "check":
        results = asyncio.run(mission.check(request, gate, lambda line: typer.echo(line, err=True)))
        typer.echo(render(results))
        if (why := refusal(results)) is not None:
            raise FlightRefusedError(why)
        return 0
    summary = asyncio.run(mission.fly(request, gate, typer.echo))
    if summary["interrupted"]:
        return EXIT_INTERRUPTED
    if not summary["as_it_should"]:
        end = summary["end"]
        home = "" if end is None else f"; the way home: {end['ended_because'] or 'broke off'}"
        raise FlightFailedError(f"the flight ended because: {summary['ended_because']}{home}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
