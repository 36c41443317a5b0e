"""The words of the domain.

World frame: east-north-up. Body frame: forward-left-up. Angles are counter-clockwise positive, in rad, wrapped to
[-π, π); a bearing of 0 is the heading, so a wall on the right has a negative bearing. Lengths in m, times in s.
Missing is ``None`` (or NaN inside a depth image), never zero.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from companion.sides import NOTHING_AROUND, Sides

FloatArray = NDArray[np.float64]
"""One-dimensional unless a docstring says otherwise."""

UNKNOWN, CLEAR, HIT = np.uint8(0), np.uint8(1), np.uint8(2)
"""What is known of one bearing of a `Scan`: nobody looked; seen free out to the range; an obstacle at the range."""

FRONT_RAD = math.radians(135.0)
"""d_f of the paper counts the front, left and right faces: bearings within this of the heading."""

ABSURD = 1e6
"""No number of a flight is larger, in m, m/s or rad: a thousand kilometres away. Times may be.

A NaN is not smaller either, so one comparison finds both.
"""

MOST_RAYS = 65536
"""No planar scanner has more rays a turn."""


class Mode(enum.StrEnum):
    """The modes of the paper's navigation law (7), and the one in which nothing may move."""

    CIRCLE = "R1"
    TANGENT = "R2"
    BOUNDARY = "R3"
    HOLD = "hold"


class Beam(enum.StrEnum):
    """Where a single-beam rangefinder looks, in the body frame."""

    FRONT = "front"
    LEFT = "left"
    BACK = "back"
    RIGHT = "right"
    DOWN = "down"
    UP = "up"


BEAM_AXES = {
    Beam.FRONT: (1.0, 0.0, 0.0),
    Beam.LEFT: (0.0, 1.0, 0.0),
    Beam.BACK: (-1.0, 0.0, 0.0),
    Beam.RIGHT: (0.0, -1.0, 0.0),
    Beam.DOWN: (0.0, 0.0, -1.0),
    Beam.UP: (0.0, 0.0, 1.0),
}
"""Where each beam looks: a unit vector in the body frame."""


@dataclass(frozen=True, slots=True)
class Pose:
    """Where the vehicle is and how it moves, estimated or true, at time ``t_s``.

    The attitude is R = Rz(yaw) Ry(pitch) Rx(roll) in ENU/FLU, so a positive pitch points the nose down and a positive
    roll lifts the left side. Velocities are in the world frame.
    """

    t_s: float
    x_m: float
    y_m: float
    z_m: float
    yaw_rad: float
    roll_rad: float = 0.0
    pitch_rad: float = 0.0
    vx_mps: float = 0.0
    vy_mps: float = 0.0
    vz_mps: float = 0.0
    yaw_rate_radps: float = 0.0

    def towards_mps(self, bearing_rad: float) -> float:
        """How fast it flies in that direction, in the plane; 0 is along the heading."""
        direction_rad = self.yaw_rad + bearing_rad
        return self.vx_mps * math.cos(direction_rad) + self.vy_mps * math.sin(direction_rad)

    @property
    def is_finite_in_plane(self) -> bool:
        """Whether place, heading and velocity in the plane can be numbers: each is smaller than `ABSURD`."""
        return all(abs(value) < ABSURD for value in (self.x_m, self.y_m, self.yaw_rad, self.vx_mps, self.vy_mps))

    @property
    def is_finite(self) -> bool:
        """Whether every number that places something can be one: points carried by a NaN would be kept and spread."""
        rest = (self.z_m, self.roll_rad, self.pitch_rad)
        # No bound for the time: it counts from the start of the computer, which may be months ago.
        return math.isfinite(self.t_s) and self.is_finite_in_plane and all(abs(value) < ABSURD for value in rest)


@dataclass(frozen=True, slots=True)
class Camera:
    """A pinhole depth camera and where it sits on the body.

    Pixel (u, v) has its centre at integer coordinates, u to the right and v down; its ray in the camera's own
    forward-left-up frame is (1, -(u - cx)/fx, -(v - cy)/fy).
    """

    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    min_range_m: float
    max_range_m: float
    mount_x_m: float = 0.0
    mount_y_m: float = 0.0
    mount_z_m: float = 0.0
    mount_yaw_rad: float = 0.0
    mount_pitch_rad: float = 0.0


@dataclass(frozen=True, slots=True)
class DepthFrame:
    """One depth image, with the pose at its own exposure.

    Attributes:
        t_s: when the image was exposed, not when it arrived.
        depth_m: (height, width) float32, distance along the optical axis (as depth cameras give it, not along the
            ray). NaN: nothing was measured there. At or beyond ``camera.max_range_m``: seen free out to that limit.
        camera: the camera that took it.
        pose: the estimated pose at ``t_s``.
    """

    t_s: float
    depth_m: NDArray[np.float32]
    camera: Camera
    pose: Pose


