"""A flight controller and a world made of software, for flights over MAVLink."""

from __future__ import annotations

import typer

from sitl.autopilot.cli import autopilot
from sitl.launch.cli import fly
from sitl.world.cli import world

app = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode=None,
    help="A flight controller and a world made of software, for flights over MAVLink.",
)
app.command()(autopilot)
app.command()(world)
app.command()(fly)
