"""A start that is refused comes with one that would do."""

from __future__ import annotations

import functools
import re
from pathlib import Path

import numpy as np
import pytest

from companion.config.load import load_settings
from companion.config.settings import Settings
from companion.errors import InputError
from companion.model import Pose
from sitl.mines import World, load_world
from sitl.mines.placing import Reading
from sitl.scene.raycast import RayCaster
from sitl.scene.visibility import has_room_above_ground
from sitl.sim.nearest_start import Room, nearest_place
from sitl.sim.start import check_room, check_start

ROOM = Room(0.3, 1.5, 0.8)


@functools.cache
def mine(spec: str) -> tuple[World, RayCaster]:
    """A mine and what casts rays in it."""
    world = load_world(spec, seed=0)
    return world, RayCaster(world)


@functools.cache
def settings() -> Settings:
    """The default ones."""
    return load_settings()


def named(error: InputError) -> Pose:
    """The start that a refusal names, ready to be pasted."""
    found = re.search(r"the nearest place that would do: --start (\S+) (\S+) (\S+) (\S+)$", str(error))
    assert found is not None, error
    x_m, y_m, z_m, yaw_rad = map(float, found.groups())
    return Pose(0.0, x_m, y_m, z_m, yaw_rad)


STARTS = [
    ("room", (3.0, 0.1, 1.0), "the nearest surface is"),
    ("room", (3.0, 5.0, 1.0), "no floor below"),
    ("room", (3.0, 1.8, -1.0), "no floor below"),
    ("room", (3000.0, -20_000.0, 1.0), "the nearest surface is 20222 m away"),
    ("complex", (0.0, 0.0, -30.0), "no floor below"),
    ("slope", (-5.0, 3.0, 2.0), "no floor below"),
]


@pytest.mark.parametrize(("spec", "xyz_m", "says"), STARTS)
def test_a_refusal_names_a_start_that_is_accepted(spec: str, xyz_m: tuple[float, float, float], says: str) -> None:
    """Protects whoever has to find a start in a mine that nobody has seen: pasted, it flies."""
    world, caster = mine(spec)
    with pytest.raises(InputError, match=says) as refused:
        check_start(world, caster, Pose(0.0, *xyz_m, 0.7), Room.of(settings()))
    pose = named(refused.value)
    assert pose.yaw_rad == 0.7
    check_start(world, caster, pose, Room.of(settings()))
    check_room(world, caster, pose, settings())
    assert caster.crossings(np.array([pose.x_m, pose.y_m, pose.z_m]), np.array([0.0, 0.0, 1.0]))[0] % 2 == 1


@pytest.mark.parametrize(("unit_m", "origin_m"), [(0.001, 0.0), (0.01, 500_000.0), (0.3048, 0.0), (1000.0, 0.0)])
def test_the_start_that_is_named_is_in_the_unit_and_from_the_origin_of_the_file(
    tmp_path: Path, unit_m: float, origin_m: float
) -> None:
    """Protects whoever flies in a mesh in mm: pasted, it is that place, and not one a thousand times nearer to 0."""
    room, _ = mine("room")
    path, reading = tmp_path / "room.obj", Reading(scale=unit_m)
    corners = np.add(room.vertices_m, [origin_m, 0.0, 0.0], dtype=np.float64) / unit_m
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in corners.tolist()]
    lines += ["f " + " ".join(map(str, corner)) for corner in (room.triangles + 1).tolist()]
    path.write_text("\n".join(lines), encoding="utf-8")
    in_rock = ((3.0 + origin_m) / unit_m, 0.1 / unit_m, 1.0 / unit_m, 0.0)
    world = load_world(str(path), 0, in_rock, reading)
    assert world.start is not None
    with pytest.raises(InputError, match=r"the nearest surface is 0\.10 m away") as refused:
        check_start(world, RayCaster(world), world.start, Room.of(settings()))
    pose = named(refused.value)
    pasted = load_world(str(path), 0, (pose.x_m, pose.y_m, pose.z_m, pose.yaw_rad), reading)
    assert pasted.start is not None
    check_start(pasted, RayCaster(pasted), pasted.start, Room.of(settings()))
    check_room(pasted, RayCaster(pasted), pasted.start, settings())


def test_a_start_without_room_at_flying_height_names_one_with_it() -> None:
    """Protects from a second refusal: what fits on the floor beside a wall must also have room where it flies."""
    world, caster = mine("room")
    beside = Pose(0.0, 3.0, 0.4, 1.0, 0.0)
    check_start(world, caster, beside, Room.of(settings()))
    with pytest.raises(InputError, match="m above the floor there has not") as refused:
        check_room(world, caster, beside, settings())
    check_room(world, caster, named(refused.value), settings())


@pytest.mark.parametrize("xyz_m", [(3.0, 0.1, 1.0), (3.0, 5.0, 1.0), (3.0, 1.8, 9.0), (-2.0, -2.0, 0.5)])
def test_it_is_about_the_nearest(xyz_m: tuple[float, float, float]) -> None:
    """Protects from the far end of the mine: against every place on a fine grid, none is much nearer."""
    world, caster = mine("room")
    place = nearest_place(world, caster, Pose(0.0, *xyz_m, 0.0), ROOM)
    assert place is not None
    low, high = world.vertices_m.min(axis=0), world.vertices_m.max(axis=0)
    grid = np.stack(np.meshgrid(*map(np.arange, low, high, [0.1] * 3), indexing="ij"), axis=-1).reshape(-1, 3)
    grid = grid[np.isfinite(caster.cast(grid, np.array([0.0, 0.0, 1.0])))]
    grid = grid[caster.distance(grid) >= ROOM.radius_m]
    grid = grid[has_room_above_ground(caster, grid.astype(np.float64), ROOM.height_m, ROOM.margin_m)]
    nearest_m = float(np.linalg.norm(grid - xyz_m, axis=1).min())
    assert float(np.linalg.norm(np.subtract(place, xyz_m))) <= 1.15 * nearest_m + 0.15


def test_a_mine_without_a_place_says_so() -> None:
    """Protects from a search without end: a slit 0.4 m wide holds no vehicle, with a roof or without."""
    vertices = np.array([[x, y, z] for z in (0, 5) for y in (0, 0.4) for x in (0, 20)], np.float32)
    floor, walls = [[0, 1, 2], [1, 3, 2]], [[0, 1, 4], [1, 5, 4], [2, 3, 6], [3, 7, 6]]
    world = World("slit", vertices, np.array(floor + walls, np.int32), None, np.empty((0, 3)), "A slit.")
    with pytest.raises(InputError, match="no place in this mine was found that has room for the vehicle"):
        check_start(world, RayCaster(world), Pose(0.0, 1.0, 0.2, 1.0, 0.0), ROOM)


def test_the_rock_between_two_drifts_is_no_place() -> None:
    """Protects from a start between the roof of one drift and the floor of the next one, which looks like a drift."""
    world, _ = mine("room")
    above = world.vertices_m + np.array([0.0, 0.0, 12.0], np.float32)
    triangles = np.concatenate([world.triangles, world.triangles + len(above)])
    both = World("two", np.concatenate([world.vertices_m, above]), triangles, None, np.empty((0, 3)), "Two rooms.")
    top_m = float(world.vertices_m[:, 2].max())
    place = nearest_place(both, RayCaster(both), Pose(0.0, 3.0, 1.8, top_m + 2.0, 0.0), ROOM)
    assert place is not None
    assert not top_m <= place[2] <= 12.0