@dataclass(frozen=True, slots=True)
class RangeReading:
    """One reading of a single-beam rangefinder, along the body axis of ``beam``.

    ``range_m`` is ``None`` when nothing was measured; at or beyond ``max_range_m`` it says "free out to there".
    """

    beam: Beam
    t_s: float
    range_m: float | None
    max_range_m: float


@dataclass(frozen=True, slots=True)
class PlanarScan:
    """One turn of a planar scanner mounted level on the body: bearings ascending, NaN where nothing was measured."""

    t_s: float
    bearings_rad: FloatArray
    ranges_m: FloatArray
    max_range_m: float
    pose: Pose


@dataclass(frozen=True, slots=True)
class Observation:
    """What the sensors measured by ``t_s``: only what is new since the last observation."""

    t_s: float
    pose: Pose
    frame: DepthFrame | None = None
    ranges: tuple[RangeReading, ...] = ()
    planar: PlanarScan | None = None


class Scan(NamedTuple):
    """The horizontal measurement N(t) (paper Definition 3.8) as polar pairs about the vehicle.

    A tuple, so that compiled functions take it whole.

    Attributes:
        bearings_rad: (n,) ascending in [-π, π), evenly spaced over the full turn.
        ranges_m: (n,) the obstacle's distance where HIT, the range limit where CLEAR, 0 where UNKNOWN.
        state: (n,) uint8, one of `UNKNOWN`, `CLEAR`, `HIT`.
        fresh: (n,) bool, True where a sensor looked just now, False where the value is remembered.
    """

    bearings_rad: FloatArray
    ranges_m: FloatArray
    state: NDArray[np.uint8]
    fresh: NDArray[np.bool_]


class Input(enum.StrEnum):
    """What the vehicle cannot fly without; the values stand in recordings and messages."""

    DEPTH = "depth"
    """A look ahead that is recent enough."""
    HEIGHT = "height"
    """The height above ground."""
    POSE = "pose"
    """A recent pose that is finite."""


@dataclass(frozen=True, slots=True)
class Measurement:
    """What the navigator sees in one tick (paper Definitions 3.7 and 3.8, and d, d_f of (12)).

    Attributes:
        t_s: time of the tick.
        scan_age_s: how old the newest look ahead is, in s.
        scan: N(t), or ``None`` when nothing has looked ahead recently enough.
        h_m: height above ground along gravity, tilt compensated; ``None`` when not known.
        roof_m: free height above the vehicle, and above the way that it needs to stand; ``None`` when not known.
        rise_m: by how much the highest ground on the way that it needs to stand lies above that below it.
        ground_slope: rise over run of the ground ahead along the heading; ``None`` when not known.
        d_m: least horizontal distance to any obstacle; ``None`` when nothing is near enough to be seen.
        d_bearing_rad: bearing α* of that obstacle.
        d_front_m: the same least distance over bearings within 135° of the heading (d_f).
        d_dot_mps: rate of change of d.
        ahead_m: distance to the nearest obstacle ahead within the width of the body, from its centre; infinite when
            what is known there is free, NaN when nothing is known there.
        ranges_age_s: age of the newest reading of the beam that has been silent longest, of those that the vehicle
            counts on; infinite when one has never reported.
        missing: the inputs that are absent or stale; empty when the vehicle may fly.
        over_shaft: whether the beam downward says that there is no ground as far as it reaches, where there was some.
        sides: what is near on the four sides of the body, as seen in the last seconds, and whether it comes nearer.
    """

    t_s: float
    scan_age_s: float
    scan: Scan | None
    h_m: float | None
    roof_m: float | None
    ground_slope: float | None
    d_m: float | None
    d_bearing_rad: float | None
    d_front_m: float | None
    d_dot_mps: float | None
    ahead_m: float
    ranges_age_s: float
    missing: tuple[Input, ...] = ()
    sides: Sides = NOTHING_AROUND
    over_shaft: bool = False
    rise_m: float = 0.0


@dataclass(frozen=True, slots=True)
class Setpoint:
    """What the vehicle is asked to do, in the body frame: forward, up, turning counter-clockwise, and to the left.

    The laws steer by speed and turn alone. To the left, and backward, goes only what is to stand and has crept away, or
    what has come too near to a wall.
    """

    t_s: float
    speed_mps: float
    climb_mps: float
    yaw_rate_radps: float
    lateral_mps: float = 0.0


def wrap_rad(angle_rad: float) -> float:
    """The same angle in [-π, π)."""
    wrapped = (angle_rad + math.pi) % (2.0 * math.pi) - math.pi
    # The modulo rounds the number just below -π up to a full turn.
    return wrapped if wrapped < math.pi else -math.pi
