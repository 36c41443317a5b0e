"""Several vehicles in one mine: which is which, where each starts, and how they and their worlds hear each other."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from companion.config.load import load_settings
from companion.errors import InputError
from companion.model import Pose
from sitl.mines import load_world
from sitl.mines.placing import Reading
from sitl.scene.raycast import RayCaster
from sitl.sim.start import start_poses


@dataclass(frozen=True, slots=True)
class Seat:
    """One of several vehicles.

    Attributes:
        number: of it, from 1.
        start: where it hovers after take-off, in the mine.
        stand_z_m: z of the middle of its body before.
        endpoints: at which the links of the applications listen, of all vehicles in their order.
        world_ports: on which their worlds do.
    """

    number: int
    start: Pose
    stand_z_m: float
    endpoints: tuple[str, ...]
    world_ports: tuple[int, ...]

    def settings(self) -> dict[str, dict[str, Any]]:
        """The sections `fleet` and `link` of its application: each connects to those before it."""
        start, before = self.start, self.number - 1
        return {
            "fleet": {
                "number": self.number,
                "start_pose": [start.x_m, start.y_m, self.stand_z_m, start.yaw_rad],
            },
            "link": {
                "enabled": True,
                "name": f"vehicle-{self.number}",
                "listen": [self.endpoints[before]],
                "connect": list(self.endpoints[:before]),
            },
        }

    def start_options(self) -> tuple[str, ...]:
        """For `companion sitl autopilot` and `companion sitl world`: where it starts."""
        start = self.start
        return ("--start", *(f"{value:.4f}" for value in (start.x_m, start.y_m, start.z_m, start.yaw_rad)))

    def world_options(self) -> tuple[str, ...]:
        """For `companion sitl world`."""
        own = self.world_ports[self.number - 1]
        others = [part for port in self.world_ports if port != own for part in ("--neighbour", str(port))]
        return (
            *self.start_options(),
            *("--system-id", str(self.number), "--neighbours-port", str(own)),
            *others,
        )


def seats(
    world: str, reading: Reading, seed: int, preset: str, endpoints: list[str], world_ports: list[int]
) -> tuple[Seat, ...]:
    """As many vehicles as there are endpoints, where `companion sim --vehicles` starts them with the same seed.

    Raises:
        InputError: no such world, no room for them to start, or more than can meet in one group.
    """
    settings = load_settings(None, preset)
    vehicles, most = len(endpoints), settings.fleet.largest_group
    if vehicles > most:
        raise InputError(
            f"--vehicles {vehicles}: fleet.largest_group = {most} is the most that the height layers are for"
        )
    mine = load_world(world, seed, None, reading)
    to_start = np.random.SeedSequence(seed).spawn(1)[0]
    starts = start_poses(mine, RayCaster(mine), settings, vehicles, np.random.default_rng(to_start))
    half_m = settings.vehicle.body_height_m / 2.0
    return tuple(
        Seat(number, start, start.z_m - settings.control.height_m + half_m, tuple(endpoints), tuple(world_ports))
        for number, start in enumerate(starts, start=1)
    )
