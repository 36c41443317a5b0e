"""The commands of a flight: `companion check`, `companion run`, `companion figures`, `companion replay`.

What they need is imported when they run: the help must not wait for it.
"""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Annotated, Literal, NoReturn

import typer

from companion.cli.options import AsJson, Config, Preset
from companion.errors import CompanionError, InputError

Fix = Annotated[bool, typer.Option("--fix", help="Set the autopilot's parameters that a check finds wrong.")]
Skip = Annotated[
    list[str] | None, typer.Option("--skip", metavar="CHECK", help="Skip this check, on record; may be repeated.")
]


def check(config: Config = None, preset: Preset = None, fix: Fix = False, skip: Skip = None) -> None:
    """Check everything that a flight needs, without arming.

    The exit code is 0 when the vehicle may fly, 1 when a check fails or no autopilot answers, 2 for wrong input.
    """
    _through_the_gate("check", config, preset, fix=fix, skip=skip)


def run(
    config: Config = None,
    preset: Preset = None,
    start: Annotated[
        Literal["now", "key", "command"] | None, typer.Option(help="What starts the flight; else mission.start.")
    ] = None,
    seed: Annotated[int | None, typer.Option(min=0, metavar="N", help="Draws every choice; else a new one.")] = None,
    fix: Fix = False,
    skip: Skip = None,
    resume_map: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="Go on with map and known ground of an earlier flight, from the same place; only if the autopilot was "
            "not restarted.",
        ),
    ] = None,
) -> None:
    """Explore with a real or simulated autopilot and bring home the map.

    Connects, checks, waits for the start, takes off, explores and ends the flight as configured. Ctrl-C ends it the
    same way. All of it stands behind the safety gate, a process of its own that checks every setpoint, stops the
    vehicle when anything is late or wrong, and starts the application again when it has died; it then waits for a
    start. While the gate brakes the application goes on steering, so that the flight can go on; when the gate holds or
    lands, the flight is over.

    The exit code is 0 when the map is complete or a person stopped the flight, 1 when it was refused or ended
    otherwise, 2 for wrong input, 130 after Ctrl-C.
    """
    _through_the_gate("run", config, preset, start=start, seed=seed, fix=fix, skip=skip, resume_map=resume_map)


def figures(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Recording of a flight, flight.mcap.")],
    as_json: AsJson = False,
) -> None:
    """Print the figures of a recorded flight: setpoint rate and jitter, ages of the inputs, CPU and memory."""
    from companion.recording.flight_stats import show_figures

    typer.echo(show_figures(file, as_json))


def replay(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Recording of a flight, flight.mcap.")],
    config: Annotated[
        Path | None, typer.Option("--config", metavar="FILE", help="Other settings than it was flown with.")
    ] = None,
    graph: Annotated[
        Path | None,
        typer.Option("--graph", metavar="FILE", help="New file for the navigation graph, such as graph.json."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of words.")] = False,
) -> None:
    """Fly a recording again through the present code, and compare the setpoints.

    The exit code is 0 when every setpoint is the recorded one, 1 when some differ, 2 when the file is no recording.
    """
    from companion.config.load import load_settings
    from companion.mapping.files.graph_file import write_graph
    from companion.recording.replay import replay as fly_again

    if graph is not None and graph.exists():
        raise InputError(f"--graph {graph}: exists already; give a new name")
    flown = fly_again(file, None if config is None else load_settings(config))
    if graph is not None:
        try:
            write_graph(flown.graph, graph)
        except OSError as error:
            raise CompanionError(f"--graph {graph}: {error.strerror}; give a file that you may write") from None
    if as_json:
        shown = {field.name: getattr(flown, field.name) for field in dataclasses.fields(flown)}
        typer.echo(json.dumps(shown | {"graph": flown.graph.counts()._asdict()}, indent=2))
    else:
        typer.echo(f"{flown.ticks} ticks flown again, {flown.compared} setpoints compared, {flown.differing} differ")
        if flown.first_difference_s is not None:
            typer.echo(f"first at t = {flown.first_difference_s:.2f} s, largest {flown.largest_difference:.3g}")
        if flown.stopped is not None:
            typer.echo(f"ended early: {flown.stopped}")
    if flown.differing:
        raise typer.Exit(1)


def _through_the_gate(
    what: Literal["check", "run"],
    config: Path | None,
    preset: str | None,
    *,
    fix: bool,
    skip: list[str] | None,
    start: Literal["now", "key", "command"] | None = None,
    seed: int | None = None,
    resume_map: Path | None = None,
) -> NoReturn:
    """Load the settings and hand them over: this process becomes the gate."""
    from companion.config.load import load
    from companion.flight.request import FlightRequest, become_the_gate
    from companion.safety_case.gate_plan import refuse_if_reachable

    loaded = load(config, preset)
    refuse_if_reachable(loaded.settings)
    folder = None if resume_map is None else resume_map.resolve()
    request = FlightRequest(what, loaded.settings, loaded.preset, seed, fix, tuple(skip or ()), folder)
    become_the_gate(request if start is None else request.started_by(start))
