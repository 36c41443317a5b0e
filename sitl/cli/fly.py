"""The command `companion sitl fly`."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import Annotated, Literal

import typer

from companion.errors import CompanionError, InputError
from sitl.cli.mesh_options import DEFAULT_CLOUD_VOXEL_M, CloudVoxel, Scale, UpAxis
from sitl.launch.processes import Crew, FlightPlan, run_to_its_end
from sitl.launch.real import find
from sitl.mines.placing import Reading


class FlightFailedError(CompanionError):
    """The flight did not end as it should: the application said why, or a wall was touched."""


def fly(
    personality: Annotated[Literal["px4", "ardupilot"], typer.Option(help="Which autopilot to be.")] = "px4",
    no_gps: Annotated[bool, typer.Option("--no-gps", help="Visual odometry instead of GPS.")] = False,
    world: Annotated[
        str,
        typer.Option(metavar="NAME|MESH", help="complex, slope, room, random, random:K, hazard:NAME, or a mesh file."),
    ] = "room",
    scale: Scale = None,
    up: UpAxis = None,
    cloud_voxel: CloudVoxel = DEFAULT_CLOUD_VOXEL_M,
    seed: Annotated[int, typer.Option(min=0, metavar="N", help="Draws start, noise and every choice.")] = 1,
    time_limit: Annotated[float, typer.Option(min=1.0, metavar="SECONDS", help="Of the exploring.")] = 1200.0,
    boot_s: Annotated[
        float | None, typer.Option(min=0.0, metavar="SECONDS", help="Until the autopilot arms; else as the real one.")
    ] = None,
    real: Annotated[
        bool,
        typer.Option("--real", help="The autopilot that PX4_BINARY or ARDUCOPTER_BINARY names, not the stub."),
    ] = False,
    link: Annotated[
        str | None,
        typer.Option(
            "--link", metavar="ENDPOINT", help="Let the ground watch and command here, such as tcp/127.0.0.1:7447."
        ),
    ] = None,
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="New folder; else one under runs/.")] = None,
) -> None:
    """Fly the application over MAVLink in real time: autopilot, world, gate and application as processes of their own.

    Leaves recording, map, logs and the truth in a folder. The exit code is 0 when the map is complete and no wall was
    touched, 1 when the flight ended otherwise, 2 for wrong input, 130 after Ctrl-C.
    """
    # It brings the drawing library, for which the other commands of this group need not wait.
    from sitl.report.run_folder import default_folder, new_folder

    if real and boot_s is not None:
        raise InputError(f"--boot-s {boot_s:g}: --real boots in its own time")
    gps = "nogps" if no_gps else "gps"
    with new_folder(default_folder(f"{personality}-{gps}") if out is None else out) as folder:
        pass
    target = folder.target
    plan = FlightPlan(
        folder=target,
        personality=personality,
        gps=not no_gps,
        world=world,
        mesh=Reading(scale, up, cloud_voxel).options(),
        seed=seed,
        time_limit_s=time_limit,
        autopilot=() if boot_s is None else ("--boot-s", f"{boot_s:g}"),
        real=find(personality) if real else None,
        settings=None if link is None else {"link": {"enabled": True, "listen": [link]}},
    )
    typer.echo("starting the autopilot and the world (the first time on a computer takes about a minute)")
    with Crew(plan) as crew:
        for line in crew.about_the_mine():
            typer.echo(line)
        if not real:
            typer.echo(
                f"faults: send takeover, battery PERCENT or gps on|off to UDP port {crew.control_port} on loopback"
            )
        code = run_to_its_end(crew.application("--fix"))
        crew.check()
    score = crew.score()
    typer.echo(
        f"truth: {score['path_length_m']:.0f} m flown, least distance to a wall {_metres(score['least_d_m'])}, "
        f"{score['contacts']} contacts; everything is in {target}"
    )
    if code < 0:
        raise FlightFailedError(f"the gate was ended by signal {-code} ({signal.strsignal(-code)})")
    if code != 0:
        raise typer.Exit(code)
    if score["contacts"]:
        raise FlightFailedError("the vehicle touched a wall")


def _metres(value: float | None) -> str:
    return "not known" if value is None else f"{value:.2f} m"
