"""Options of every command that takes a mine from a file."""

from __future__ import annotations

from typing import Annotated

import typer

from sitl.mines.files.geometry import Up
from sitl.mines.placing import Reading

Scale = Annotated[
    float | None,
    typer.Option("--scale", metavar="FACTOR", help="Mesh: what one unit is in m, 0.001 for mm; else as the file says."),
]
UpAxis = Annotated[
    Up | None,
    typer.Option("--up", help="Mesh: its axis that points up; else z, y for glTF, for Collada as the file says."),
]
CloudVoxel = Annotated[
    float,
    typer.Option("--cloud-voxel", metavar="M", help="Points without triangles: voxels that their surface is made of."),
]
DEFAULT_CLOUD_VOXEL_M = Reading().cloud_voxel_m
