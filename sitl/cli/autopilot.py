"""The command `companion sitl autopilot`."""

from __future__ import annotations

import asyncio
import math
import signal
import socket
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from companion.clock import MonotonicClock
from companion.errors import CompanionError, InputError
from companion.mavlink.signing import load_key
from companion.model import Pose
from sitl.autopilot import PERSONALITIES, Autopilot, Personality, Surroundings
from sitl.autopilot.codec import Signing
from sitl.autopilot.endpoint import Address, Endpoint
from sitl.cli.mesh_options import DEFAULT_CLOUD_VOXEL_M, CloudVoxel, Scale, UpAxis
from sitl.mines.placing import Reading

DEFAULT_TO = ("127.0.0.1:14540", "127.0.0.1:14550", "127.0.0.1:14560")
"""Companion computer, ground station, and the process that shows the vehicle its world."""


def autopilot(
    personality: Annotated[str, typer.Option(metavar="px4|ardupilot", help="Which autopilot to be.")] = "px4",
    system_id: Annotated[int, typer.Option(min=1, max=255, metavar="N", help="MAVLink number of the vehicle.")] = 1,
    to: Annotated[
        list[str] | None,
        typer.Option(
            metavar="HOST:PORT",
            help="UDP address to send to; may be repeated. One on another computer lets others send here too. "
            f"[{', '.join(DEFAULT_TO)}]",
        ),
    ] = None,
    bind_port: Annotated[int, typer.Option(min=0, max=65535, metavar="PORT", help="Own UDP port; 0: any.")] = 0,
    tcp: Annotated[int | None, typer.Option(min=1, max=65535, metavar="PORT", help="Serve TCP too.")] = None,
    control: Annotated[
        int | None,
        typer.Option(
            min=1,
            max=65535,
            metavar="PORT",
            help="UDP on loopback: takeover, rc on|off, battery PERCENT, battery volts VOLTS, gps on|off.",
        ),
    ] = None,
    start: Annotated[
        tuple[float, float, float, float] | None,
        typer.Option(metavar="X Y Z YAW", help="True start in the world, in m and rad; it stands on the ground there."),
    ] = None,
    world: Annotated[
        str | None,
        typer.Option(metavar="NAME|MESH", help="Mine to stand and crash in, as for `world`; else level ground."),
    ] = None,
    scale: Scale = None,
    up: UpAxis = None,
    cloud_voxel: CloudVoxel = DEFAULT_CLOUD_VOXEL_M,
    seed: Annotated[int, typer.Option(min=0, metavar="N", help="Draws a random world, noise and disturbance.")] = 1,
    config: Annotated[
        Path | None, typer.Option(metavar="FILE", help="YAML file with settings, as the world has: body and start.")
    ] = None,
    preset: Annotated[str | None, typer.Option(metavar="NAME", help="Preset below the file.")] = None,
    no_gps: Annotated[
        bool, typer.Option("--no-gps", help="No GPS receiver; the parameters are set for external odometry.")
    ] = False,
    boot_s: Annotated[
        float | None, typer.Option(min=0.0, metavar="SECONDS", help="Until it arms with GPS; other waits shrink alike.")
    ] = None,
    battery_percent: Annotated[float, typer.Option(min=0.0, max=100.0, metavar="PERCENT", help="Charge.")] = 100.0,
    battery_minutes: Annotated[
        float, typer.Option(min=0.1, metavar="MINUTES", help="Of flight, full to empty.")
    ] = 15.0,
    param: Annotated[
        list[str] | None, typer.Option(metavar="NAME=VALUE", help="Parameter to begin with; may be repeated.")
    ] = None,
    drop: Annotated[float, typer.Option(min=0.0, max=1.0, metavar="SHARE", help="Packets lost, each way.")] = 0.0,
    speed: Annotated[float, typer.Option(min=0.1, max=20.0, metavar="FACTOR", help="Simulated per real time.")] = 1.0,
    clock_rate: Annotated[
        float,
        typer.Option(min=0.8, max=1.2, metavar="FACTOR", help="Speed of its clock: SIH is 1 to 3 % slow, so 0.98."),
    ] = 1.0,
    signing_key: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Sign everything sent, and accept only what is signed with it.")
    ] = None,
) -> None:
    """Be a PX4 or ArduCopter on the network, with a vehicle made of software.

    Runs until Ctrl-C. SIGUSR1 is a pilot's hand on the mode switch. The exit code is 0 after SIGTERM, 1 when a port is
    taken, 2 for wrong input, 130 after Ctrl-C.
    """
    kind = _personality(personality)
    signing = None if signing_key is None else _signing(signing_key)
    pose, surroundings = _place(world, Reading(scale, up, cloud_voxel), seed, start, config, preset)
    values = dict(_parameter(text) for text in param or [])
    if speed != 1.0 and kind.name == "px4":
        # As PX4's own simulator does, whatever was set.
        values["COM_OF_LOSS_T"] = speed
    vehicle = Autopilot(
        kind,
        pose,
        system_id=system_id,
        surroundings=surroundings,
        gps=not no_gps,
        parameters=values,
        boot_s=boot_s,
        battery_percent=battery_percent,
        battery_minutes=battery_minutes,
        seed=seed,
    )
    addresses = [_address(text) for text in to or DEFAULT_TO]
    endpoint = Endpoint(
        vehicle,
        MonotonicClock(),
        addresses,
        bind=(host_to_listen_on(addresses), bind_port),
        tcp_port=tcp,
        control_port=control,
        drop_share=drop,
        speed=speed,
        clock_rate=clock_rate,
        signing=signing,
    )
    try:
        asyncio.run(_serve(endpoint, kind, addresses))
    except OSError as error:
        raise CompanionError(f"companion sitl autopilot: {error}; is another one running on that port?") from error


