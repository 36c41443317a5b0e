"""The command `companion sitl world`."""

from __future__ import annotations

import asyncio
import logging
import math
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from companion.cli.options import Config, Preset
from companion.clock import MonotonicClock
from companion.config.load import load
from companion.errors import EXIT_INTERRUPTED, CompanionError, InputError
from sitl.cli.mesh_options import DEFAULT_CLOUD_VOXEL_M, CloudVoxel, Scale, UpAxis
from sitl.mines.placing import Reading
from sitl.world.connection import PeerUrl
from sitl.world.mavlink_out import Feed, LocalFrame
from sitl.world.neighbours import Neighbourhood
from sitl.world.odometry import Align, OdometrySettings
from sitl.world.placement import Scene
from sitl.world.server import CONTACT, INTERRUPTED, Plan, WorldServer
from sitl.world.trouble import KNOWN
from sitl.world.truth_messages import TruthKind

SEVERAL = "side by side, as `companion sim --vehicles` starts them"


class ContactError(CompanionError):
    """The vehicle touched the mine."""


def world(
    world: Annotated[
        str,
        typer.Option(metavar="NAME|MESH", help="complex, slope, room, random, random:K, hazard:NAME, or a mesh file."),
    ] = "complex",
    seed: Annotated[int, typer.Option(min=0, metavar="N", help="Draws start and noise.")] = 1,
    truth: Annotated[
        str,
        typer.Option(
            metavar="URL",
            help="The autopilot: udp://HOST:PORT listens there (PX4 SIH tells the truth to 19410); udpout://HOST:PORT "
            "and tcp://HOST:PORT go there (ArduPilot SITL: tcp, 5760 or 5762).",
        ),
    ] = "udp://127.0.0.1:14560",
    truth_from: Annotated[
        TruthKind,
        typer.Option(help="hil: HIL_STATE_QUATERNION; sim: SIM_STATE; local: what the autopilot itself believes."),
    ] = TruthKind.AUTO,
    truth_hz: Annotated[
        float, typer.Option(min=10.0, max=250.0, metavar="HZ", help="How often truth is wanted.")
    ] = 50.0,
    system_id: Annotated[int, typer.Option(min=1, max=255, metavar="N", help="MAVLink number of the vehicle.")] = 1,
    stream: Annotated[
        str, typer.Option(metavar="URL", help="Where depth and ranges are offered: tcp://HOST:PORT or unix:///PATH.")
    ] = "tcp://127.0.0.1:14600",
    start: Annotated[
        tuple[float, float, float, float] | None,
        typer.Option(
            metavar="X Y Z YAW",
            help="Start in m (a mesh: its own unit and origin) and rad, not the world's own; stands on the floor.",
        ),
    ] = None,
    scale: Scale = None,
    up: UpAxis = None,
    cloud_voxel: CloudVoxel = DEFAULT_CLOUD_VOXEL_M,
    vehicle: Annotated[int, typer.Option(min=1, metavar="K", help=f"Which of several {SEVERAL}.")] = 1,
    config: Config = None,
    preset: Preset = None,
    odometry: Annotated[
        Feed, typer.Option(help="Visual odometry for the autopilot, as ODOMETRY or as VISION_POSITION and _SPEED.")
    ] = Feed.NONE,
    odometry_to: Annotated[
        str | None,
        typer.Option(
            metavar="URL",
            help="Who passes it on, the gate with safety.attached: udpout://HOST:PORT. Else it goes to --truth.",
        ),
    ] = None,
    odometry_hz: Annotated[float, typer.Option(metavar="HZ", help="30 for PX4, 50 for ArduPilot.")] = 30.0,
    odometry_noise: Annotated[float, typer.Option(metavar="M", help="Of each position axis.")] = 0.01,
    odometry_attitude_noise: Annotated[float, typer.Option(metavar="RAD", help="Of each attitude angle.")] = 0.003,
    odometry_velocity_noise: Annotated[float, typer.Option(metavar="M/S", help="Of each velocity axis.")] = 0.03,
    odometry_drift: Annotated[float, typer.Option(metavar="SHARE", help="Drift as a share of the way flown.")] = 0.005,
    odometry_delay: Annotated[float, typer.Option(metavar="SECONDS", help="From exposure to sending.")] = 0.0,
    odometry_loss: Annotated[float, typer.Option(metavar="SHARE", help="Estimates that are never sent.")] = 0.0,
    odometry_outage: Annotated[
        tuple[float, float] | None,
        typer.Option(metavar="BEGIN LENGTH", help="Blind from BEGIN s after its first estimate, for LENGTH s."),
    ] = None,
    odometry_frame: Annotated[
        LocalFrame,
        typer.Option(help="What PX4 is told of the frame of ODOMETRY (ArduPilot takes local_frd alone)."),
    ] = LocalFrame.LOCAL_NED,
    odometry_align: Annotated[
        Align, typer.Option(help="x of its frame: the heading at the start, as real trackers, or north.")
    ] = Align.START,
    no_gps: Annotated[
        bool,
        typer.Option(
            "--no-gps", help="The autopilot has no GPS: tell it an origin on the globe (not PX4 with local_frd)."
        ),
    ] = False,
    send_distance_sensor: Annotated[
        bool, typer.Option("--send-distance-sensor", help="The beams also go to the autopilot.")
    ] = False,
    send_obstacle_distance: Annotated[
        bool, typer.Option("--send-obstacle-distance", help="What is known all around also goes to the autopilot.")
    ] = False,
    stop_on_contact: Annotated[
        bool, typer.Option("--stop-on-contact", help="End when the vehicle touches the mine.")
    ] = False,
    score: Annotated[
        Path | None, typer.Option(metavar="FILE", help="JSON with what really happened, kept up to date.")
    ] = None,
    trajectory: Annotated[Path | None, typer.Option(metavar="FILE", help="CSV with the true trajectory.")] = None,
    control: Annotated[
        int | None,
        typer.Option(min=1, max=65535, metavar="PORT", help=f"UDP on loopback: {KNOWN}."),
    ] = None,
    neighbours_port: Annotated[
        int | None,
        typer.Option(
            min=1, max=65535, metavar="PORT", help="UDP on loopback: where the worlds of other vehicles are heard."
        ),
    ] = None,
    neighbour: Annotated[
        list[int] | None,
        typer.Option(metavar="PORT", help="That of another vehicle's world; may be repeated. They see each other."),
    ] = None,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="A line every 10 s.")] = False,
) -> None:
    """Show a simulated vehicle a mine: depth and ranges where it truly is, and odometry for its autopilot.

    Runs until Ctrl-C. Where the vehicle first is, that is the start in the mine. The exit code is 0 after SIGTERM, 1
    after a contact with --stop-on-contact, 2 for wrong input, 130 after Ctrl-C.
    """
    # stderr, so that what a program reads on stdout stays its own.
    logging.basicConfig(level=logging.INFO if verbose else logging.WARNING, format="%(message)s")
    plan = Plan(
        truth=PeerUrl.of_truth(truth),
        stream_url=stream,
        system_id=system_id,
        truth_from=truth_from,
        truth_hz=truth_hz,
        feed=odometry,
        odometry=OdometrySettings(
            rate_hz=odometry_hz,
            position_noise_m=odometry_noise,
            attitude_noise_rad=odometry_attitude_noise,
            velocity_noise_mps=odometry_velocity_noise,
            drift_share=odometry_drift,
            delay_s=odometry_delay,
            loss_share=odometry_loss,
            outage_s=odometry_outage,
            align=odometry_align,
        ),
        odometry_to=None if odometry_to is None else PeerUrl.of_odometry(odometry_to),
        frame=odometry_frame,
        gps=not no_gps,
        send_distance_sensor=send_distance_sensor,
        send_obstacle_distance=send_obstacle_distance,
        stop_on_contact=stop_on_contact,
        score=score,
        trajectory=trajectory,
        control_port=control,
        neighbourhood=_neighbourhood(system_id, neighbours_port, neighbour or []),
        verbose=verbose,
    )
    if plan.feed is not Feed.NONE and plan.truth_from is TruthKind.LOCAL:
        raise InputError(
            "--truth-from local with --odometry: the odometry would be made of the estimate that is made of it"
        )
    if plan.feed is Feed.NONE and plan.odometry_to is not None:
        raise InputError(f"--odometry-to {odometry_to}: needs --odometry odometry or --odometry vision")
    if plan.feed is not Feed.NONE and odometry_hz > 1.1 * truth_hz:
        raise InputError(f"--odometry-hz {odometry_hz:g}: needs truth as often, --truth-hz is {truth_hz:g}")
    if start is not None and not all(map(math.isfinite, start)):
        raise InputError("--start: must be four finite numbers, x y z in m and yaw in rad")
    if vehicle > 1 and start is not None:
        raise InputError(f"--vehicle {vehicle} with --start: give each its own --start, without --vehicle")
    reading = Reading(scale, up, cloud_voxel)
    settings = load(config, preset).settings
    console = Console()

    def say(text: str) -> None:
        console.print(text, highlight=False, soft_wrap=True, markup=False)

    with console.status("preparing the mine (the very first time compiles the fast parts, about half a minute)"):
        scene = Scene.load(world, seed, start, settings, vehicle, reading)
        for remark in scene.remarks:
            say(remark)
        server = WorldServer(scene, settings, seed, plan, MonotonicClock(), say)
    asyncio.run(server.run())
    say(server.summary())
    if server.ended_because == CONTACT:
        raise ContactError("the vehicle touched the mine")
    if server.ended_because == INTERRUPTED:
        raise typer.Exit(EXIT_INTERRUPTED)


def _neighbourhood(number: int, port: int | None, others: list[int]) -> Neighbourhood | None:
    if port is None and not others:
        return None
    if port is None:
        raise InputError(f"--neighbour {others[0]}: needs --neighbours-port, where the others are heard")
    for other in others:
        if not 0 < other < 65536 or other == port:
            raise InputError(f"--neighbour {other}: must be the --neighbours-port of another world, from 1 to 65535")
    return Neighbourhood(number, port, tuple(others))
