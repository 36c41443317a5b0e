"""From where the simulator thinks the vehicle is to where that is in the mine."""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass, replace

import numpy as np

from companion.config.settings import Settings
from companion.errors import InputError
from companion.frames import NedPose, pose_from_ned
from companion.model import Pose, wrap_rad
from sitl.mines import World, load_world
from sitl.mines.placing import Reading
from sitl.mines.start_beside import Start
from sitl.scene.raycast import RayCaster
from sitl.sim.start import remarks_on_start, start_poses

log = logging.getLogger(__name__)

JUMP_M, JUMP_MPS = 3.0, 5.0
"""Truth that moves by more than this, and faster than this, has not flown there: the simulator was started anew."""


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """A mine and where the vehicle stands in it before it takes off.

    Attributes:
        stand: the pose on the floor, the body's underside touching it; level.
        remarks: what people should know of the mine.
    """

    world: World
    caster: RayCaster
    stand: Pose
    remarks: tuple[str, ...] = ()

    @classmethod
    def load(
        cls,
        spec: str,
        seed: int,
        start: Start | None,
        settings: Settings,
        vehicle: int = 1,
        reading: Reading | None = None,
    ) -> Scene:
        """Loads a world and chooses the start as `companion sim` does with the same seed.

        Args:
            spec: the world, as for `load_world`.
            seed: draws the world where it is drawn, and the start.
            start: x, y, z in m and yaw in rad of the hovering vehicle; it stands on the floor below.
            settings: the whole configuration.
            vehicle: which one of several that start side by side, from 1.
            reading: how a mesh file is to be read.

        Raises:
            InputError: no such world, no room to start, or no floor under it.
        """
        world = load_world(spec, seed, start, reading)
        caster = RayCaster(world)
        to_start = np.random.SeedSequence(seed).spawn(1)[0]
        hover = start_poses(world, caster, settings, vehicle, np.random.default_rng(to_start))[vehicle - 1]
        floor_m = hover.z_m - float(caster.cast(np.array([hover.x_m, hover.y_m, hover.z_m]), np.array([0, 0, -1.0]))[0])
        if not math.isfinite(floor_m):
            raise InputError(
                f"start {world.named(hover.x_m, hover.y_m, hover.z_m)} in world {world.name}: no floor below it"
            )
        stand_m = floor_m + settings.vehicle.body_height_m / 2.0
        stand = Pose(0.0, hover.x_m, hover.y_m, stand_m, hover.yaw_rad)
        return cls(world, caster, stand, (*world.remarks, *remarks_on_start(world, caster)))


class Placer:
    """Puts the vehicle into the mine: where it first is, whatever its yaw, is where it stands at the start.

    The mine is turned and shifted to fit, so a simulator may boot anywhere and look anywhere. Up stays up.

    Args:
        stand: the pose in the mine that the first truth corresponds to.
    """

    def __init__(self, stand: Pose) -> None:
        self.restarts = 0
        """How often the truth has jumped: a simulator that was started anew stands at the start again."""
        self._stand = stand
        self._first: Pose | None = None
        self._last: Pose | None = None

    def place(self, ned: NedPose) -> Pose:
        """The pose in the mine, at the time of ``ned``."""
        here = pose_from_ned(ned)
        if self._last is not None and _jumped(self._last, here):
            self.restarts += 1
            self._first = None
            log.warning("the true position jumped: the simulator was started anew, so the vehicle is at the start")
        self._last = here
        if self._first is None:
            self._first = here
        first, stand = self._first, self._stand
        return moved(here, first, (stand.x_m, stand.y_m, stand.z_m), stand.yaw_rad - first.yaw_rad)

    def heading_offset_rad(self) -> float:
        """By how much the mine is turned against the compass: yaw in the mine minus true yaw. 0 before the first."""
        return 0.0 if self._first is None else wrap_rad(self._stand.yaw_rad - self._first.yaw_rad)


def moved(pose: Pose, origin: Pose, to_m: tuple[float, float, float], turn_rad: float) -> Pose:
    """``pose`` after all space was turned about the vertical through ``origin`` and shifted to put that at ``to_m``."""
    c, s = math.cos(turn_rad), math.sin(turn_rad)
    x_m, y_m = pose.x_m - origin.x_m, pose.y_m - origin.y_m
    return replace(
        pose,
        x_m=to_m[0] + c * x_m - s * y_m,
        y_m=to_m[1] + s * x_m + c * y_m,
        z_m=to_m[2] + pose.z_m - origin.z_m,
        yaw_rad=wrap_rad(pose.yaw_rad + turn_rad),
        vx_mps=c * pose.vx_mps - s * pose.vy_mps,
        vy_mps=s * pose.vx_mps + c * pose.vy_mps,
    )


def _jumped(before: Pose, after: Pose) -> bool:
    way_m = math.dist((before.x_m, before.y_m, before.z_m), (after.x_m, after.y_m, after.z_m))
    return way_m > JUMP_M + JUMP_MPS * max(after.t_s - before.t_s, 0.0)
