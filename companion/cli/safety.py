"""The safety case: the stopping budget, the faults and their answers, an example of the settings.

What they need is imported when they run: the help must not wait for it.
"""

from __future__ import annotations

import dataclasses
import json
from importlib.resources import files

import typer

from companion.cli.options import AsJson, Config, Preset

app = typer.Typer(
    no_args_is_help=True, rich_markup_mode=None, help="Show how the vehicle is kept from walls when something fails."
)


@app.command()
def budget(config: Config = None, preset: Preset = None, as_json: AsJson = False) -> None:
    """Print how far the vehicle goes after each fault, against the distance to a wall that the law allows.

    The exit code is 0 when no wall can be reached, 2 when one can, with the settings to change on stderr.
    """
    from companion.config.load import load_settings
    from companion.safety_case.gate_plan import refuse_if_reachable, stopping_lines
    from companion.safety_case.tables import render_budget

    settings = load_settings(config, preset)
    lines = stopping_lines(settings)
    if as_json:
        shown = [dataclasses.asdict(line) | {"reaches_wall": line.reaches_wall} for line in lines]
        typer.echo(json.dumps(shown, indent=2))
    else:
        typer.echo(render_budget(lines, settings))
    refuse_if_reachable(settings)


@app.command()
def faults(config: Config = None, preset: Preset = None) -> None:
    """Print what the gate watches for, from when on it is a fault, and what follows."""
    from companion.config.load import load_settings
    from companion.safety_case.tables import render_faults

    typer.echo(render_faults(load_settings(config, preset)))


@app.command()
def example() -> None:
    """Print a commented section `safety` for a settings file."""
    typer.echo((files("companion") / "config" / "safety.example.yaml").read_text(encoding="utf-8"), nl=False)