def host_to_listen_on(addresses: Sequence[Address]) -> str:
    """Loopback, unless somebody on another computer was named, who can only answer to an address of the network."""
    local = all(host == "localhost" or host.startswith("127.") for host, _ in addresses)
    return "127.0.0.1" if local else "0.0.0.0"  # noqa: S104 - as was asked


async def _serve(endpoint: Endpoint, kind: Personality, addresses: list[Address]) -> None:
    loop = asyncio.get_running_loop()
    task = asyncio.ensure_future(endpoint.run(lambda: typer.echo(_summary(endpoint, kind, addresses))))
    loop.add_signal_handler(signal.SIGTERM, task.cancel)
    loop.add_signal_handler(signal.SIGUSR1, endpoint.autopilot.pilot_takes_over)
    try:
        await asyncio.wait([task])
        if not task.cancelled():
            task.result()
    finally:
        loop.remove_signal_handler(signal.SIGTERM)
        loop.remove_signal_handler(signal.SIGUSR1)


def _summary(endpoint: Endpoint, kind: Personality, addresses: list[Address]) -> str:
    places = " ".join(f"{host}:{port}" for host, port in addresses)
    tcp = "" if endpoint.tcp_port is None else f", TCP server on port {endpoint.tcp_port}"
    pose = endpoint.autopilot.pose
    where = f"{pose.x_m:.2f} {pose.y_m:.2f} {pose.z_m:.2f}"
    return (
        f"{kind.name}, system {endpoint.autopilot.system_id}, standing at {where}: "
        f"UDP from port {endpoint.udp_port} to {places}{tcp}"
    )


def _personality(name: str) -> Personality:
    if name not in PERSONALITIES:
        raise InputError(f"--personality {name}: there are {', '.join(PERSONALITIES)}")
    return PERSONALITIES[name]


def _signing(path: Path) -> Signing:
    try:
        return Signing(load_key(path))
    except (OSError, ValueError) as error:
        raise InputError(f"--signing-key: {error}") from None


def _place(
    world: str | None,
    reading: Reading,
    seed: int,
    start: tuple[float, float, float, float] | None,
    config: Path | None,
    preset: str | None,
) -> tuple[Pose, Surroundings | None]:
    """Where the vehicle stands, and in what."""
    if start is not None and not all(map(math.isfinite, start)):
        raise InputError("--start: must be four numbers, x y z in m and yaw in rad")
    pose = Pose(0.0, 0.0, 0.0, 0.0, 0.0) if start is None else Pose(0.0, *start)
    if world is None:
        return pose, None
    # Only those who want a mine wait for what it needs.
    from companion.config.load import load_settings
    from sitl.autopilot.airframe import inside
    from sitl.world.placement import Scene

    settings = load_settings(config, preset)
    scene = Scene.load(world, seed, start, settings, reading=reading)
    vehicle = settings.vehicle
    return scene.stand, inside(scene.caster, vehicle.body_radius_m, vehicle.body_height_m / 2.0)


def _parameter(text: str) -> tuple[str, float]:
    name, separator, value = text.partition("=")
    try:
        if not separator:
            raise ValueError(text)
        return name.strip(), float(value)
    except ValueError:
        raise InputError(f"--param {text}: must be NAME=VALUE with a number, as in COM_OF_LOSS_T=0.5") from None


def _address(text: str) -> Address:
    host, _, port = text.rpartition(":")
    if not host or not port.isdecimal() or not 0 < int(port) < 65536:
        raise InputError(f"--to {text}: must be HOST:PORT, as in 127.0.0.1:14540")
    try:
        found = socket.getaddrinfo(host, int(port), socket.AF_INET, socket.SOCK_DGRAM)
    except OSError:
        raise InputError(f"--to {text}: there is no host of that name") from None
    return str(found[0][4][0]), int(port)
