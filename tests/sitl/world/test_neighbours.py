"""Worlds of several vehicles in one mine."""

from __future__ import annotations

import math
import socket
import struct
from contextlib import AsyncExitStack

import numpy as np
import pytest

from companion.config.load import load
from companion.errors import InputError
from companion.model import Pose
from companion.pipeline import spacing
from sitl.cli.world import _neighbourhood
from sitl.launch.processes import free_udp_ports
from sitl.mines import load_world
from sitl.scene.fellows import Body
from sitl.scene.live import LiveWorld
from sitl.scene.raycast import RayCaster
from sitl.world.neighbours import PERIOD_S, Neighbourhood, Neighbours
from tests.shared.beside import until

SETTINGS = load(None, "flight").settings
CAMERA = SETTINGS.sensors.camera.model()
BODY = Body(0.35, 0.3)
HERE = Pose(1.0, 0.0, 0.0, 1.5, 0.0)


@pytest.fixture(scope="module")
def room() -> tuple[LiveWorld, LiveWorld]:
    world = load_world("room", 1)
    caster = RayCaster(world)
    return LiveWorld(world, caster, CAMERA, BODY), LiveWorld(world, caster, CAMERA, BODY)


def seen_m(live: LiveWorld, number: int) -> float:
    """The nearest that a vehicle at `HERE` sees, before rock 5 m away."""
    rock = np.full((CAMERA.height_px, CAMERA.width_px), 5.0, np.float32)
    return float(live.image(HERE, rock, np.random.default_rng(1), number).min())


async def test_they_see_each_other_and_the_distance_is_kept(room: tuple[LiveWorld, LiveWorld]) -> None:
    """The whole way over two ports: one is in the other's image, and how near they came is in both scores."""
    ports = free_udp_ports(2)
    worlds = [Neighbours(1 + k, BODY, spacing(SETTINGS), live) for k, live in enumerate(room)]
    assert worlds[0].figures() == {"least_distance_between_vehicles_m": None, "collisions": 0}
    async with AsyncExitStack() as stack:
        for k, one in enumerate(worlds):
            await stack.enter_async_context(one.heard(Neighbourhood(1 + k, ports[k], (ports[1 - k],))))
        worlds[1].moved(Pose(1.0, 3.0, 0.0, 1.5, 1.0))
        await until(lambda: seen_m(room[0], 1) < 3.0, "the other one in the image")
        worlds[0].moved(HERE)
        # More often than that nobody is told.
        worlds[1].moved(Pose(1.0 + 0.5 * PERIOD_S, 2.5, 0.0, 1.5, 1.0))
        worlds[0].moved(HERE)
        assert worlds[0].figures() == {"least_distance_between_vehicles_m": 3.0, "collisions": 0}
        worlds[1].moved(Pose(1.0 + 2.0 * PERIOD_S, 0.5, 0.0, 1.5, 1.0))
        await until(lambda: seen_m(room[0], 1) < 1.0, "it, nearer")
        worlds[0].moved(HERE)
        worlds[0].moved(HERE)
        assert worlds[0].figures() == {"least_distance_between_vehicles_m": 0.5, "collisions": 1}


def test_what_is_no_place_of_another_one_is_ignored(room: tuple[LiveWorld, LiveWorld]) -> None:
    """Cut, of another program, its own, and NaN."""
    one = Neighbours(1, BODY, spacing(SETTINGS), room[0])
    place = struct.Struct("<4sB5d")
    for data in (
        b"",
        place.pack(b"MCNB", 2, 0.0, 1.0, 0.0, 1.5, 0.0)[:-1],
        place.pack(b"XXXX", 2, 0.0, 1.0, 0.0, 1.5, 0.0),
        place.pack(b"MCNB", 1, 0.0, 1.0, 0.0, 1.5, 0.0),
        place.pack(b"MCNB", 2, 0.0, math.nan, 0.0, 1.5, 0.0),
        place.pack(b"MCNB", 2, 0.0, 1.0, 0.0, math.inf, 0.0),
    ):
        one.on_message(data)
    one.moved(HERE)
    assert one.figures()["least_distance_between_vehicles_m"] is None


async def test_a_port_that_is_taken_is_told(room: tuple[LiveWorld, LiveWorld]) -> None:
    """With its number."""
    (port,) = free_udp_ports(1)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", port))
        with pytest.raises(InputError, match=f"--neighbours-port {port}"):
            async with Neighbours(1, BODY, spacing(SETTINGS), room[0]).heard(Neighbourhood(1, port, ())):
                raise AssertionError


def test_options_that_cannot_be_meant_are_refused() -> None:
    """No place to hear them, and its own port."""
    assert _neighbourhood(1, None, []) is None
    assert _neighbourhood(2, 5000, [5001]) == Neighbourhood(2, 5000, (5001,))
    for port, others in ((None, [5001]), (5000, [5000]), (5000, [0])):
        with pytest.raises(InputError, match="--neighbour"):
            _neighbourhood(1, port, others)
