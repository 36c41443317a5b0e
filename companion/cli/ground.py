"""The command `companion ground`."""

from __future__ import annotations

import os
import webbrowser
from pathlib import Path
from typing import Annotated

import typer

from companion.config.link import is_this_computer
from companion.errors import InputError

VEHICLE = "tcp/127.0.0.1:7447"
"""Where a vehicle waits by default (`link.listen`)."""

Endpoints = list[str]


def ground(
    connect: Annotated[
        Endpoints | None,
        typer.Option(
            "--connect",
            metavar="ENDPOINT",
            help=f"Where a vehicle waits, such as tls/10.0.0.5:7447; may be repeated. Else {VEHICLE}.",
        ),
    ] = None,
    listen: Annotated[
        Endpoints | None,
        typer.Option("--listen", metavar="ENDPOINT", help="Where to wait for vehicles; may be repeated."),
    ] = None,
    certificates: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="The operator's, as companion keys operator makes them; without: on loopback only."
        ),
    ] = None,
    folder: Annotated[Path, typer.Option(metavar="DIR", help="Keeps the maps; what is there is gone on from.")] = Path(
        "ground"
    ),
    name: Annotated[
        str, typer.Option(metavar="NAME", help="Of the operator, where no certificate says it.")
    ] = "operator",
    port: Annotated[int, typer.Option(min=1, max=65535, metavar="N", help="Port of the page.")] = 8080,
    host: Annotated[
        str, typer.Option(metavar="ADDRESS", help="Who may open the page; 0.0.0.0 is everyone in the network.")
    ] = "127.0.0.1",
    points: Annotated[
        int, typer.Option(min=1000, metavar="N", help="Most points shown; larger maps are shown coarser.")
    ] = 1_000_000,
    show: Annotated[bool, typer.Option("--show", help="Open the page in this computer's browser.")] = False,
) -> None:
    """Watch and command vehicles on one page: their maps as they grow, how they are, and STOP.

    The page needs no network beyond this machine and opens in any browser, on a tablet too. Where --host lets others
    open it, whoever commands types a code once that is printed at the start; to watch and to STOP needs none. Ctrl-C
    ends it, with the exit code 130; vehicles fly on.
    """
    from companion.cli.maps.extra import of_the_extra

    with of_the_extra("companion ground"):
        from companion.ground.access import new_code
        from companion.ground.page import serve
        from companion.viewer.serving import reached_at
    from companion.config.link import NAME_FORM, is_name
    from companion.link.ground.station import LinkStation

    if not is_name(name):
        raise InputError(f"--name {name!r}: an operator is called by {NAME_FORM}")
    if folder.exists() and not folder.is_dir():
        raise InputError(f"--folder {folder}: is no folder")
    connect = [VEHICLE] if not connect and not listen else connect or []
    code = None if is_this_computer(host) else new_code()
    with (
        LinkStation(folder, listen or [], connect, name, certificates) as station,
        serve(station, "Ground", host, port, points, code) as page,
    ):
        address = f"http://{reached_at(host)}:{page.port}"
        typer.echo(f"open {address}; Ctrl-C ends it, and the vehicles fly on")
        if code is not None:
            typer.echo(f"code for commands: {code}")
        if show and any(os.environ.get(screen) for screen in ("DISPLAY", "WAYLAND_DISPLAY")):
            webbrowser.open(address)
        page.run()
