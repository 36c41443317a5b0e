"""A world as vehicles meet it: its rock, and everything in it that moves, shines, blows or fails."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from companion.model import Camera, Pose
from sitl.mines.model import World
from sitl.scene import dust
from sitl.scene.echoes import Echoes
from sitl.scene.fellows import Body, Fellows
from sitl.scene.moving import Moving
from sitl.scene.raycast import RayCaster
from sitl.scene.visibility import horizontal_clearance

Array = NDArray[np.float64]


class LiveWorld:
    """What happens in one world during one mission. Vehicles in it share it, as they share its rock.

    Args:
        world: the world.
        caster: rays in its rock.
        camera: that of the vehicles.
        body: of each of several vehicles, which see each other; None: one flies alone.
    """

    def __init__(self, world: World, caster: RayCaster, camera: Camera, body: Body | None = None) -> None:
        self._conditions = world.conditions
        self._caster = caster
        self._camera = camera
        self._movers = [Moving(mover, camera) for mover in self._conditions.movers]
        surfaces = self._conditions.surfaces
        self._echoes = None if surfaces is None else Echoes(world, surfaces, caster, camera)
        self._fellows = None if body is None else Fellows(body, camera)
        self._is_dark = False

    def restart(self) -> None:
        """Everything is as it was before a vehicle came."""
        for mover in self._movers:
            mover.restart()
        if self._fellows is not None:
            self._fellows.restart()
        self._is_dark = False

    def look(self, pose: Pose, number: int = 1) -> None:
        """A vehicle truly is there now: what waits for it begins. Called once a tick, in order of time.

        Args:
            pose: of it.
            number: which of several.
        """
        if self._fellows is not None:
            self._fellows.look(number, pose)
        for mover in self._movers:
            mover.look(pose)
        fails = self._conditions.light_fails
        self._is_dark = self._is_dark or (fails is not None and fails.is_met(pose))

    def is_moving(self, t_s: float) -> bool:
        """Whether something comes nearer by itself."""
        return any(mover.is_moving(t_s) for mover in self._movers)

    def image(
        self, pose: Pose, depth_m: NDArray[np.float32], rng: np.random.Generator, number: int = 1
    ) -> NDArray[np.float32]:
        """The depth image (height, width) from a true pose, where the rock alone would give ``depth_m``.

        Args:
            pose: of the vehicle.
            depth_m: what its camera would see of the rock.
            rng: for what comes and goes.
            number: which of several it is: it does not see itself.
        """
        if self._echoes is not None:
            depth_m = self._echoes.image(pose, depth_m, rng)
        for mover in self._movers:
            depth_m = np.fmin(depth_m, mover.image(pose))
        if self._fellows is not None:
            depth_m = self._fellows.image(number, pose, depth_m)
        for stretch in self._conditions.dust:
            if stretch.where.holds(pose) and dust.is_puffing(pose.t_s):
                dust.in_image(stretch, self._camera, depth_m, rng)
        if self._is_dark:
            depth_m = np.full_like(depth_m, np.nan)
        return depth_m

    def ranges(
        self,
        pose: Pose,
        origins_m: Array,
        directions: Array,
        ranges_m: Array,
        rng: np.random.Generator,
        number: int = 1,
    ) -> Array:
        """Ranges (n,) of beams from a true pose, where the rock alone would give ``ranges_m``; NaN: no echo.

        Args:
            pose: of the vehicle.
            origins_m: (n, 3) where the beams begin.
            directions: (n, 3) where they look.
            ranges_m: (n,) what they would say of the rock.
            rng: for what comes and goes.
            number: as for `image`.
        """
        if self._echoes is not None:
            ranges_m = self._echoes.ranges(origins_m, directions, ranges_m, rng)
        for mover in self._movers:
            ranges_m = np.fmin(ranges_m, mover.cast(pose.t_s, origins_m, directions))
        if self._fellows is not None:
            ranges_m = self._fellows.ranges(number, pose, origins_m, directions, ranges_m)
        for stretch in self._conditions.dust:
            if stretch.where.holds(pose) and dust.is_puffing(pose.t_s):
                ranges_m = dust.in_ranges(stretch, ranges_m, rng)
        return ranges_m

    def wind_mps(self, pose: Pose) -> tuple[float, float]:
        """The wind at a pose, towards east and north."""
        for wind in self._conditions.winds:
            if wind.where.holds(pose):
                return wind.x_mps, wind.y_mps
        return 0.0, 0.0

    def distance(self, t_s: Array, points_m: Array) -> NDArray[np.float32]:
        """(n,) distance of each point (n, 3), at its time (n,), to rock or to what moves."""
        found = self._caster.distance(points_m)
        for mover in self._movers:
            found = np.minimum(found, mover.distance(t_s, points_m))
        return found

    def horizontal_clearance(self, t_s: Array, points_m: Array, half_height_m: float) -> NDArray[np.float32]:
        """(n,) least horizontal distance of a body at points (n, 3), each at its time (n,), to rock or what moves."""
        found = horizontal_clearance(self._caster, points_m, half_height_m)
        for mover in self._movers:
            found = np.minimum(found, mover.horizontal_clearance(t_s, points_m, half_height_m))
        return found
