"""The commands of a flight: `companion check`, `companion run`, `companion figures`, `companion replay`.

What they need is imported when they run: the help must not wait for it.
"""

from __future__ import annotations

import asyncio
import dataclasses
import json
import logging
from pathlib import Path
from typing import Annotated, Literal

import typer

from companion.errors import EXIT_INTERRUPTED, CompanionError

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
    from companion.ready import Options

    _log_to_stderr()
    loaded = load(config, preset)
    options = Options(preset=loaded.preset, fix=fix, skip=tuple(skip or ()))
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
    from companion.ready import Options

    _log_to_stderr()
    loaded = load(config, preset)
    settings = loaded.settings
    if start is not None:
        settings = settings.model_copy(update={"mission": settings.mission.model_copy(update={"start": start})})
    options = Options(preset=loaded.preset, seed=seed, fix=fix, skip=tuple(skip or ()))
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


def replay(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Recording of a flight, flight.mcap.")],
    config: Annotated[
        Path | None, typer.Option("--config", metavar="FILE", help="Other settings than it was flown with.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of words.")] = False,
) -> None:
    """Fly a recording again through the present code, and compare the setpoints.

    The exit code is 0 when every setpoint is the recorded one, 1 when some differ, 2 when the file is no recording.
    """
    from companion.config.load import load_settings
    from companion.replay import replay as fly_again

    flown = fly_again(file, None if config is None else load_settings(config))
    if as_json:
        typer.echo(json.dumps(dataclasses.asdict(flown), indent=2))
    else:
        typer.echo(f"{flown.ticks} ticks flown again, {flown.compared} setpoints compared, {flown.differing} differ")
        if flown.first_difference_s is not None:
            typer.echo(f"first at t = {flown.first_difference_s:.2f} s, largest {flown.largest_difference:.3g}")
        if flown.stopped is not None:
            typer.echo(f"ended early: {flown.stopped}")
    if flown.differing:
        raise typer.Exit(1)


def _log_to_stderr() -> None:
    logging.basicConfig(level=logging.WARNING, format="%(asctime)s %(levelname)s %(name)s: %(message)s")
