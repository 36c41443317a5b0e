"""The command `companion sitl fly`."""

from __future__ import annotations

import signal
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import typer

from companion.errors import CompanionError, InputError
from sitl.cli.mesh_options import DEFAULT_CLOUD_VOXEL_M, CloudVoxel, Scale, UpAxis
from sitl.launch.fleet import Seat, seats
from sitl.launch.processes import (
    Crew,
    FlightPlan,
    free_tcp_ports,
    free_udp_ports,
    run_all_to_their_ends,
    run_to_its_end,
)
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
            "--link",
            metavar="ENDPOINT",
            help="Let the ground watch and command here, such as tcp/127.0.0.1:7447; several take ports from it on.",
        ),
    ] = None,
    vehicles: Annotated[int, typer.Option(min=1, metavar="N", help="How many fly in the mine.")] = 1,
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
    if real and vehicles > 1:
        raise InputError(f"--vehicles {vehicles}: --real flies one; several real ones need a network each")
    reading = Reading(scale, up, cloud_voxel)
    # Whether there is room for them is known before anything is written.
    places: tuple[Seat, ...] = ()
    if vehicles > 1:
        places = seats(world, reading, seed, "flight", _endpoints(link, vehicles), free_udp_ports(vehicles))
    gps = "nogps" if no_gps else "gps"
    with new_folder(default_folder(f"{personality}-{gps}") if out is None else out) as folder:
        pass
    target = folder.target
    plan = FlightPlan(
        folder=target,
        personality=personality,
        gps=not no_gps,
        world=world,
        mesh=reading.options(),
        seed=seed,
        time_limit_s=time_limit,
        autopilot=() if boot_s is None else ("--boot-s", f"{boot_s:g}"),
        real=find(personality) if real else None,
        settings=None if link is None else {"link": {"enabled": True, "listen": [link]}},
    )
    if vehicles > 1:
        _fly_several(plan, places)
        return
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


def _endpoints(first: str | None, vehicles: int) -> list[str]:
    """Where the links of several vehicles listen: from a port on, or anywhere on loopback.

    Raises:
        InputError: there is no port in it.
    """
    if first is None:
        return [f"tcp/127.0.0.1:{port}" for port in free_tcp_ports(vehicles)]
    place, _, port = first.rpartition(":")
    if not port.isdecimal():
        raise InputError(f"--link {first}: it ends in no port, such as tcp/127.0.0.1:7447")
    return [f"{place}:{int(port) + k}" for k in range(vehicles)]


def _fly_several(plan: FlightPlan, places: Sequence[Seat]) -> None:
    """Fly several vehicles at once, each with its processes and a folder ``vehicle-K``."""
    typer.echo(f"starting {len(places)} autopilots and worlds (the first time on a computer takes about a minute)")
    crews = []
    for seat in places:
        folder = plan.folder / f"vehicle-{seat.number}"
        folder.mkdir()
        crews.append(Crew(replace(plan, folder=folder, seat=seat, settings=None)))
    with ExitStack() as stack:
        for crew in crews:
            stack.enter_context(crew)
        logs = [crew.plan.folder / "application.log" for crew in crews]
        typer.echo(f"they fly; what each says is in {plan.folder}/vehicle-*/application.log")
        codes = run_all_to_their_ends([crew.application("--fix") for crew in crews], logs)
        for crew in crews:
            crew.check()
    touched = collided = 0
    for crew, code in zip(crews, codes, strict=True):
        score = crew.score()
        touched += score["contacts"]
        collided += score["collisions"]
        typer.echo(
            f"{crew.plan.folder.name}: exit code {code}; truth: {score['path_length_m']:.0f} m flown, "
            f"least distance to a wall {_metres(score['least_d_m'])}, {score['contacts']} contacts, to another vehicle "
            f"{_metres(score['least_distance_between_vehicles_m'])}, {score['collisions']} collisions"
        )
    typer.echo(f"everything is in {plan.folder}")
    if collided or touched:
        raise FlightFailedError("vehicles collided" if collided else "a vehicle touched a wall")
    worst = next((code for code in codes if code), 0)
    if worst < 0:
        raise FlightFailedError(f"a gate was ended by signal {-worst} ({signal.strsignal(-worst)})")
    if worst:
        raise typer.Exit(worst)


def _metres(value: float | None) -> str:
    return "not known" if value is None else f"{value:.2f} m"
