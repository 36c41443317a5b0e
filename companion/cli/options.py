"""Options that several commands have."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Config = Annotated[
    Path | None,
    typer.Option("--config", metavar="FILE", help="YAML file that describes the vehicle, see `companion config`."),
]
Preset = Annotated[
    str | None, typer.Option("--preset", metavar="NAME", help="Preset below the file; overrides the file's choice.")
]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")]
