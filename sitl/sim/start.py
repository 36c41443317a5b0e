"""Where vehicles start, and whether they fit there."""

from __future__ import annotations

import math

import numpy as np

from companion.config.settings import Settings
from companion.errors import InputError
from companion.model import Pose
from sitl.mines.model import World
from sitl.scene.raycast import RayCaster
from sitl.scene.visibility import has_room_above_ground, horizontal_clearance
from sitl.sim.nearest_start import Room, advice

FARTHEST_M = 50.0
"""No sensor of the vehicle would see a surface that is further from the start than this."""

UNDER_M = 0.01
"""Another surface under the floor is looked for from here on."""

_DOWN = np.array([0.0, 0.0, -1.0])


def start_poses(
    world: World, caster: RayCaster, settings: Settings, vehicles: int, rng: np.random.Generator
) -> list[Pose]:
    """Where the vehicles are after take-off: a world's own start, or drawn from where there is room for d_s.

    Several vehicles start side by side along the drift, at least two margins apart.

    Raises:
        InputError: the start is inside a wall, or there is no room.
    """
    height_m, margin_m = settings.control.height_m, settings.control.margin_m
    if world.start is not None:
        check_start(world, caster, world.start, Room.of(settings))
        if vehicles > 1:
            raise InputError(
                f"world {world.name} has one start pose, which {vehicles} vehicles cannot share: fly several in a "
                "generated world (complex, slope, room, random)"
            )
        return [world.start]
    points = world.start_area_m + np.array([0.0, 0.0, height_m])
    points = points[horizontal_clearance(caster, points, settings.vehicle.body_height_m / 2.0) >= margin_m]
    if len(points) == 0:
        raise InputError(
            f"world {world.name} has no place with control.margin_m = {margin_m:g} m to every wall at "
            f"control.height_m = {height_m:g} m: a smaller margin is needed"
        )
    poses: list[Pose] = []
    first = points[rng.integers(len(points))]
    order = np.argsort(np.linalg.norm(points - first, axis=1), kind="stable")
    for point in points[order]:
        apart = [math.dist(point, (pose.x_m, pose.y_m, pose.z_m)) for pose in poses]
        if min(apart, default=math.inf) >= 2.0 * margin_m:
            yaw_rad = float(rng.uniform(-math.pi, math.pi))
            poses.append(Pose(0.0, float(point[0]), float(point[1]), float(point[2]), yaw_rad))
        if len(poses) == vehicles:
            return poses
    raise InputError(f"world {world.name} has no room for {vehicles} vehicles to start")


def check_start(world: World, caster: RayCaster, pose: Pose, room: Room) -> None:
    """Checks that a vehicle fits at ``pose`` and has ground below it.

    Raises:
        InputError: it touches the surface, there is no floor below it, or the surface is further than any mine's; the
            nearest place that would do is named.
    """
    if (problem := _problem(world, caster, pose, room.radius_m)) is not None:
        raise _refused(world, caster, pose, room, problem)


def check_room(world: World, caster: RayCaster, pose: Pose, settings: Settings) -> None:
    """Checks that a vehicle that starts at ``pose`` has room at the height at which it flies.

    Raises:
        InputError: it has not; the nearest place where it has is named.
    """
    room = Room.of(settings)
    if not has_room_above_ground(caster, np.array([[pose.x_m, pose.y_m, pose.z_m]]), room.height_m, room.margin_m)[0]:
        problem = (
            f"a vehicle {room.height_m:.2f} m above the floor there has not {room.margin_m:.2f} m of room to every side"
        )
        raise _refused(world, caster, pose, room, problem)


def remarks_on_start(world: World, caster: RayCaster) -> tuple[str, ...]:
    """What people should know of a world's own start: that it is under the open sky, if it is."""
    if world.start is None:
        return ()
    point = np.array([world.start.x_m, world.start.y_m, world.start.z_m])
    down_m, up_m = caster.cast(point, np.stack([_DOWN, -_DOWN]))
    if np.isfinite(up_m):
        return ()
    told = "no roof above the start: what is open to the sky is flown in as well"
    under_m = UNDER_M + float(caster.cast(point + _DOWN * (down_m + UNDER_M), _DOWN)[0])
    if np.isfinite(under_m):
        told += f"; {under_m:.1f} m under the floor is another surface: is the start on top of the mine?"
    return (told,)


def _refused(world: World, caster: RayCaster, pose: Pose, room: Room, problem: str) -> InputError:
    where = f"start {world.named(pose.x_m, pose.y_m, pose.z_m)} in world {world.name}"
    return InputError(f"{where}: {problem}; {advice(world, caster, pose, room)}")


def _problem(world: World, caster: RayCaster, pose: Pose, radius_m: float) -> str | None:
    """Why a vehicle of ``radius_m`` cannot be there; None when it can."""
    point = np.array([pose.x_m, pose.y_m, pose.z_m])
    distance_m = float(caster.distance(point[None])[0])
    if distance_m > FARTHEST_M:
        return (
            f"the nearest surface is {distance_m:.0f} m away, it is at {world.bounds()}. If the unit of the mesh is "
            "not the metre, give --scale (0.01 for centimetres, 0.001 for millimetres)"
        )
    if not np.isfinite(caster.cast(point, _DOWN)[0]):
        return f"outside, there is no floor below it; the surface is at {world.bounds()}"
    if distance_m < radius_m:
        return f"the nearest surface is {distance_m:.2f} m away, the vehicle needs {radius_m:.2f} m"
    return None
