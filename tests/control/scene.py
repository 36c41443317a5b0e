"""A flat world of polygons, exact to rounding: what a perfect scanner sees of it, and the paper's vehicle (1) in it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from companion.config.control import ControlSettings
from companion.control.navigator import Navigator
from companion.model import (
    CLEAR,
    FRONT_RAD,
    HIT,
    UNKNOWN,
    FloatArray,
    Input,
    Measurement,
    Mode,
    Pose,
    Scan,
    Setpoint,
    wrap_rad,
)

BINS = 360
BEARINGS_RAD: FloatArray = -math.pi + (np.arange(BINS) + 0.5) * 2.0 * math.pi / BINS
"""One bearing a degree, symmetric about the heading, as the vehicle's own scan has them."""

CAMERA_RAD = math.radians(86.0)
"""Field of view of the paper's camera."""

LIMIT_M = 10.0
"""Seen free out to here where nothing is hit."""

MEMORY_M = 5.0
"""Outside of the camera's view, walls within this distance are remembered."""

"""d_f counts bearings up to here (METHOD: front, left and right)."""

Point = tuple[float, float]


def law_parameters(**changes: object) -> ControlSettings:
    """The law's default settings with changes, validated as those of a flight are."""
    return ControlSettings.model_validate(changes)


def box(x_min: float, y_min: float, x_max: float, y_max: float) -> list[Point]:
    """The corners of an upright rectangle."""
    return [(x_min, y_min), (x_max, y_min), (x_max, y_max), (x_min, y_max)]


class Scene:
    """Walls in the plane.

    Args:
        polygons: closed outlines; it does not matter which side of them is rock.
    """

    def __init__(self, *polygons: Sequence[Point]) -> None:
        edges = [(*a, *b) for polygon in polygons for a, b in zip(polygon, [*polygon[1:], polygon[0]], strict=True)]
        self._walls = np.array(edges, np.float64).reshape(-1, 4)

    def mirrored(self) -> Scene:
        """The same world with left and right exchanged: y becomes -y."""
        other = Scene()
        other._walls = self._walls * np.array([1.0, -1.0, 1.0, -1.0])
        return other

    def ranges_m(self, x_m: float, y_m: float, directions_rad: FloatArray) -> FloatArray:
        """(n,) distance to the first wall in each world direction; inf where there is none."""
        if not len(self._walls):
            return np.full(directions_rad.size, np.inf)
        ax, ay, bx, by = (self._walls - np.array([x_m, y_m, x_m, y_m])).T[:, :, None]
        ex, ey = bx - ax, by - ay
        dx, dy = np.cos(directions_rad), np.sin(directions_rad)
        turn = ey * dx - ex * dy
        # A ray along a wall never meets it: this sends the meeting point far off without dividing by zero.
        turn[turn == 0.0] = 1e-200
        along, share = (ax * ey - ay * ex) / turn, (ax * dy - ay * dx) / turn
        met = (along > 0.0) & (share >= 0.0) & (share <= 1.0)
        return np.asarray(np.where(met, along, np.inf).min(axis=0), np.float64)

    def nearest(self, x_m: float, y_m: float) -> tuple[float, float]:
        """Distance to the nearest wall and the world direction of it; inf, 0 in an empty world."""
        if not len(self._walls):
            return math.inf, 0.0
        a, b = self._walls[:, :2] - np.array([x_m, y_m]), self._walls[:, 2:] - np.array([x_m, y_m])
        e = b - a
        share = np.clip(-np.sum(a * e, axis=1) / np.sum(e * e, axis=1), 0.0, 1.0)
        foot = a + share[:, None] * e
        distance = np.hypot(foot[:, 0], foot[:, 1])
        i = int(np.argmin(distance))
        return float(distance[i]), math.atan2(foot[i, 1], foot[i, 0])

    def scan(self, pose: Pose, view_rad: float = 2.0 * math.pi, limit_m: float = LIMIT_M) -> Scan:
        """N(t): HIT and CLEAR, just seen, within the view; beyond it walls near by are remembered, all else UNKNOWN."""
        true_m = self.ranges_m(pose.x_m, pose.y_m, pose.yaw_rad + BEARINGS_RAD)
        fresh = np.abs(BEARINGS_RAD) <= view_rad / 2.0
        state = np.where(true_m < limit_m, HIT, CLEAR)
        state = np.where(fresh, state, np.where(true_m < MEMORY_M, HIT, UNKNOWN)).astype(np.uint8)
        ranges = np.where(state == HIT, true_m, np.where(state == CLEAR, limit_m, 0.0))
        return Scan(BEARINGS_RAD.copy(), ranges, state, fresh)

    def measure(self, pose: Pose, view_rad: float = 2.0 * math.pi, h_m: float = 1.5) -> Measurement:
        """What a vehicle without sensor errors measures here."""
        scan = self.scan(pose, view_rad)
        d_m, direction_rad = self.nearest(pose.x_m, pose.y_m)
        if d_m > LIMIT_M:
            return measurement(scan, pose.t_s, h_m=h_m)
        bearing_rad = wrap_rad(direction_rad - pose.yaw_rad)
        in_front = scan.ranges_m[(scan.state == HIT) & (np.abs(scan.bearings_rad) <= FRONT_RAD)]
        d_front_m = d_m if abs(bearing_rad) <= FRONT_RAD else float(np.min(in_front, initial=math.inf))
        closing_mps = pose.vx_mps * math.cos(direction_rad) + pose.vy_mps * math.sin(direction_rad)
        return measurement(
            scan,
            pose.t_s,
            d_m=d_m,
            d_bearing_rad=bearing_rad,
            d_front_m=d_front_m if math.isfinite(d_front_m) else None,
            d_dot_mps=-closing_mps,
            h_m=h_m,
        )


