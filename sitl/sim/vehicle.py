"""A multicopter that follows velocity and yaw-rate setpoints the way an autopilot lets it."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from companion.config.sim import DynamicsSettings
from companion.model import Pose, Setpoint, wrap_rad

GRAVITY_MPS2 = 9.81
DISTURBANCE_TIME_S = 5.0
"""Correlation time of the slow disturbance: PX4 drifts by decimetres in ten seconds, not back and forth."""

WIND_DRAG_PER_S = 0.3
"""How fast a wind takes a multicopter along that does nothing against it: 2 m/s push with 0.6 m/s², a lean of 3.5°."""

VELOCITY_P_PER_S, VELOCITY_I_PER_S2 = 1.8, 0.4
"""How PX4's velocity controller takes that out (MPC_XY_VEL_P_ACC, MPC_XY_VEL_I_ACC): 2 m/s that set in at once
carry it with 0.27 m/s after 1.4 s, with a third of that after another five, and it ends 1.5 m down the wind where
nothing else holds it."""

Wind = Callable[[Pose], tuple[float, float]]
"""The wind at a pose, in m/s towards east and north."""


def calm(_pose: Pose) -> tuple[float, float]:
    """No wind anywhere."""
    return 0.0, 0.0


class Vehicle:
    """Velocity response of first order with limited acceleration; the body tilts as the acceleration needs it.

    Args:
        settings: response, limits, latency and disturbance.
        start: true pose at time 0.
        rng: for the disturbance.
        wind: where it blows how strongly.
    """

    def __init__(self, settings: DynamicsSettings, start: Pose, rng: np.random.Generator, wind: Wind = calm) -> None:
        self.pose = start
        """The true pose."""
        self.path_m = 0.0
        """Length of the way flown."""
        self._settings = settings
        self._rng = rng
        self._forward_mps = 0.0
        self._side_mps = 0.0
        self._climb_mps = 0.0
        self._yaw_rate_radps = 0.0
        self._disturbance = rng.normal(0.0, 1.0, 3) * settings.drift_mps
        self._wind = wind
        self._blown_mps = np.zeros(2)
        self._against_mps2 = np.zeros(2)
        self._pending: deque[Setpoint] = deque(maxlen=256)
        self._setpoint = Setpoint(start.t_s, 0.0, 0.0, 0.0)

    @property
    def forward_mps(self) -> float:
        """True speed along the heading."""
        return self._forward_mps + float(self._blown_mps @ _ahead(self.pose.yaw_rad))

    def command(self, setpoint: Setpoint) -> None:
        """Hand over a setpoint; it takes effect after the configured latency."""
        self._pending.append(setpoint)

    def step(self, dt_s: float) -> Pose:
        """Move on by ``dt_s`` and return the new true pose."""
        settings, old = self._settings, self.pose
        t_s = old.t_s + dt_s
        # What falls due before the step's end acts in it. Half a microsecond: times are sums of periods.
        while self._pending and self._pending[0].t_s + settings.command_latency_s < t_s - 5e-7:
            self._setpoint = self._pending.popleft()
        self._disturb(dt_s)
        gust_forward, gust_side, gust_climb = (float(x) for x in self._disturbance)
        limit = settings.max_acceleration_mps2
        before = (self._forward_mps, self._side_mps)
        forward_to = self._setpoint.speed_mps * settings.speed_gain + gust_forward
        side_to = self._setpoint.lateral_mps * settings.speed_gain + gust_side
        climb_to = self._setpoint.climb_mps * settings.speed_gain + gust_climb
        turn_to = self._setpoint.yaw_rate_radps * settings.yaw_rate_gain
        self._forward_mps = follow(self._forward_mps, forward_to, settings.speed_lag_s, limit, dt_s)
        self._side_mps = follow(self._side_mps, side_to, settings.speed_lag_s, limit, dt_s)
        self._climb_mps = follow(self._climb_mps, climb_to, settings.speed_lag_s, limit, dt_s)
        self._yaw_rate_radps = follow(
            self._yaw_rate_radps, turn_to, settings.yaw_rate_lag_s, settings.max_yaw_acceleration_radps2, dt_s
        )
        yaw_rad = wrap_rad(old.yaw_rad + self._yaw_rate_radps * dt_s)
        middle_rad = old.yaw_rad + 0.5 * self._yaw_rate_radps * dt_s
        thrust_mps2 = self._blow(dt_s)
        ahead = _ahead(old.yaw_rad)
        vx = self._forward_mps * math.cos(middle_rad) - self._side_mps * math.sin(middle_rad) + self._blown_mps[0]
        vy = self._forward_mps * math.sin(middle_rad) + self._side_mps * math.cos(middle_rad) + self._blown_mps[1]
        # To accelerate forward the nose goes down (positive pitch), to accelerate left the left side goes down.
        forward_mps2 = (self._forward_mps - before[0]) / dt_s - self._yaw_rate_radps * self._side_mps
        left_mps2 = (self._side_mps - before[1]) / dt_s + self._yaw_rate_radps * self._forward_mps
        forward_mps2 += float(thrust_mps2 @ ahead)
        left_mps2 += float(thrust_mps2 @ np.array([-ahead[1], ahead[0]]))
        self.pose = Pose(
            t_s=t_s,
            x_m=old.x_m + float(vx) * dt_s,
            y_m=old.y_m + float(vy) * dt_s,
            z_m=old.z_m + self._climb_mps * dt_s,
            yaw_rad=yaw_rad,
            roll_rad=-math.atan2(left_mps2, GRAVITY_MPS2),
            pitch_rad=math.atan2(forward_mps2, GRAVITY_MPS2),
            vx_mps=float(vx),
            vy_mps=float(vy),
            vz_mps=self._climb_mps,
            yaw_rate_radps=self._yaw_rate_radps,
        )
        self.path_m += math.sqrt(vx * vx + vy * vy + self._climb_mps**2) * dt_s
        return self.pose

    def _blow(self, dt_s: float) -> NDArray[np.float64]:
        """Move on what the wind adds to the velocity; returns the thrust against it (2,), in m/s²."""
        push_mps2 = WIND_DRAG_PER_S * np.array(self._wind(self.pose))
        self._against_mps2 += VELOCITY_I_PER_S2 * self._blown_mps * dt_s
        thrust_mps2 = -VELOCITY_P_PER_S * self._blown_mps - self._against_mps2
        self._blown_mps = self._blown_mps + (push_mps2 + thrust_mps2) * dt_s
        return np.asarray(thrust_mps2)

    def _disturb(self, dt_s: float) -> None:
        keep = math.exp(-dt_s / DISTURBANCE_TIME_S)
        push = self._settings.drift_mps * math.sqrt(1.0 - keep * keep)
        self._disturbance = keep * self._disturbance + push * self._rng.standard_normal(3)


def _ahead(yaw_rad: float) -> NDArray[np.float64]:
    return np.array([math.cos(yaw_rad), math.sin(yaw_rad)])


def follow(value: float, target: float, lag_s: float, limit: float, dt_s: float) -> float:
    """One step of a first-order response whose rate is limited."""
    share = 1.0 - math.exp(-dt_s / lag_s) if lag_s > 0.0 else 1.0
    change = (target - value) * share
    return value + max(-limit * dt_s, min(limit * dt_s, change))
