"""The commands that fly: `companion run`, `companion check`, `companion figures`.

What they need is imported when they run: the help must not wait for it.
"""

from __future__ import annotations

import asyncio
import logging
from pathlib import Path
from typing import Annotated, Literal

import typer

from companion.errors import CompanionError

EXIT_INTERRUPTED = 130

Config = Annotated[Path | None, typer.Option("--config", metavar="FILE", help="YAML file that describes the vehicle.")]
Preset = Annotated[
    str | None, typer.Option("--preset", metavar="NAME", help="Preset below the file; overrides the file's choice.")
]
Fix = Annotated[bool, typer.Option("--fix", help="Set the autopilot's parameters that a check finds wrong.")]
Skip = Annotated[
    list[str] | None, typer.Option("--skip", metavar="CHECK", help="Skip this check, on record; may be repeated.")
]


class ChecksFailedError(CompanionError):
    """A pre-flight check failed."""


class FlightFailedError(CompanionError):
    """The flight did not end as it should."""


def check(config: Config = None, preset: Preset = None, fix: Fix = False, skip: Skip = None) -> None:
    """Check everything that a flight needs, without arming.

    The exit code is 0 when the vehicle may fly, 1 when a check fails or no autopilot answers, 2 for wrong input.
    """
    from companion import app
    from companion.autopilot.preflight import refusal, render
    from companion.config.load import load

    _log_to_stderr()
    loaded = load(config, preset)
    options = app.Options(preset=loaded.preset, fix=fix, skip=tuple(skip or ()))
    results = asyncio.run(app.check(loaded.settings, options, lambda line: typer.echo(line, err=True)))
    typer.echo(render(results))
    if (why := refusal(results)) is not None:
        raise ChecksFailedError(why)


def run(
    config: Config = None,
    preset: Preset = None,
    start: Annotated[
        Literal["now", "key", "command"] | None,
        typer.Option(help="What starts the flight; else mission.start."),
    ] = None,
    seed: Annotated[int | None, typer.Option(min=0, metavar="N", help="Draws every choice; else a new one.")] = None,
    fix: Fix = False,
    skip: Skip = None,
) -> None:
    """Explore with a real or simulated autopilot and bring home the map.

    Connects, checks, waits for the start, takes off, explores and ends the flight as configured. Ctrl-C ends it the
    same way. The exit code is 0 when the map is complete or a person stopped the flight, 1 when it was refused or ended
    otherwise, 2 for wrong input, 130 after Ctrl-C.
    """
    from companion import app
    from companion.config.load import load

    _log_to_stderr()
    loaded = load(config, preset)
    settings = loaded.settings
    if start is not None:
        settings = settings.model_copy(update={"mission": settings.mission.model_copy(update={"start": start})})
    options = app.Options(preset=loaded.preset, seed=seed, fix=fix, skip=tuple(skip or ()))
    summary = asyncio.run(app.fly(settings, options, typer.echo))
    if summary["interrupted"]:
        raise typer.Exit(EXIT_INTERRUPTED)
    if not summary["as_it_should"]:
        raise FlightFailedError(f"the flight ended because: {summary['ended_because']}")


def figures(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Recording of a flight, flight.mcap.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")] = False,
) -> None:
    """Print the figures of a recorded flight: setpoint rate and jitter, ages of the inputs, CPU and memory."""
    from companion.figures import show_figures

    typer.echo(show_figures(file, as_json))


def _log_to_stderr() -> None:
    logging.basicConfig(level=logging.WARNING, format="%(asctime)s %(levelname)s %(name)s: %(message)s")
