"""The command `companion sitl ground`."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Annotated

import typer

from sitl.launch.processes import Crew, FlightPlan, command, free_tcp_port, run_to_its_end
from sitl.launch.program import Program, Running

PAGE_SERVES = "open http"
"""What `companion ground` says when its page can be opened."""

PAGE_TIMEOUT_S = 120.0


def ground(
    world: Annotated[
        str,
        typer.Option(metavar="NAME|MESH", help="complex, slope, room, random, random:K, hazard:NAME, or a mesh file."),
    ] = "complex",
    seed: Annotated[int, typer.Option(min=0, metavar="N", help="Draws start, noise and every choice.")] = 1,
    preset: Annotated[str, typer.Option(metavar="NAME", help="Preset of the vehicle.")] = "swift",
    time_limit: Annotated[float, typer.Option(min=1.0, metavar="SECONDS", help="Of the exploring.")] = 1800.0,
    port: Annotated[int, typer.Option(min=1, max=65535, metavar="N", help="Port of the page.")] = 8080,
    host: Annotated[str, typer.Option(metavar="ADDRESS", help="Who may open the page, as of companion ground.")] = (
        "127.0.0.1"
    ),
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="New folder; else one under runs/.")] = None,
) -> None:
    """See a map grow: fly the stub in a simulated mine, over the link, with the operator's page open.

    The vehicle takes off by itself; the buttons of the page are for it. After the flight the page stays, with the map,
    until Ctrl-C. The exit code is that of the flight, 130 after Ctrl-C.
    """
    # It brings the drawing library, for which the other commands of this group need not wait.
    from sitl.report.run_folder import default_folder, new_folder

    with new_folder(default_folder("ground") if out is None else out) as folder:
        pass
    target = folder.target
    endpoint = f"tcp/127.0.0.1:{free_tcp_port()}"
    plan = FlightPlan(
        folder=target,
        world=world,
        seed=seed,
        time_limit_s=time_limit,
        preset=preset,
        settings={"link": {"enabled": True, "name": "Kobold", "listen": [endpoint]}},
    )
    page = Program(
        "ground",
        (
            *command("ground", "--connect", endpoint, "--folder", str(target / "ground"), "--show"),
            *("--port", str(port), "--host", host),
        ),
        PAGE_SERVES,
    )
    typer.echo("starting the page, the autopilot and the mine (the first time on a computer takes about a minute)")
    with contextlib.ExitStack() as stack:
        shown = Running(page, target)
        stack.callback(shown.end)
        shown.wait(PAGE_TIMEOUT_S)
        typer.echo(shown.said().strip())
        with Crew(plan) as crew:
            code = run_to_its_end(crew.application("--fix"))
            crew.check()
        typer.echo(f"the flight is over: everything is in {target}. The page stays until Ctrl-C")
        shown.process.wait()
    raise typer.Exit(code)
