"""How the true vehicle moves under an autopilot that tracks velocities, and the ground and walls that it meets.

Not `sitl.sim.vehicle.Vehicle`: that one follows body setpoints only, while an autopilot also keeps an earth velocity
through a turn, flies sideways out of the way of an obstacle, stands on the ground and falls on it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from companion.model import Pose, wrap_rad
from sitl.sim.vehicle import DISTURBANCE_TIME_S, GRAVITY_MPS2, follow

if TYPE_CHECKING:  # level ground needs no worlds, which take a second to import
    from sitl.scene.raycast import RayCaster

_CLIMB_LAG_S = 0.25
_YAW_LAG_S = 0.15
_MAX_ACCELERATION_MPS2 = 3.0
_MAX_CLIMB_ACCELERATION_MPS2 = 2.0
_MAX_YAW_ACCELERATION_RADPS2 = 3.0
_HARD_LANDING_MPS = 2.0
_TURNING_RADPS = 0.1


@dataclass(frozen=True, slots=True)
class Surroundings:
    """The world as the vehicle's body meets it.

    Attributes:
        ground_z_m: (x, y, z) -> height at which the vehicle stands when it comes down from that point, in the world
            frame; NaN or infinite where there is no ground.
        clearance_m: (x, y, z) -> distance to the nearest surface, or ``None`` where nothing can be touched.
        body_radius_m: within this of a surface the vehicle touches it.
    """

    ground_z_m: Callable[[float, float, float], float]
    clearance_m: Callable[[float, float, float], float] | None = None
    body_radius_m: float = 0.3


def flat(ground_z_m: float) -> Surroundings:
    """Level ground without end, and nothing else."""
    return Surroundings(lambda _x, _y, _z: ground_z_m)


def inside(caster: RayCaster, body_radius_m: float, stand_m: float) -> Surroundings:
    """The mine that ``caster`` knows, for a body whose middle is ``stand_m`` above the floor when it stands."""
    down = np.array([[0.0, 0.0, -1.0]])

    def ground_z_m(x_m: float, y_m: float, z_m: float) -> float:
        # From a little above: the vehicle may stand on the surface, or a hair below it.
        above_m = z_m + 0.2
        range_m = float(caster.cast(np.array([x_m, y_m, above_m]), down)[0])
        return above_m - range_m + stand_m if math.isfinite(range_m) else math.nan

    def clearance_m(x_m: float, y_m: float, z_m: float) -> float:
        return float(caster.distance(np.array([[x_m, y_m, z_m]]))[0])

    return Surroundings(ground_z_m, clearance_m, body_radius_m)


@dataclass(frozen=True, slots=True)
class Motion:
    """The demand on the inner loops: velocity in the true world frame, and yaw rate.

    Attributes:
        stop_s: how far it goes on per speed when the demand is zero: the time constant of the horizontal response.
        creep_mps: how it goes on although the demand is less, x and y.
        held: a position loop stands above them, which leaves nothing of the slow disturbance.
    """

    vx_mps: float = 0.0
    vy_mps: float = 0.0
    vz_mps: float = 0.0
    yaw_rate_radps: float = 0.0
    stop_s: float = 1.0
    creep_mps: tuple[float, float] = (0.0, 0.0)
    held: bool = False


class Airframe:
    """A quadrotor: horizontal velocity of second order, climb and turn of first order, ground and walls.

    Args:
        start: where it stands; its height becomes that of the ground.
        surroundings: ground and walls.
        damping: damping ratio of the horizontal velocity response.
        drift_mps: standard deviation of the slow disturbance of each velocity axis.
        turning_drift: by how much that is more while it turns.
        rng: for the disturbance.
    """

    def __init__(
        self,
        start: Pose,
        surroundings: Surroundings,
        damping: float,
        drift_mps: float,
        turning_drift: float,
        rng: np.random.Generator,
    ) -> None:
        self._surroundings = surroundings
        self._damping = damping
        self._drift_mps = drift_mps
        self._turning_drift = turning_drift
        self._rng = rng
        self._disturbance = [0.0, 0.0, 0.0]
        self._ax_mps2 = 0.0
        self._ay_mps2 = 0.0
        self._free_m = 0.0
        self.crashed = False
        self.contacts = 0
        self.on_ground = True
        ground_m = self._ground_m(start)
        self.pose = replace(start, z_m=ground_m, roll_rad=0.0, pitch_rad=0.0)
        """The true pose, east-north-up."""
        self.height_m = 0.0
        """True height above the ground below."""

    @property
    def speed_mps(self) -> float:
        """True horizontal speed."""
        return math.hypot(self.pose.vx_mps, self.pose.vy_mps)

    def step(self, dt_s: float, motion: Motion | None) -> None:
        """Moves on by ``dt_s``; ``motion`` is ``None`` when the motors stand still."""
        if self.on_ground and (motion is None or self.crashed or motion.vz_mps <= 0.0):
            self._stand(dt_s)
            return
        if motion is None or self.crashed:
            self._fall(dt_s)
        else:
            self._fly(dt_s, motion)
        self._meet_ground()
        if not self.on_ground and not self.crashed:
            self._meet_walls(dt_s)

    def skip(self, lost_s: float) -> None:
        """Lets time pass without moving: whoever runs the vehicle was stopped for so long."""
        self.pose = replace(self.pose, t_s=self.pose.t_s + lost_s)

    def _stand(self, dt_s: float) -> None:
        self._ax_mps2 = self._ay_mps2 = 0.0
        self.height_m = 0.0
        old = self.pose
        self.pose = Pose(old.t_s + dt_s, old.x_m, old.y_m, old.z_m, old.yaw_rad)

    def _fall(self, dt_s: float) -> None:
        old = self.pose
        vz_mps = old.vz_mps - GRAVITY_MPS2 * dt_s
        self.pose = replace(
            old,
            t_s=old.t_s + dt_s,
            x_m=old.x_m + old.vx_mps * dt_s,
            y_m=old.y_m + old.vy_mps * dt_s,
            z_m=old.z_m + vz_mps * dt_s,
            vz_mps=vz_mps,
        )

    def _fly(self, dt_s: float, motion: Motion) -> None:
        old = self.pose
        self._disturb(dt_s)
        px, py, pz = (0.0, 0.0, 0.0) if motion.held else self._disturbance
        more = self._turning_drift if abs(old.yaw_rate_radps) > _TURNING_RADPS else 1.0
        natural_radps = 2.0 * self._damping / motion.stop_s
        px, py = more * (px + motion.creep_mps[0]), more * (py + motion.creep_mps[1])
        self._ax_mps2 = self._pushed(self._ax_mps2, natural_radps, motion.vx_mps + px - old.vx_mps, dt_s)
        self._ay_mps2 = self._pushed(self._ay_mps2, natural_radps, motion.vy_mps + py - old.vy_mps, dt_s)
        vx_mps = old.vx_mps + self._ax_mps2 * dt_s
        vy_mps = old.vy_mps + self._ay_mps2 * dt_s
        vz_mps = follow(old.vz_mps, motion.vz_mps + pz, _CLIMB_LAG_S, _MAX_CLIMB_ACCELERATION_MPS2, dt_s)
        yaw_rate_radps = follow(
            old.yaw_rate_radps, motion.yaw_rate_radps, _YAW_LAG_S, _MAX_YAW_ACCELERATION_RADPS2, dt_s
        )
        yaw_rad = wrap_rad(old.yaw_rad + yaw_rate_radps * dt_s)
        c, s = math.cos(yaw_rad), math.sin(yaw_rad)
        # To accelerate forward the nose goes down (positive pitch), to accelerate left the left side goes down.
        forward_mps2 = c * self._ax_mps2 + s * self._ay_mps2
        left_mps2 = c * self._ay_mps2 - s * self._ax_mps2
        self.pose = Pose(
            t_s=old.t_s + dt_s,
            x_m=old.x_m + vx_mps * dt_s,
            y_m=old.y_m + vy_mps * dt_s,
            z_m=old.z_m + vz_mps * dt_s,
            yaw_rad=yaw_rad,
            roll_rad=-math.atan2(left_mps2, GRAVITY_MPS2),
            pitch_rad=math.atan2(forward_mps2, GRAVITY_MPS2),
            vx_mps=vx_mps,
            vy_mps=vy_mps,
            vz_mps=vz_mps,
            yaw_rate_radps=yaw_rate_radps,
        )

    def _pushed(self, acceleration_mps2: float, w: float, missing_mps: float, dt_s: float) -> float:
        """The acceleration one step later: v'' = w^2 (wanted - v) - 2 d w v'."""
        jerk_mps3 = w * w * missing_mps - 2.0 * self._damping * w * acceleration_mps2
        return max(-_MAX_ACCELERATION_MPS2, min(_MAX_ACCELERATION_MPS2, acceleration_mps2 + jerk_mps3 * dt_s))

    def _meet_ground(self) -> None:
        ground_m = self._ground_m(self.pose)
        self.height_m = self.pose.z_m - ground_m
        if self.height_m > 0.0:
            self.on_ground = False
            return
        if self.pose.vz_mps < -_HARD_LANDING_MPS and not self.crashed:
            self._crash()
        self.on_ground = True
        self.height_m = 0.0
        self.pose = Pose(self.pose.t_s, self.pose.x_m, self.pose.y_m, ground_m, self.pose.yaw_rad)

    def _meet_walls(self, dt_s: float) -> None:
        around = self._surroundings
        # The ground below is a surface too: near it, touching is landing.
        if around.clearance_m is None or self.height_m < 1.2 * around.body_radius_m:
            self._free_m = 0.0
            return
        # A body that was D clear cannot touch before it has flown D: most steps need no query.
        self._free_m -= math.sqrt(self.speed_mps**2 + self.pose.vz_mps**2) * dt_s
        if self._free_m > 0.0:
            return
        distance_m = around.clearance_m(self.pose.x_m, self.pose.y_m, self.pose.z_m)
        if not distance_m > around.body_radius_m:
            self._crash()
        self._free_m = distance_m - around.body_radius_m

    def _crash(self) -> None:
        self.crashed = True
        self.contacts += 1
        # What is left falls down where it touched.
        self.pose = replace(self.pose, vx_mps=0.0, vy_mps=0.0, yaw_rate_radps=0.0)

    def _ground_m(self, pose: Pose) -> float:
        ground_m = self._surroundings.ground_z_m(pose.x_m, pose.y_m, pose.z_m)
        # Through a hole of the mesh: no ground, and the fall ends where it began instead of never.
        return ground_m if math.isfinite(ground_m) else pose.z_m

    def _disturb(self, dt_s: float) -> None:
        keep = math.exp(-dt_s / DISTURBANCE_TIME_S)
        push = self._drift_mps * math.sqrt(1.0 - keep * keep)
        fresh = self._rng.normal(size=3).tolist()
        self._disturbance = [keep * x + push * y for x, y in zip(self._disturbance, fresh, strict=True)]
