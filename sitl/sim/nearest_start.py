"""Where a vehicle could start instead, when it cannot where it was asked to: the nearest place with room for it."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.config.settings import Settings
from companion.model import Pose
from sitl.mines.model import World
from sitl.scene.raycast import RayCaster
from sitl.scene.surface import Array, triangle_areas
from sitl.scene.visibility import has_room_above_ground

_SAMPLES = 20_000
"""Points of floor that are tried at most, each time: a second or two."""

_BATCH = 1024
_LEVEL = 0.5
"""A triangle is floor (or roof) when its normal has so much of the vertical: up to 60° of slope."""

_ALONG = 64
"""From the place that was found back towards the one that was asked for: so many steps."""

_WAYS_OUT = (np.array([0.123, 0.077, 1.0]), np.array([-0.101, 0.059, -1.0]))
"""Askew, and two of them: a ray along the edge between two triangles crosses both, or neither."""

_DOWN, _UP = np.array([0.0, 0.0, -1.0]), np.array([0.0, 0.0, 1.0])


class _Mine(enum.Enum):
    """What a mesh may be, in the order in which it is tried."""

    CLOSED = enum.auto()
    WITH_HOLES = enum.auto()
    WITHOUT_ROOF = enum.auto()


@dataclass(frozen=True, slots=True)
class Room:
    """What a vehicle needs around it.

    Attributes:
        radius_m: to every surface.
        height_m: H, at which it flies above ground.
        margin_m: to every side, at that height.
    """

    radius_m: float
    height_m: float
    margin_m: float

    @classmethod
    def of(cls, settings: Settings) -> Room:
        """For a mission with these settings."""
        return cls(settings.vehicle.body_radius_m, settings.control.height_m, settings.control.critical_margin_m)


def advice(world: World, caster: RayCaster, pose: Pose, room: Room) -> str:
    """What to say to whoever asked for a start at ``pose`` where there is no room: where there is."""
    place = nearest_place(world, caster, pose, room)
    if place is None:
        return "no place in this mine was found that has room for the vehicle: is the mesh in m, and is it closed?"
    numbers = " ".join((*world.in_file(*place), f"{pose.yaw_rad:.2f}"))
    return f"the nearest place that would do: --start {numbers}"


def nearest_place(world: World, caster: RayCaster, pose: Pose, room: Room) -> tuple[float, float, float] | None:
    """The nearest place with room, x, y and z as they are typed; None when none was found.

    Floors are covered with points, and what is at flying height above them is tried from the nearest on; then once
    more, closer together, no further away than what was found; then back from there towards ``pose``. So the place is
    about the nearest, in a mine of any size, after work that is bounded.
    """
    wanted = np.array([pose.x_m, pose.y_m, pose.z_m])
    for mine in _Mine:
        best: Array | None = None
        for _ in range(2):
            reach_m = math.inf if best is None else float(np.linalg.norm(best - wanted))
            found = _first(world, caster, _above_floors(world, wanted, room.height_m, reach_m), wanted, room, mine)
            best = best if found is None else found
        if best is not None:
            steps = np.arange(_ALONG + 1)[:, None] / _ALONG
            nearer = _first(world, caster, wanted + steps * (best - wanted), wanted, room, mine)
            x_m, y_m, z_m = (best if nearer is None else nearer).tolist()
            return x_m, y_m, z_m
    return None


def _above_floors(world: World, wanted: Array, height_m: float, reach_m: float) -> Array:
    """(n, 3) places ``height_m`` above points of what may be floor, of triangles within ``reach_m`` of ``wanted``."""
    corners = world.vertices_m[world.triangles].astype(np.float64)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = triangle_areas(world)
    outside = np.maximum(np.maximum(corners.min(axis=1) - wanted, wanted - corners.max(axis=1)), 0.0)
    floor = (np.abs(normals[:, 2]) > 2.0 * _LEVEL * areas) & (np.linalg.norm(outside, axis=1) <= reach_m + height_m)
    if not floor.any():
        return np.empty((0, 3))
    corners, areas = corners[floor], areas[floor]
    rng = np.random.default_rng(0)  # the same mine and start give the same place
    chosen = np.searchsorted(np.cumsum(areas), rng.uniform(0.0, areas.sum(), _SAMPLES)).clip(max=len(areas) - 1)
    u, v = rng.uniform(size=(2, _SAMPLES, 1))
    u, v = np.where(u + v > 1.0, 1.0 - u, u), np.where(u + v > 1.0, 1.0 - v, v)
    first, second, third = corners[chosen].transpose(1, 0, 2)
    return np.asarray(first + u * (second - first) + v * (third - first) + [0.0, 0.0, height_m])


def _first(world: World, caster: RayCaster, places: Array, wanted: Array, room: Room, mine: _Mine) -> Array | None:
    """Of ``places`` (n, 3), as they are typed, the nearest to ``wanted`` that has room; None when none has."""
    places = world.typed(places)
    places = places[np.argsort(np.linalg.norm(places - wanted, axis=1), kind="stable")]
    for begin in range(0, len(places), _BATCH):
        some = places[begin : begin + _BATCH]
        good = np.flatnonzero(_fits(caster, some, room, mine))
        if len(good):
            return np.asarray(some[good[0]])
    return None


def _fits(caster: RayCaster, places: Array, room: Room, mine: _Mine) -> NDArray[np.bool_]:
    """Whether each of ``places`` (n, 3) is in the mine and has room.

    A roof seen from above looks like a floor, and rock between two drifts like a drift; but from there the surface is
    crossed an even number of times on the way out of a mine that is closed. Scans with holes or with walls of two
    sides are not, and there this says nothing.
    """
    inside = np.isfinite(caster.cast(places, _DOWN))
    if mine is not _Mine.WITHOUT_ROOF:
        inside &= np.isfinite(caster.cast(places, _UP))
    if mine is _Mine.CLOSED:
        for way in _WAYS_OUT:
            inside &= caster.crossings(places, way) % 2 == 1
    good = np.zeros(len(places), dtype=bool)
    near = np.flatnonzero(inside)
    near = near[caster.distance(places[near]) >= room.radius_m] if len(near) else near
    if len(near):
        good[near] = has_room_above_ground(caster, places[near], room.height_m, room.margin_m)
    return good
