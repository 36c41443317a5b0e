"""Synthetic sensors: the true mine and the true pose in, an `Observation` with everything that is wrong with it out."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled
from companion.config.sensors import SensorSettings
from companion.config.sim import NoiseSettings
from companion.geometry import rotation
from companion.model import BEAM_AXES, DepthFrame, Observation, PlanarScan, Pose, RangeReading, wrap_rad
from sitl.scene.live import LiveWorld
from sitl.scene.raycast import RayCaster
from sitl.scene.render import DepthRenderer

DRIFT_TURNS_M = 20.0
"""Way after which the drift of the estimated position has found a new direction."""


class PoseEstimate:
    """The pose as an estimator would give it: white noise, and drift that grows with the way flown.

    The drift has a direction that changes slowly along the way, as odometry errors do: it neither averages out within
    metres nor is one constant slant.
    """

    def __init__(self, noise: NoiseSettings, rng: np.random.Generator) -> None:
        self._noise = noise
        self._rng = rng
        self._drift_m = np.zeros(3)
        self._drift_direction = rng.standard_normal(3) / math.sqrt(3.0)
        self._last: Pose | None = None

    def of(self, true: Pose) -> Pose:
        """The estimate at the time of ``true``; call once a tick, in order of time."""
        noise = self._noise
        if not noise.enabled:
            return true
        if self._last is not None:
            flown_m = math.dist((true.x_m, true.y_m, true.z_m), (self._last.x_m, self._last.y_m, self._last.z_m))
            keep = math.exp(-flown_m / DRIFT_TURNS_M)
            push = self._rng.standard_normal(3) * math.sqrt((1.0 - keep * keep) / 3.0)
            self._drift_direction = keep * self._drift_direction + push
            self._drift_m += noise.pose_drift_share * flown_m * self._drift_direction
        self._last = true
        p = self._rng.standard_normal(9)
        x, y, z = self._drift_m + noise.pose_noise_m * p[:3]
        return replace(
            true,
            x_m=true.x_m + float(x),
            y_m=true.y_m + float(y),
            z_m=true.z_m + float(z),
            yaw_rad=wrap_rad(true.yaw_rad + noise.pose_noise_rad * float(p[3])),
            roll_rad=true.roll_rad + noise.pose_noise_rad * float(p[4]),
            pitch_rad=true.pitch_rad + noise.pose_noise_rad * float(p[5]),
            vx_mps=true.vx_mps + noise.velocity_noise_mps * float(p[6]),
            vy_mps=true.vy_mps + noise.velocity_noise_mps * float(p[7]),
            vz_mps=true.vz_mps + noise.velocity_noise_mps * float(p[8]),
        )


class SensorRig:
    """All sensors of one vehicle.

    Args:
        settings: what the vehicle carries.
        noise: what is wrong with it.
        caster: the mine for single rays.
        renderer: the mine for depth images.
        rng: for noise, dropouts and losses.
        live: what there is in the mine besides rock; None: nothing.
        number: which of several vehicles carries them.
    """

    def __init__(
        self,
        settings: SensorSettings,
        noise: NoiseSettings,
        caster: RayCaster,
        renderer: DepthRenderer,
        rng: np.random.Generator,
        live: LiveWorld | None = None,
        number: int = 1,
    ) -> None:
        self._number = number
        self._settings = settings
        self._noise = noise
        self._caster = caster
        self._renderer = renderer
        self._rng = rng
        self._live = live
        self._camera = settings.camera.model()
        self._estimate = PoseEstimate(noise, rng)
        self._next_frame_s = 0.0
        self._next_ranges_s = 0.0
        self._next_planar_s = 0.0
        self._in_flight: deque[tuple[float, DepthFrame]] = deque(maxlen=64)
        self._axes = np.array([BEAM_AXES[beam] for beam in settings.beams.directions])
        self._planar_rad = -math.pi + (np.arange(settings.planar.rays) + 0.5) * 2.0 * math.pi / settings.planar.rays

    def observe(self, true: Pose) -> Observation:
        """Everything that has newly arrived at the time of ``true``."""
        t_s = true.t_s
        pose = self._estimate.of(true)
        if _due(t_s, self._next_frame_s):
            self._next_frame_s = _after(self._next_frame_s, 1.0 / self._settings.camera.rate_hz, t_s)
            self._expose(true, pose)
        # Half a microsecond of tolerance: times are sums of periods.
        frame = None
        while self._in_flight and self._in_flight[0][0] <= t_s + 5e-7:
            frame = self._in_flight.popleft()[1]
        ranges: tuple[RangeReading, ...] = ()
        if _due(t_s, self._next_ranges_s):
            self._next_ranges_s = _after(self._next_ranges_s, 1.0 / self._settings.beams.rate_hz, t_s)
            ranges = self._beams(true)
        planar = None
        if self._settings.planar.enabled and _due(t_s, self._next_planar_s):
            self._next_planar_s = _after(self._next_planar_s, 1.0 / self._settings.planar.rate_hz, t_s)
            planar = self._planar(true, pose)
        return Observation(t_s, pose, frame, ranges, planar)

    def _expose(self, true: Pose, pose: Pose) -> None:
        noise = self._noise
        if noise.enabled and self._rng.random() < noise.frame_loss_share:
            return
        depth = self._renderer.render(true)
        if self._live is not None:
            depth = self._live.image(true, depth, self._rng, self._number)
        if noise.enabled:
            spread = self._rng.standard_normal(depth.shape, np.float32)
            # Drawn with replacement: this many draws leave the configured share undrawn.
            draws = -math.log1p(-noise.depth_dropout_share) * depth.size
            dropped = self._rng.integers(0, depth.size, round(draws))
            _spoil(depth, spread, dropped, noise.depth_noise_per_m2)
        depth[depth < self._camera.min_range_m] = np.nan
        delay_s = noise.depth_latency_s if noise.enabled else 0.0
        self._in_flight.append((true.t_s + delay_s, DepthFrame(true.t_s, depth, self._camera, pose)))

    def _beams(self, true: Pose) -> tuple[RangeReading, ...]:
        beams = self._settings.beams
        return tuple(
            RangeReading(
                beam, true.t_s, None if math.isnan(r) else min(max(float(r), 0.0), beams.max_range_m), beams.max_range_m
            )
            for beam, r in zip(beams.directions, self._measured(true, self._axes), strict=True)
        )

    def _planar(self, true: Pose, pose: Pose) -> PlanarScan:
        planar = self._settings.planar
        axes = np.stack([np.cos(self._planar_rad), np.sin(self._planar_rad), np.zeros(planar.rays)], axis=1)
        return PlanarScan(true.t_s, self._planar_rad, self._measured(true, axes), planar.max_range_m, pose)

    def _measured(self, true: Pose, axes: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n,) ranges along axes (n, 3) of the body, with their noise; NaN where nothing came back."""
        noise = self._noise
        directions = axes @ rotation(true.yaw_rad, true.pitch_rad, true.roll_rad).T
        origins = np.broadcast_to(np.array([true.x_m, true.y_m, true.z_m]), directions.shape)
        ranges = np.asarray(self._caster.cast(origins, directions), np.float64)
        if self._live is not None:
            ranges = self._live.ranges(true, origins, directions, ranges, self._rng, self._number)
        if noise.enabled:
            ranges = ranges + noise.range_noise_m * self._rng.standard_normal(ranges.size)
            ranges[self._rng.random(ranges.size) < noise.range_dropout_share] = np.nan
        return ranges


@compiled
def _spoil(
    depth: NDArray[np.float32], spread: NDArray[np.float32], dropped: NDArray[np.int64], noise_per_m2: float
) -> None:
    """Depth noise that grows with the square of the depth, as in stereo cameras, and dropped pixels, in place."""
    z, noise = depth.ravel(), spread.ravel()
    scale = np.float32(noise_per_m2)
    for i in range(z.size):
        # No surface is infinitely far, and infinity times noise would be a NaN.
        if z[i] < np.inf:
            z[i] += scale * z[i] * z[i] * noise[i]
    for i in dropped:
        z[i] = np.nan


def _due(t_s: float, next_s: float) -> bool:
    return t_s >= next_s - 5e-7


def _after(due_s: float, period_s: float, t_s: float) -> float:
    """The next due time, on the sensor's own grid, without catching up on missed ones."""
    return max(due_s + period_s, t_s - period_s)
