"""One flight in the open in which a real autopilot is brought to speed and stopped, and turned, again and again."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from sitl.autopilot.mavlink import dialect as m
from sitl.launch.processes import (
    WORLD_SERVES,
    command,
    free_tcp_port,
    free_udp_ports,
    odometry_options,
    write_settings,
)
from sitl.launch.program import Program, Running
from sitl.launch.real import RealAutopilot
from tests.integration.relay import LOOPBACK, UdpRelay
from tests.shared.beside import wait_until
from validation.fault_matrix.standstill import Standstill
from validation.fault_matrix.true_way import TrueWay
from validation.real.manoeuvres import HEIGHT_M, SETTLE_S, TURN_AT_MPS, Manoeuvres, Order, Stopped, Turned, settings_at
from validation.real.sortie import COMPANION, streaming, take_off
from validation.real.station import Station
from validation.real.truth import TruthListener

START_S, HEARTBEATS_S = 60.0, 30.0
ATTITUDE_US = 20_000.0
CAMERA = {"width_px": 32, "height_px": 24, "rate_hz": 5.0}
"""Nobody looks."""
NICENESS = -10
"""The autopilot does not wait for what else runs on this computer."""


@dataclass(frozen=True, slots=True)
class Sortie:
    """What is to be flown.

    Attributes:
        speeds_mps: each is stopped from in every way, and flown diagonally.
        yaw_rates_radps: each is turned with on the spot and at `TURN_AT_MPS`.
        gps: False: by external odometry.
        parameters: of the autopilot, set before it boots.
    """

    speeds_mps: Sequence[float]
    yaw_rates_radps: Sequence[float]
    gps: bool
    parameters: Mapping[str, float]


def fly(real: RealAutopilot, sortie: Sortie, folder: Path) -> Iterator[Stopped | Turned]:
    """What comes of every manoeuvre of a flight, one after the other.

    Args:
        real: the autopilot.
        sortie: what to fly.
        folder: for its files; exists.

    Raises:
        CrewError: the autopilot did not start, or the world.
        AssertionError: the flight went otherwise than it must.
    """
    ports = real.ports
    program = real.program(folder, settings_at(max(sortie.speeds_mps), sortie.gps), sortie.parameters)
    with (
        Station(ports.ground) as ground,
        Station(ports.application, keep=("ATTITUDE",)) as companion,
        _true_way(real, sortie, folder) as way,
        _running(program, folder) as running,
    ):
        companion.beating = False
        wait_until(lambda: ground.beats and companion.beats, "heartbeats come", HEARTBEATS_S)
        take_off(real.personality, ground, way, HEIGHT_M)
        companion.command(m.MAV_CMD_SET_MESSAGE_INTERVAL, m.MAVLINK_MSG_ID_ATTITUDE, ATTITUDE_US, sender=COMPANION)
        wait_until(lambda: companion.heard, "the autopilot tells its attitude", HEARTBEATS_S)
        time.sleep(SETTLE_S)
        with (
            streaming(companion) as stream,
            Standstill({"the autopilot": running.process.pid}) as standstill,
        ):
            flown = Manoeuvres(real.personality, sortie.gps, ground, companion, way, stream, standstill)
            yield from _stops(flown, sortie)
            yield from _turns(flown, sortie)


@contextlib.contextmanager
def _true_way(real: RealAutopilot, sortie: Sortie, folder: Path) -> Iterator[TrueWay]:
    """Where it truly is; without GPS a world listens too, and makes odometry of it."""
    if sortie.gps:
        with TruthListener(real.ports.world) as truth:
            yield truth.way
        return
    (port,) = free_udp_ports(1)
    config = folder / "vehicle.yaml"
    write_settings(config, "flight", {"sensors": {"camera": CAMERA}})
    options = (
        *("--world", "room", "--config", str(config), "--stream", f"tcp://{LOOPBACK}:{free_tcp_port()}"),
        *("--truth", f"udp://{LOOPBACK}:{port}", *odometry_options(real.personality)),
    )
    way = TrueWay()
    with UdpRelay(port, port=real.ports.world) as relay:
        relay.alter_down = lambda message: way.hear(message, time.monotonic())
        with _running(Program("world", (*command("sitl", "world"), *options), WORLD_SERVES), folder):
            yield way


@contextlib.contextmanager
def _running(program: Program, folder: Path) -> Iterator[Running]:
    running = Running(program, folder, NICENESS)
    try:
        running.wait(START_S)
        yield running
    finally:
        running.end()


def _stops(flown: Manoeuvres, sortie: Sortie) -> Iterator[Stopped]:
    for asked_mps in sortie.speeds_mps:
        flown.demand(asked_mps)
        for order in Order:
            yield flown.stopped(order, asked_mps, diagonal=False)
        yield flown.stopped(Order.LED_BACK, asked_mps, diagonal=True)


def _turns(flown: Manoeuvres, sortie: Sortie) -> Iterator[Turned]:
    for asked_radps in sortie.yaw_rates_radps:
        for asked_mps in (0.0, TURN_AT_MPS):
            yield flown.turned(asked_mps, asked_radps)
