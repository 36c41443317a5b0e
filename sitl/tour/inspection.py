"""The tour of a mission: of its world, from its start, past all that its camera can see."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.config.settings import Settings
from companion.model import Pose, wrap_rad
from sitl.mines import World
from sitl.scene.visibility import horizontal_clearance
from sitl.sim.simulation import COMPLETE_SHARE, SURFACE_STEP_M, Simulation
from sitl.tour.search import Look, Pace, Planner
from sitl.tour.views import Patches, looks_at, seen_share
from sitl.tour.ways import Ways

_MOST_PLACES = 2500
"""Looks are taken from the places of the traveling surface; of more than so many from one in each cell of a wider grid.
In a narrow mine all are needed: some of what can be seen is seen from few of them."""

_ALONG_M, _SWEEP_RAD = 0.25, 0.12
"""Images are taken this far apart on the way, and in turns: no camera of a vehicle that explores takes fewer. 5 Hz is
an image every 0.1 m at 0.5 m/s and every 0.12 rad at 0.6 rad/s; 15 Hz one every 0.1 m at 1.5 m/s."""

ROUNDS, _SLACK = (1200, 600, 300, 300), 0.0003
"""Rounds of searching: before each of the later ones it is counted, with every sample and image, what the last tour
sees, and searched on with as much more, or less, as needed and a little."""


@dataclass(frozen=True, slots=True, eq=False)
class Inspection:
    """A tour: what it takes, what it sees, and how it is flown.

    Attributes:
        time_s: length over speed, and all turns at u_M.
        length_m: of the way.
        turned_rad: all that is turned.
        looks: how many times it stops to turn to something.
        share: of the visible surface, by area, that is seen.
        least_d_m: the least horizontal distance to anything on the way, over the height of the body.
        poses: an image is taken at each: as often as a camera does on the way and in turns.
    """

    time_s: float
    length_m: float
    turned_rad: float
    looks: int
    share: float
    least_d_m: float
    poses: tuple[Pose, ...]


def depends_on(settings: Settings) -> tuple[object, ...]:
    """What a tour depends on of the settings beside the speed: the same for all that only choose or steer otherwise."""
    control, mapping = settings.control, settings.mapping
    return (
        settings.sensors.camera.model(),
        (mapping.max_range_m, mapping.voxel_m),
        (control.height_m, control.margin_m, control.critical_margin_m, control.max_yaw_rate_radps),
        (settings.vehicle.body_radius_m, settings.vehicle.body_height_m),
    )


def inspection(
    world: World,
    settings: Settings,
    seed: int,
    speed_mps: float,
    needed: float = COMPLETE_SHARE,
    rounds: Sequence[int] = ROUNDS,
) -> Inspection:
    """The best tour found for the mission of this world and seed, of the first vehicle alone.

    Args:
        world: the mine.
        settings: of the vehicle, its camera and its map.
        seed: of the mission: draws its start; the search draws by it too.
        speed_mps: how fast it flies.
        needed: share of the visible surface.
        rounds: how long is searched.

    Raises:
        InputError: there is no room to start.
    """
    mission = Simulation(world, settings, seed)
    camera, range_m = settings.sensors.camera.model(), settings.mapping.max_range_m
    start = mission.flights[0].vehicle.pose
    ways = Ways(mission.truth.traveling_surface_m, SURFACE_STEP_M)
    places = _spread(ways)
    patches = Patches.of(mission.truth)
    views = looks_at(mission.caster, camera, patches, ways.places_m[places], range_m)
    pace = Pace(speed_mps, settings.control.max_yaw_rate_radps)
    rng = np.random.default_rng(seed)
    planner = Planner(ways, places, views, patches.shares, (0, start.yaw_rad), pace, rng)
    best: list[Look] = []
    tour: list[Look] | None = None
    wanted, share = needed, 0.0
    for some in rounds:
        tour = planner.search(wanted, some, tour)
        poses = _flown(planner, tour, start)
        seen = seen_share(mission.truth, mission.caster, camera, poses, range_m, settings.mapping.voxel_m)
        shorter = planner.time_s(tour) < planner.time_s(best)
        if (shorter and seen >= needed) or (share < needed and seen > share):
            best, share = tour, seen
        # Planned with is a coarser picture of what is seen.
        wanted += needed + _SLACK - seen
    poses = _flown(planner, best, start)
    points_m = np.array([[pose.x_m, pose.y_m, pose.z_m] for pose in poses])
    clearance_m = horizontal_clearance(mission.caster, points_m, settings.vehicle.body_height_m / 2.0)
    time_s, length_m = planner.time_s(best), planner.length_m(best)
    turned_rad = (time_s - length_m / speed_mps) * pace.yaw_rate_radps
    return Inspection(time_s, length_m, turned_rad, len(best), share, float(clearance_m.min()), tuple(poses))


def _spread(ways: Ways) -> NDArray[np.int64]:
    """Places from all over the surface, `_MOST_PLACES` at most."""
    levels = np.round(ways.places_m[:, 2]).astype(np.int64)
    for wider in itertools.count(1):
        keys = np.column_stack([ways.cells // wider, levels])
        places = np.unique(keys, axis=0, return_index=True)[1]
        if len(places) <= _MOST_PLACES:
            break
    return np.sort(places)


def _flown(planner: Planner, tour: list[Look], start: Pose) -> list[Pose]:
    """A pose for each image that is taken on a tour."""
    poses = [start]
    for a, b, leg in planner.legs(tour):
        yaw_rad = a.yaw_rad
        for k, heading_rad in enumerate(leg.headings_rad.tolist()):
            poses += _turned(leg.points_m[k], yaw_rad, heading_rad)
            way_m = leg.points_m[k + 1] - leg.points_m[k]
            pieces = max(1, math.ceil(float(np.linalg.norm(way_m)) / _ALONG_M))
            poses += [_pose(leg.points_m[k] + way_m * i / pieces, heading_rad) for i in range(1, pieces + 1)]
            yaw_rad = heading_rad
        poses += _turned(leg.points_m[-1], yaw_rad, b.yaw_rad)
    return poses


def _turned(at_m: NDArray[np.float64], from_rad: float, to_rad: float) -> list[Pose]:
    turn_rad = wrap_rad(to_rad - from_rad)
    pieces = max(1, math.ceil(abs(turn_rad) / _SWEEP_RAD))
    return [_pose(at_m, from_rad + turn_rad * k / pieces) for k in range(1, pieces + 1)]


def _pose(at_m: NDArray[np.float64], yaw_rad: float) -> Pose:
    return Pose(0.0, float(at_m[0]), float(at_m[1]), float(at_m[2]), wrap_rad(yaw_rad))
