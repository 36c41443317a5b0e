"""The mines of single hazards: closed, and the hazard stands where the vehicle has to come past it."""

from __future__ import annotations

import functools

import numpy as np
import pytest

from companion.config.load import load_settings
from companion.errors import InputError
from sitl.mines import World, load_world
from sitl.mines.conditions import Surface
from sitl.mines.hazards import HAZARDS
from sitl.mines.mesh import open_edges
from sitl.scene.raycast import RayCaster
from sitl.sim.nearest_start import Room
from sitl.sim.start import check_room, check_start, start_poses

ROUGH_M = 0.15
"""Walls and roof are moved by 0.12 m at most, and a grid cell cuts a corner by some cm."""


@functools.cache
def world_of(name: str) -> World:
    return load_world(f"hazard:{name}", 1)


def range_m(name: str, x_m: float, y_m: float, z_m: float, way: tuple[float, float, float]) -> float:
    return float(RayCaster(world_of(name)).cast(np.array([x_m, y_m, z_m]), np.array(way))[0])


@pytest.mark.parametrize("name", HAZARDS)
def test_the_mine_is_closed_and_a_vehicle_can_start(name: str) -> None:
    """Protects flights that begin in a wall, and holes that nobody wanted; the open scan is the one that is open."""
    world = world_of(name)
    assert world.name == f"hazard:{name}"
    edges = open_edges(world.vertices_m.astype(np.float64), world.triangles.astype(np.int64))
    assert (edges > 0) == (name == "open-end")
    caster, settings = RayCaster(world), load_settings(None, "flight")
    for seed in range(3):
        (start,) = start_poses(world, caster, settings, 1, np.random.default_rng(seed))
        check_start(world, caster, start, Room.of(settings))
        check_room(world, caster, start, settings)
    surfaces = world.conditions.surfaces
    assert surfaces is None or len(surfaces) == len(world.triangles)


@pytest.mark.parametrize(
    ("name", "at", "way", "least_m", "most_m"),
    [
        ("pillar", (3.0, 0.0, 1.5), (1, 0, 0), 2.5 - ROUGH_M, 2.5 + ROUGH_M),
        ("mirrored-edges", (2.0, 0.0, 1.5), (0, 1, 0), 2.0 - 0.05, 2.0 + 0.05),
        ("pocket", (9.0, 6.0, 1.5), (1, 0, 0), 1.2 - 0.08, 1.2 + 0.08),
        ("pocket", (13.0, -6.0, 1.5), (1, 0, 0), 1.02 - 0.08, 1.02 + 0.08),
        ("shaft", (11.0, -1.0, 1.5), (0, 0, -1), 16.0, 17.0),
        ("shaft", (11.0, 1.3, 1.5), (0, 0, -1), 1.5 - ROUGH_M, 1.5 + ROUGH_M),
        ("step", (10.0, 0.0, 1.5), (0, 0, -1), 1.5 - ROUGH_M, 1.5 + ROUGH_M),
        ("step", (12.0, 0.0, 1.5), (0, 0, -1), 0.8 - ROUGH_M, 0.8 + ROUGH_M),
        ("slope", (16.0, 0.0, 3.9), (0, 0, -1), 1.4 - ROUGH_M, 1.4 + ROUGH_M),
        ("beam", (9.0, 0.0, 1.5), (1, 0, 0), 1.84, 1.86),
        ("beam", (9.0, 0.0, 1.2), (1, 0, 0), 5.0, 20.0),
        ("cable", (9.0, 0.0, 1.5), (0, -1, 0), 0.48, 0.49),
        ("net", (9.0, -0.6, 1.5), (1, 0, 0), 1.99, 2.0),
        ("overhang", (11.0, 0.0, 1.5), (0, 1, 0), 0.69, 0.71),
        ("overhang", (11.0, 0.0, 0.6), (0, 1, 0), 2.1 - ROUGH_M, 2.1 + ROUGH_M),
        ("high-roof", (11.5, 0.0, 1.5), (0, 0, 1), 10.5 - ROUGH_M, 10.5 + ROUGH_M),
        ("open-end", (20.0, 0.0, 1.5), (1, 0, 0), np.inf, np.inf),
    ],
)
def test_the_hazard_is_there(
    name: str, at: tuple[float, float, float], way: tuple[float, float, float], least_m: float, most_m: float
) -> None:
    """Protects a table of flights past something that is not there: a ray meets it, or goes past it."""
    assert least_m <= range_m(name, *at, way) <= most_m


@pytest.mark.parametrize(
    ("name", "surface", "area_m2"),
    [("dark-wall", Surface.DARK, (15.0, 40.0)), ("shiny-wall", Surface.SHINY, (15.0, 40.0)),
     ("water", Surface.WATER, (18.0, 26.0))],
)  # fmt: skip
def test_so_much_of_the_surface_is_no_rock(name: str, surface: Surface, area_m2: tuple[float, float]) -> None:
    """Of the wall 6 x 2.4 m and the round end; of the floor 6 x 3.8 m."""
    world = world_of(name)
    assert world.conditions.surfaces is not None
    a, b, c = np.moveaxis(world.vertices_m[world.triangles[world.conditions.surfaces == surface]], 1, 0)
    assert area_m2[0] < np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2.0 < area_m2[1]


def test_what_is_no_hazard_is_refused_with_those_that_are() -> None:
    """Protects the tired operator: the names stand in the refusal."""
    with pytest.raises(
        InputError, match=r"hazard:shafts: after 'hazard:' comes one of pillar, mirrored-edges, .*shaft"
    ):
        load_world("hazard:shafts", 1)
