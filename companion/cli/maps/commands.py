"""The commands for maps that are files: `companion map info`, `export`, `merge`, `build` and `view`.

What they need is imported when they run: the help must not wait for it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from companion.cli.options import AsJson, Config, Preset

Source = Annotated[
    Path,
    typer.Argument(
        metavar="MAP",
        help="A journal (map.journal), a mission's folder, a .ot or .bt file, or a point cloud: .ply .pcd .las .laz.",
    ),
]
Offset = Annotated[
    tuple[float, float, float] | None,
    typer.Option(
        metavar="X Y Z",
        help="Where the map's origin is in the coordinates of point clouds, in m: taken from those that are read, "
        "added to a .las or .laz that is written.",
    ),
]
Voxel = Annotated[
    float | None,
    typer.Option(
        min=0.001, max=100.0, metavar="M", help="Edge of the voxels that points are put into, in m; else 0.1."
    ),
]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace what is there.")]

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None, help="Inspect, convert, merge, build and view maps.")


@app.command()
def info(source: Source, as_json: AsJson = False, voxel: Voxel = None, offset: Offset = None) -> None:
    """Print what a map holds: size, sensor model, bounds, volume, surface, damage.

    Of a point cloud a voxel with a point in it is occupied; what is free is not known.

    The exit code is 0 also when a part of the map was damaged and is lost: the table says so. It is 2 when the source
    is no map.
    """
    from companion.cli.maps.clouds import CloudOptions
    from companion.cli.maps.info import show_info

    typer.echo(show_info(source, CloudOptions(voxel, offset), as_json=as_json))


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
    voxel: Voxel = None,
    overwrite: Overwrite = False,
) -> None:
    """Write a map in other formats; the suffix says which.

    A .las or .laz lies at --offset, where the map's origin is in surveyed coordinates; where nothing is said, at
    origin_m of the summary.json beside the map, if it has that. The other formats keep the map's own coordinates.

    Each file is written whole or not at all. The exit code is 0 when all are written, 1 when one cannot be, 2 for wrong
    input, 130 after Ctrl-C.
    """
    from companion.cli.maps.clouds import CloudOptions
    from companion.cli.maps.export import export_map

    clouds = CloudOptions(voxel, offset)
    export_map(source, targets, mesh=mesh, box_m=box, crs=crs, clouds=clouds, overwrite=overwrite)


@app.command()
def merge(
    sources: Annotated[list[Path], typer.Argument(metavar="MAP MAP...", help="Two maps or more, as for info.")],
    out: Annotated[Path, typer.Option("--out", "-o", metavar="TARGET", help="New folder NAME.journal, or a .ot file.")],
    voxel: Voxel = None,
    offset: Offset = None,
    overwrite: Overwrite = False,
) -> None:
    """Add several maps of the same place into one.

    What the maps say of a voxel is added, then clamped; the order does not matter. They must have the same voxel size,
    frame and clamps. Maps of flights of a fleet (fleet.frame in the summary.json beside the map) are put into the frame
    that it shares. Points of a cloud count as occupied for certain, and go into the voxels of the others. The exit code
    is 0 when the map is written, 1 when it cannot be, 2 when the maps do not go together or the input is wrong, 130
    after Ctrl-C.
    """
    from companion.cli.maps.clouds import CloudOptions
    from companion.cli.maps.merge import merge_maps

    merge_maps(sources, out, CloudOptions(voxel, offset), overwrite=overwrite)


@app.command()
def build(
    out: Annotated[
        Path,
        typer.Argument(metavar="TARGET", help="New folder NAME.journal, or a file: .ot .bt .ply .pcd .las .laz."),
    ],
    source: Annotated[
        Path,
        typer.Option("--from", metavar="SOURCE", help="A flight's recording (.mcap), or a data set's folder."),
    ],
    format_: Annotated[
        Literal["tum", "7scenes"] | None,
        typer.Option("--format", help="Of a folder: a sequence of TUM RGB-D or of 7-Scenes."),
    ] = None,
    config: Config = None,
    preset: Preset = None,
    voxel: Annotated[
        float | None, typer.Option(metavar="M", help="Edge of a voxel, in m, instead of mapping.voxel_m.")
    ] = None,
    max_range: Annotated[
        float | None,
        typer.Option(metavar="M", help="Depth that the map believes, in m, instead of mapping.max_range_m."),
    ] = None,
    up: Annotated[
        Literal["x", "y", "z", "-x", "-y", "-z"] | None,
        typer.Option(help="Axis of the data set's world that points up; else z for tum, -y for 7scenes."),
    ] = None,
    intrinsics: Annotated[
        tuple[float, float, float, float] | None,
        typer.Option(metavar="FX FY CX CY", help="The camera, in px; else 525 525 319.5 239.5 or 585 585 320 240."),
    ] = None,
    depth_scale: Annotated[
        float | None,
        typer.Option(min=1.0, max=65535.0, metavar="N", help="Units of the images in a m; else 5000 or 1000."),
    ] = None,
    within: Annotated[
        float | None,
        typer.Option(
            min=0.0, max=10.0, metavar="S", help="Of tum: largest time between an image and its pose; else 0.02."
        ),
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Make a map of recorded depth images and their poses, with the settings of `mapping`.

    A recording of a flight has its own settings, and its map the axes of that flight's. A sequence of TUM RGB-D has
    depth.txt and groundtruth.txt, one of 7-Scenes frame-000000.depth.png and frame-000000.pose.txt; poses are those of
    the camera's optical frame.

    The exit code is 0 when the map is written, 1 when it cannot be, 2 for wrong input, 130 after Ctrl-C.
    """
    from companion.cli.maps.build import build_map
    from companion.cli.maps.readings import DatasetOptions

    options = DatasetOptions(format_, up, intrinsics, depth_scale, within)
    build_map(out, source, options, config, preset, voxel, max_range, overwrite=overwrite)


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
    voxel: Voxel = None,
    offset: Offset = None,
    overwrite: Overwrite = False,
) -> None:
    """Show a map in a browser, or draw it into a picture.

    The page needs no network beyond this machine. Ctrl-C ends it, with the exit code 130.
    """
    from companion.cli.maps.clouds import CloudOptions
    from companion.cli.maps.view import draw_picture, show_in_browser

    clouds = CloudOptions(voxel, offset)
    if picture is not None:
        draw_picture(source, picture, clouds, overwrite=overwrite)
    else:
        show_in_browser(source, host, port, points, clouds)
