"""A flight controller and a world made of software, for flights over MAVLink."""

from __future__ import annotations

import typer

from sitl.cli.autopilot import autopilot
from sitl.cli.fly import fly
from sitl.cli.ground import ground
from sitl.cli.world import world

app = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode=None,
    help="A flight controller and a world made of software, for flights over MAVLink.",
)
app.command()(autopilot)
app.command()(world)
app.command()(fly)
app.command()(ground)
