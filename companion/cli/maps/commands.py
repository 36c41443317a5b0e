"""The commands for maps that are files: `companion map info`, `export`, `merge` and `view`.

What they need is imported when they run: the help must not wait for it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Source = Annotated[
    Path, typer.Argument(metavar="MAP", help="A journal (map.journal), a mission's folder, or a .ot or .bt file.")
]
Offset = Annotated[
    tuple[float, float, float] | None,
    typer.Option(metavar="X Y Z", help="Where the map's origin is in the coordinates of a .las or .laz, in m."),
]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace what is there.")]

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None, help="Inspect, convert, merge and view maps.")


@app.command()
def info(
    source: Source, as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")] = False
) -> None:
    """Print what a map holds: size, sensor model, bounds, volume, surface, damage.

    The exit code is 0 also when a part of the map was damaged and is lost: the table says so. It is 2 when the source
    is no map.
    """
    from companion.cli.maps.info import show_info

    typer.echo(show_info(source, as_json=as_json))


@app.command()
def export(
    source: Source,
    targets: Annotated[
        list[Path],
        typer.Argument(metavar="TARGET...", help="Files to write: .ply .pcd .las .laz .bt .ot, or a mesh .obj."),
    ],
    mesh: Annotated[bool, typer.Option("--mesh", help="A .ply is the surface as triangles, not points.")] = False,
    box: Annotated[
        tuple[float, float, float, float, float, float] | None,
        typer.Option(metavar="X0 Y0 Z0 X1 Y1 Z1", help="Only what is in this box, in m, in whole voxels."),
    ] = None,
    crs: Annotated[
        str | None,
        typer.Option(metavar="EPSG:NNNN", help="Coordinate system that a .las or .laz says it is in; east, north, up."),
    ] = None,
    offset: Offset = None,
    overwrite: Overwrite = False,
) -> None:
    """Write a map in other formats; the suffix says which.

    A .las or .laz lies at --offset, where the map's origin is in surveyed coordinates; where nothing is said, at
    world.origin_m of the summary.json beside the map, if it has that. The other formats keep the map's own coordinates.

    Each file is written whole or not at all. The exit code is 0 when all are written, 1 when one cannot be, 2 for wrong
    input, 130 after Ctrl-C.
    """
    from companion.cli.maps.export import export_map

    export_map(source, targets, mesh=mesh, box_m=box, crs=crs, offset_m=offset, overwrite=overwrite)


@app.command()
def merge(
    sources: Annotated[list[Path], typer.Argument(metavar="MAP MAP...", help="Two maps or more, as for info.")],
    out: Annotated[Path, typer.Option("--out", "-o", metavar="TARGET", help="New folder NAME.journal, or a .ot file.")],
    overwrite: Overwrite = False,
) -> None:
    """Add several maps of the same place into one.

    What the maps say of a voxel is added, then clamped; the order does not matter. They must have the same voxel size,
    frame and clamps. The exit code is 0 when the map is written, 1 when it cannot be, 2 when the maps do not go
    together or the input is wrong, 130 after Ctrl-C.
    """
    from companion.cli.maps.merge import merge_maps

    merge_maps(sources, out, overwrite=overwrite)


@app.command()
def view(
    source: Source,
    port: Annotated[int, typer.Option(min=1, max=65535, metavar="N", help="Port of the page.")] = 8080,
    host: Annotated[
        str, typer.Option(metavar="ADDRESS", help="Who may open it; 0.0.0.0 is everyone in the network.")
    ] = "127.0.0.1",
    points: Annotated[
        int, typer.Option(min=1000, metavar="N", help="Most points shown; larger maps are shown coarser.")
    ] = 1_000_000,
    picture: Annotated[
        Path | None, typer.Option(metavar="FILE.png", help="Draw plan and sections into a file instead.")
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Show a map in a browser, or draw it into a picture.

    The page needs no network beyond this machine. Ctrl-C ends it, with the exit code 130.
    """
    from companion.cli.maps.view import draw_picture, show_in_browser

    if picture is not None:
        draw_picture(source, picture, overwrite=overwrite)
    else:
        show_in_browser(source, host, port, points)