def measurement(
    scan: Scan | None,
    t_s: float = 0.0,
    *,
    d_m: float | None = None,
    d_bearing_rad: float | None = None,
    d_front_m: float | None = None,
    d_dot_mps: float | None = None,
    h_m: float | None = 1.5,
    missing: tuple[Input, ...] = (),
) -> Measurement:
    """A measurement in which nothing is near but what is given."""
    return Measurement(
        t_s=t_s,
        scan_age_s=0.0,
        scan=scan,
        h_m=h_m,
        roof_m=None,
        ground_slope=None,
        d_m=d_m,
        d_bearing_rad=d_bearing_rad,
        d_front_m=d_front_m,
        d_dot_mps=d_dot_mps,
        ahead_m=math.nan,
        ranges_age_s=0.0,
        missing=missing,
    )


def mirrored_scan(scan: Scan) -> Scan:
    """The same scan with left and right exchanged."""
    return Scan(
        -scan.bearings_rad[::-1].copy(),
        scan.ranges_m[::-1].copy(),
        scan.state[::-1].copy(),
        scan.fresh[::-1].copy(),
    )


def mirrored_measurement(seen: Measurement) -> Measurement:
    return replace(
        seen,
        scan=None if seen.scan is None else mirrored_scan(seen.scan),
        d_bearing_rad=None if seen.d_bearing_rad is None else -seen.d_bearing_rad,
    )


def mirrored_pose(pose: Pose) -> Pose:
    return replace(
        pose,
        y_m=-pose.y_m,
        yaw_rad=-pose.yaw_rad,
        roll_rad=-pose.roll_rad,
        vy_mps=-pose.vy_mps,
        yaw_rate_radps=-pose.yaw_rate_radps,
    )


def scan_of(ranges_m: Callable[[float], float], limit_m: float = LIMIT_M) -> Scan:
    """A scan whose range at each bearing is given by a function: CLEAR from the limit on, UNKNOWN where it is NaN."""
    ranges: FloatArray = np.array([ranges_m(float(bearing)) for bearing in BEARINGS_RAD])
    unknown = np.isnan(ranges)
    clear = ranges >= limit_m
    state: NDArray[np.uint8] = np.where(unknown, UNKNOWN, np.where(clear, CLEAR, HIT)).astype(np.uint8)
    return Scan(
        BEARINGS_RAD.copy(),
        np.where(unknown, 0.0, np.where(clear, limit_m, ranges)),
        state,
        np.ones(BINS, np.bool_),
    )


def unicycle(pose: Pose, setpoint: Setpoint, dt_s: float) -> Pose:
    """One sampling period of the paper's model (1) under constant inputs, solved exactly."""
    half_rad = 0.5 * setpoint.yaw_rate_radps * dt_s
    chord_m = setpoint.speed_mps * dt_s * (math.sin(half_rad) / half_rad if half_rad != 0.0 else 1.0)
    yaw_rad = wrap_rad(pose.yaw_rad + 2.0 * half_rad)
    return Pose(
        t_s=pose.t_s + dt_s,
        x_m=pose.x_m + chord_m * math.cos(pose.yaw_rad + half_rad),
        y_m=pose.y_m + chord_m * math.sin(pose.yaw_rad + half_rad),
        z_m=pose.z_m + setpoint.climb_mps * dt_s,
        yaw_rad=yaw_rad,
        vx_mps=setpoint.speed_mps * math.cos(yaw_rad),
        vy_mps=setpoint.speed_mps * math.sin(yaw_rad),
        vz_mps=setpoint.climb_mps,
        yaw_rate_radps=setpoint.yaw_rate_radps,
    )


@dataclass
class Track:
    """What happened in a flight, one entry a sampling period."""

    poses: list[Pose] = field(default_factory=list)
    seen: list[Measurement] = field(default_factory=list)
    setpoints: list[Setpoint] = field(default_factory=list)
    modes: list[Mode] = field(default_factory=list)

    def distances_m(self) -> FloatArray:
        """(n,) true d; inf where nothing was near."""
        return np.array([math.inf if m.d_m is None else m.d_m for m in self.seen])

    def yaw_rates_radps(self) -> FloatArray:
        """(n,) commanded yaw rates."""
        return np.array([setpoint.yaw_rate_radps for setpoint in self.setpoints])


def fly(
    navigator: Navigator,
    scene: Scene,
    start: Pose,
    duration_s: float,
    *,
    view_rad: float = 2.0 * math.pi,
    disturb: Callable[[Measurement, Pose], tuple[Measurement, Pose]] | None = None,
) -> Track:
    """Close the loop: measure, step, move on by one sampling period.

    Args:
        navigator: what flies.
        scene: the world.
        start: where the flight begins.
        duration_s: for how long.
        view_rad: the camera's field of view.
        disturb: makes of the true measurement and pose the ones which the navigator is told.
    """
    dt_s, pose, track = navigator.parameters.period_s, start, Track()
    for _ in range(round(duration_s / dt_s)):
        seen = scene.measure(pose, view_rad, h_m=pose.z_m)
        told = (seen, pose) if disturb is None else disturb(seen, pose)
        setpoint = navigator.step(*told, pose.t_s)
        track.poses.append(pose)
        track.seen.append(seen)
        track.setpoints.append(setpoint)
        track.modes.append(navigator.status.mode)
        pose = unicycle(pose, setpoint, dt_s)
    return track
