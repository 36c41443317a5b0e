"""What the autopilot believes of its position, as against where the vehicle truly is.

With GPS the estimate is the truth with a little noise, from where the vehicle booted. Without, it is what visual
odometry says, in the frame of that odometry, carried from one sample to the next by the inertial sensors. When the
odometry stops, the velocity estimate goes wrong with time, and whoever flies by it drifts.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from companion.model import Pose, wrap_rad

POSITION_NOISE_M = 0.01
VELOCITY_NOISE_MPS = 0.01
ANGLE_NOISE_RAD = 0.001
_FRESH_S = 0.3
"""An odometry sample bridges this long before the estimate begins to drift."""
_PULL = 0.3
_JUMP_M = 1.0
_FARTHEST_M = 1e5


@dataclass(frozen=True, slots=True)
class Odometry:
    """One sample of external odometry, in east-north-up about the odometry's own origin.

    ``ned`` says that its axes are north and east; else its heading counts from an arbitrary direction.
    """

    x_m: float
    y_m: float
    z_m: float
    yaw_rad: float
    ned: bool


class Estimator:
    """Position and attitude as the autopilot believes them.

    Args:
        start: true pose at boot: the origin of the local frame with GPS.
        drift_mps2: how fast the velocity estimate may go wrong when nothing aids it,
        most_mps: and between which speeds that ends.
        rng: for noise and drift.
    """

    def __init__(self, start: Pose, drift_mps2: float, most_mps: tuple[float, float], rng: np.random.Generator) -> None:
        self._rng = rng
        self._drift_mps2 = drift_mps2
        self._between_mps = most_mps
        self._most_mps = most_mps[1]
        self._raised_m = 0.0
        self.origin = start
        self.pose = replace(start, x_m=0.0, y_m=0.0, z_m=0.0)
        """The estimate: east-north-up about the local origin, without its noise."""
        self.true_yaw_rad = start.yaw_rad
        self.fed_s: float | None = None
        self.fed_speed_s: float | None = None
        self.fed_since_s: float | None = None
        self.ned = False
        self._error = (0.0, 0.0)
        self._drift = (0.0, 0.0)

    def alone_s(self, t_s: float) -> float:
        """For how long neither odometry nor GPS has come; infinite when none ever came."""
        return math.inf if self.fed_s is None else t_s - self.fed_s

    def step(self, true: Pose, dt_s: float, by_gps: bool) -> None:
        """Carries the estimate on to the time of ``true``."""
        self.true_yaw_rad = true.yaw_rad
        if by_gps:
            self._aided(true.t_s)
            self.pose = replace(
                true, x_m=true.x_m - self.origin.x_m, y_m=true.y_m - self.origin.y_m, z_m=true.z_m - self.origin.z_m
            )
            return
        old = self.pose
        turn_rad = wrap_rad(old.yaw_rad + true.yaw_rate_radps * dt_s) - true.yaw_rad
        vx_mps, vy_mps = rotated(true.vx_mps, true.vy_mps, turn_rad)
        if self.fed_s is not None and self.alone_s(true.t_s) > _FRESH_S and math.hypot(*self._error) < self._most_mps:
            self._error = (self._error[0] + self._drift[0] * dt_s, self._error[1] + self._drift[1] * dt_s)
        vx_mps, vy_mps = vx_mps + self._error[0], vy_mps + self._error[1]
        self.pose = replace(
            true,
            x_m=old.x_m + vx_mps * dt_s,
            y_m=old.y_m + vy_mps * dt_s,
            z_m=old.z_m + true.vz_mps * dt_s,
            yaw_rad=wrap_rad(true.yaw_rad + turn_rad),
            vx_mps=vx_mps,
            vy_mps=vy_mps,
        )

    def feed(self, sample: Odometry, t_s: float) -> None:
        """Takes one sample of external odometry that arrived at ``t_s``."""
        if max(abs(sample.x_m), abs(sample.y_m), abs(sample.z_m)) > _FARTHEST_M:
            return
        old = self.pose
        z_m = sample.z_m + self._raised_m
        off_m = math.dist((old.x_m, old.y_m, old.z_m), (sample.x_m, sample.y_m, z_m))
        new = self.fed_s is None or self.alone_s(t_s) > _FRESH_S or off_m > _JUMP_M
        pull = 1.0 if new else _PULL
        self.pose = replace(
            old,
            x_m=old.x_m + pull * (sample.x_m - old.x_m),
            y_m=old.y_m + pull * (sample.y_m - old.y_m),
            z_m=old.z_m + pull * (z_m - old.z_m),
            yaw_rad=wrap_rad(old.yaw_rad + pull * wrap_rad(sample.yaw_rad - old.yaw_rad)),
        )
        if self.fed_since_s is None or self.alone_s(t_s) > 1.0:
            self.fed_since_s = t_s
        self.ned = sample.ned
        self._aided(t_s)

    def raise_height(self, by_m: float) -> None:
        """Counts heights from another level from now on."""
        self._raised_m += by_m
        self.pose = replace(self.pose, z_m=self.pose.z_m + by_m)

    def _aided(self, t_s: float) -> None:
        """Right again; how it will go wrong without aid is drawn anew."""
        again = self.alone_s(t_s) > _FRESH_S
        self.fed_s = t_s
        if not again:
            return
        self._error = (0.0, 0.0)
        self._most_mps = float(self._rng.uniform(*self._between_mps))
        bearing_rad = float(self._rng.uniform(-math.pi, math.pi))
        size_mps2 = self._drift_mps2 * float(self._rng.uniform(0.3, 1.0))
        self._drift = (size_mps2 * math.cos(bearing_rad), size_mps2 * math.sin(bearing_rad))

    def noisy(self) -> Pose:
        """The estimate as telemetry shows it."""
        n = self._rng.normal(size=9)
        p = self.pose
        return replace(
            p,
            x_m=p.x_m + POSITION_NOISE_M * float(n[0]),
            y_m=p.y_m + POSITION_NOISE_M * float(n[1]),
            z_m=p.z_m + POSITION_NOISE_M * float(n[2]),
            vx_mps=p.vx_mps + VELOCITY_NOISE_MPS * float(n[3]),
            vy_mps=p.vy_mps + VELOCITY_NOISE_MPS * float(n[4]),
            vz_mps=p.vz_mps + VELOCITY_NOISE_MPS * float(n[5]),
            yaw_rad=wrap_rad(p.yaw_rad + ANGLE_NOISE_RAD * float(n[6])),
            roll_rad=p.roll_rad + ANGLE_NOISE_RAD * float(n[7]),
            pitch_rad=p.pitch_rad + ANGLE_NOISE_RAD * float(n[8]),
        )

    def turned(self, x: float, y: float) -> tuple[float, float]:
        """A direction of the estimate's frame in the true one."""
        return rotated(x, y, self.true_yaw_rad - self.pose.yaw_rad)

    def to_true(self, vx_mps: float, vy_mps: float) -> tuple[float, float]:
        """The true velocity that results when this velocity of the estimate's frame is flown."""
        return rotated(vx_mps - self._error[0], vy_mps - self._error[1], self.true_yaw_rad - self.pose.yaw_rad)


def rotated(x: float, y: float, angle_rad: float) -> tuple[float, float]:
    """(x, y) turned counter-clockwise."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return c * x - s * y, s * x + c * y
