"""The state machine of the paper's algorithm A1 to A4: `Navigator.step` reads like Section 3."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass

import numpy as np

from companion.control import edges, laws
from companion.control.edges import Edge
from companion.control.governor import governed_speed_mps
from companion.control.known_ground import KnownGround, WallFollowing
from companion.control.parameters import Parameters
from companion.control.tangents import TangentLedger
from companion.model import HIT, Measurement, Mode, Pose, Scan, Setpoint, wrap_rad

FORGET_TANGENT_S = 5.0
"""A tangent out of view for this long is a new one when it comes back: ten metres of flight would be too far for the
same edge to stay ahead, half a second would be a flicker of the scan."""

OBSTACLE_AHEAD_RAD = math.radians(60.0)
"""In R2 the boundary is reached when an obstacle at d_s lies within this bearing: further round it is passed by."""

STUCK_TURNS = 2.0
"""Full turns in R3 without moving on by d_s, after which the vehicle is where S has no room (below 2·d_s)."""

LOST_WALL_S = 3.0
"""In R3 with nothing at all in view for this long there is no boundary to follow."""

LOOK_PERIOD_S = 0.5
"""Time between two entries into the ground that is known to be seen."""

SAME_WAY_M = 2.0
"""Ways to unseen ground that differ by less than this, four cells, do not decide."""


ABSURD = 1e6
"""No number that steers is larger, in m, m/s or rad: a NaN is not smaller either, so one comparison finds both."""

LAP_M = 8.0
"""A closed boundary is longer than this: shorter ones are turns on the spot, which have a rule of their own."""

LAP_SETTLED_M = 2.0
"""A lap begins this far into R3, when the vehicle flies along the wall that it came to."""

LAP_CLOSED_M, LAP_CLOSED_RAD = 1.0, math.radians(60.0)
"""The vehicle has come round when it is as near as this to where it began to follow, heading the same way."""


class TargetKind(enum.StrEnum):
    """Why the vehicle flies to a target in R2."""

    TANGENT = "tangent"
    """A tangent point, the paper's rule."""
    WALL = "wall"
    """Our extension: after a full turn in R1 without a tangent, the d_s-offset of the nearest wall."""
    OPEN = "open"
    """Our extension: out of a place without room, away from a boundary followed once round, or from nothing."""


@dataclass(frozen=True, slots=True)
class Target:
    """An intermediate target T_m in the world frame, and the line from where it was chosen."""

    x_m: float
    y_m: float
    from_x_m: float
    from_y_m: float
    since_s: float
    timeout_s: float
    kind: TargetKind


@dataclass(frozen=True, slots=True)
class Status:
    """What the navigator is doing, for displays and records."""

    mode: Mode
    gamma: int
    target: Target | None
    draws: int
    accepted: int
    mode_changes: int
    extensions: int


class Navigator:
    """The switching navigation law of the paper, one call a sampling period.

    Args:
        parameters: the law's settings.
        rng: the only source of randomness: the side of the initial circle, the draws at tangents.
    """

    def __init__(self, parameters: Parameters, rng: np.random.Generator) -> None:
        self.parameters = parameters
        self.height_m = parameters.height_m
        """H, which law (11) changes when several vehicles share the mine."""
        self._rng = rng
        self._mode = Mode.CIRCLE
        self._gamma = self._either_side()
        self._circle_direction = self._either_side()
        self._target: Target | None = None
        self._ledger = TangentLedger(parameters.margin_m, FORGET_TANGENT_S)
        self._ground = KnownGround()
        self._next_look_s = -math.inf
        self._pause_until_s = -math.inf
        self._turned_rad = 0.0
        self._last_yaw_rad: float | None = None
        self._anchor = (math.inf, math.inf)
        self._boundary_seen_s = -math.inf
        self._lap_start: Pose | None = None
        self._lap_m = 0.0
        self._last_pose: Pose | None = None
        self._holding = False
        self._draws = 0
        self._accepted = 0
        self._mode_changes = 0
        self._extensions = 0

    @property
    def status(self) -> Status:
        """What the navigator is doing now."""
        return Status(
            mode=Mode.HOLD if self._holding else self._mode,
            gamma=self._gamma,
            target=self._target,
            draws=self._draws,
            accepted=self._accepted,
            mode_changes=self._mode_changes,
            extensions=self._extensions,
        )

    def step(self, measurement: Measurement, pose: Pose, t_s: float) -> Setpoint:
        """One sampling period: switch the mode if a rule says so, then execute the laws (6), (7) and (12).

        Whatever is missing or not finite stops the vehicle: a setpoint is always finite.
        """
        scan = measurement.scan
        self._holding = bool(measurement.missing) or scan is None or not _is_finite(measurement, pose)
        climb = self._climb_mps(measurement, pose)
        if self._holding or scan is None:
            self._last_yaw_rad = None
            return Setpoint(t_s, 0.0, climb, 0.0)
        self._count_turning(pose)
        self._see(scan, pose, t_s)
        if self._mode is Mode.CIRCLE:
            self._leave_circle(scan, pose, t_s)
        elif self._mode is Mode.TANGENT:
            self._leave_tangent(measurement, pose, t_s)
        elif self._mode is Mode.BOUNDARY:
            self._leave_boundary(measurement, scan, pose, t_s)
        return Setpoint(t_s, self._speed_mps(measurement, scan, pose), climb, self._yaw_rate_radps(measurement, pose))

    # The laws.

    def _yaw_rate_radps(self, measurement: Measurement, pose: Pose) -> float:
        """Paper eq. (7)."""
        if self._mode is Mode.CIRCLE:
            return laws.circle_yaw_rate_radps(self._circle_direction, self.parameters)
        if self._mode is Mode.TANGENT:
            return laws.tangent_yaw_rate_radps(self._target_bearing_rad(pose), self.parameters)
        if measurement.d_m is None or measurement.d_bearing_rad is None or measurement.d_dot_mps is None:
            return 0.0
        d_dot_mps = measurement.d_dot_mps
        if self.parameters.law == "smooth":
            d_dot_mps = min(d_dot_mps, laws.cruising_rate_mps(measurement.d_bearing_rad, self.parameters))
        return laws.boundary_yaw_rate_radps(self._gamma, measurement.d_m, d_dot_mps, self.parameters)

    def _speed_mps(self, measurement: Measurement, scan: Scan, pose: Pose) -> float:
        """Paper eq. (12), lowered by the governor."""
        speed = laws.speed_mps(self._mode, measurement.d_front_m, self.parameters)
        if self._mode is Mode.TANGENT and (self._escapes() or self.parameters.speed_law == "governor"):
            speed *= max(0.0, math.cos(self._target_bearing_rad(pose)))
        if self.parameters.speed_law == "paper" or speed == 0.0:
            return speed
        gamma = self._gamma if self._mode is Mode.BOUNDARY else None
        forward_mps = pose.vx_mps * math.cos(pose.yaw_rad) + pose.vy_mps * math.sin(pose.yaw_rad)
        nearest_m = math.inf if measurement.d_m is None else measurement.d_m
        return governed_speed_mps(speed, scan, nearest_m, gamma, forward_mps, self.parameters)

    def _climb_mps(self, measurement: Measurement, pose: Pose) -> float:
        """Paper eq. (6); 0 when the height is not known."""
        if measurement.h_m is None or not math.isfinite(measurement.h_m):
            return 0.0
        ground_climb = 0.0
        slope = measurement.ground_slope
        if self.parameters.climb_feed_forward and slope is not None and math.isfinite(slope) and not self._holding:
            forward = pose.vx_mps * math.cos(pose.yaw_rad) + pose.vy_mps * math.sin(pose.yaw_rad)
            ground_climb = forward * slope
        return laws.climb_mps(self.height_m, measurement.h_m, measurement.roof_m, ground_climb, self.parameters)

    # The rules.

    def _leave_circle(self, scan: Scan, pose: Pose, t_s: float) -> None:
        """R1 -> R2 at the first tangent; after a full turn without one, our extension."""
        for edge in edges.find_edges(scan, self.parameters):
            if self._corridor_is_free(scan, edge):
                self._pursue(edge, pose, t_s)
                return
        if abs(self._turned_rad) >= 2.0 * math.pi:
            self._extend(scan, pose, t_s)

    def _leave_tangent(self, measurement: Measurement, pose: Pose, t_s: float) -> None:
        """R2 -> R3 at T_m, past T_m, or at a boundary that comes first; R2 -> R1 when T_m is not reached in time."""
        target = self._target
        assert target is not None  # noqa: S101 - R2 is entered only with a target
        to_go_m = math.hypot(target.x_m - pose.x_m, target.y_m - pose.y_m)
        along_x, along_y = target.x_m - target.from_x_m, target.y_m - target.from_y_m
        passed = (target.x_m - pose.x_m) * along_x + (target.y_m - pose.y_m) * along_y <= 0.0
        if to_go_m < self.parameters.target_radius_m or passed:
            self._enter(Mode.BOUNDARY, pose, t_s)
        elif t_s - target.since_s > target.timeout_s:
            self._enter(Mode.CIRCLE, pose, t_s)
        elif self._escapes() and abs(self._target_bearing_rad(pose)) >= math.pi / 2.0:
            # It stands and turns away from the very wall that it escapes from, which has come first already.
            return
        elif measurement.d_bearing_rad is not None and self._boundary_comes_first(measurement):
            if target.kind is not TargetKind.WALL:
                self._gamma = 1 if measurement.d_bearing_rad > 0.0 else -1
            self._enter(Mode.BOUNDARY, pose, t_s)

    def _boundary_comes_first(self, measurement: Measurement) -> bool:
        """Whether an obstacle at d_s lies ahead, or one well inside of d_s beside: R2 alone would not leave it."""
        if measurement.d_m is None or measurement.d_bearing_rad is None:
            return False
        ahead_rad = abs(measurement.d_bearing_rad)
        inside_m = 0.5 * (self.parameters.margin_m + self.parameters.critical_margin_m)
        return (measurement.d_m <= self.parameters.margin_m and ahead_rad < OBSTACLE_AHEAD_RAD) or (
            measurement.d_m <= inside_m and ahead_rad < math.pi / 2.0
        )

    def _leave_boundary(self, measurement: Measurement, scan: Scan, pose: Pose, t_s: float) -> None:
        """R3 -> R2 with probability p at a tangent, one draw each; R3 -> R1 when there is no boundary any more."""
        if measurement.d_m is not None:
            self._boundary_seen_s = t_s
        elif t_s - self._boundary_seen_s > LOST_WALL_S:
            self._enter(Mode.CIRCLE, pose, t_s)
            return
        if math.hypot(pose.x_m - self._anchor[0], pose.y_m - self._anchor[1]) > self.parameters.margin_m:
            self._anchor = (pose.x_m, pose.y_m)
            self._turned_rad = 0.0
        elif abs(self._turned_rad) > STUCK_TURNS * 2.0 * math.pi:
            self._escape(scan, pose, t_s)
            return
        if not edges.has_way_on(scan, self.parameters.critical_margin_m):
            self._escape(scan, pose, t_s)
            return
        if self._has_come_round(pose) and self._rng.random() < self._lap_probability():
            self._escape(scan, pose, t_s)
            return
        for edge in edges.find_edges(scan, self.parameters):
            x_m, y_m = _world(pose, edge.near_bearing_rad, edge.near_range_m)
            if self._ledger.seen_before(x_m, y_m, edge.gamma, t_s) or t_s < self._pause_until_s:
                continue
            if edge.gamma == self._gamma and edges.lies_along_boundary(scan, edge, self.parameters.margin_m):
                continue
            if not self._corridor_is_free(scan, edge):
                continue
            self._ledger.decide(x_m, y_m, edge.gamma, t_s)
            self._draws += 1
            if self._rng.random() < self._probability(edge, pose):
                self._accepted += 1
                self._pursue(edge, pose, t_s)
            else:
                self._pause_until_s = t_s + self.parameters.pause_s
            return

    def _has_come_round(self, pose: Pose) -> bool:
        """Whether the boundary has been followed once round since R3 began, or since the last such lap.

        Our extension: a boundary that meets no tangent would be followed for ever, always the same way round, and what
        the camera sees only in the other direction never comes into view. So a whole lap is a decision as well.
        """
        if self._lap_start is None or self._last_pose is None:
            self._lap_start, self._lap_m = pose, 0.0
        else:
            self._lap_m += math.hypot(pose.x_m - self._last_pose.x_m, pose.y_m - self._last_pose.y_m)
        self._last_pose = pose
        if self._lap_m < LAP_SETTLED_M:
            # It comes to the wall at any angle, and will not pass here like that again.
            self._lap_start = pose
            return False
        apart_m = math.hypot(pose.x_m - self._lap_start.x_m, pose.y_m - self._lap_start.y_m)
        turned_rad = abs(wrap_rad(pose.yaw_rad - self._lap_start.yaw_rad))
        if self._lap_m < LAP_M or apart_m > LAP_CLOSED_M or turned_rad > LAP_CLOSED_RAD:
            return False
        self._lap_start, self._lap_m = pose, LAP_SETTLED_M
        return True

    def _lap_probability(self) -> float:
        """A lap without a tangent taken has nothing new ahead: p, or with frontier the most that p_min leaves."""
        parameters = self.parameters
        return parameters.tangent_probability if parameters.choice == "coin" else 1.0 - parameters.least_probability

    def _probability(self, edge: Edge, pose: Pose) -> float:
        """Probability of leaving along this tangent: p, or with frontier a preference for what is unseen."""
        p = self.parameters.tangent_probability
        if self.parameters.choice == "coin":
            return p
        target = _world(pose, edge.target_bearing_rad, edge.target_range_m)
        by_tangent_m, by_boundary_m = self._ground.way_to_unseen_m(
            (pose.x_m, pose.y_m),
            (
                WallFollowing(*target, pose.yaw_rad + edge.target_bearing_rad, edge.gamma),
                WallFollowing(pose.x_m, pose.y_m, pose.yaw_rad, self._gamma),
            ),
        )
        if abs(by_tangent_m - by_boundary_m) < SAME_WAY_M or by_tangent_m == by_boundary_m:
            return p
        least = self.parameters.least_probability
        return 1.0 - least if by_tangent_m < by_boundary_m else least

    def _see(self, scan: Scan, pose: Pose, t_s: float) -> None:
        """Note what has been seen, twice a second: that is every quarter of a metre."""
        if self.parameters.choice == "frontier" and t_s >= self._next_look_s:
            self._next_look_s = t_s + LOOK_PERIOD_S
            self._ground.see(scan, pose)

    def _corridor_is_free(self, scan: Scan, edge: Edge) -> bool:
        half_width_m = edges.CORRIDOR_SHARE * self.parameters.margin_m
        return edges.corridor_is_free(scan, edge.target_bearing_rad, edge.target_range_m, half_width_m)

    def _pursue(self, edge: Edge, pose: Pose, t_s: float) -> None:
        self._gamma = edge.gamma
        self._fly_to(edge.target_bearing_rad, edge.target_range_m, TargetKind.TANGENT, pose, t_s)

    def _extend(self, scan: Scan, pose: Pose, t_s: float) -> None:
        """Not in the paper: R1 has nothing to find in a convex room, so go to the nearest wall and follow it."""
        hits = np.flatnonzero(scan.state == HIT)
        if hits.size == 0:
            self._escape(scan, pose, t_s)
            return
        nearest = int(hits[np.argmin(scan.ranges_m[hits])])
        self._extensions += 1
        self._gamma = self._either_side()
        room_m = float(scan.ranges_m[nearest]) - self.parameters.margin_m
        if room_m <= self.parameters.target_radius_m:
            self._enter(Mode.BOUNDARY, pose, t_s)
        else:
            self._fly_to(float(scan.bearings_rad[nearest]), room_m, TargetKind.WALL, pose, t_s)

    def _escape(self, scan: Scan, pose: Pose, t_s: float) -> None:
        """Not in the paper: leave along the longest corridor that the body fits through."""
        bearing_rad, length_m = edges.open_direction(scan, self.parameters.critical_margin_m)
        length_m -= self.parameters.margin_m
        if length_m <= self.parameters.target_radius_m:
            self._enter(Mode.CIRCLE, pose, t_s)
            return
        self._extensions += 1
        self._gamma = self._either_side()
        self._fly_to(bearing_rad, length_m, TargetKind.OPEN, pose, t_s)

    def _fly_to(self, bearing_rad: float, distance_m: float, kind: TargetKind, pose: Pose, t_s: float) -> None:
        x_m, y_m = _world(pose, bearing_rad, distance_m)
        straight_s = distance_m / self.parameters.speed_mps + abs(bearing_rad) / self.parameters.max_yaw_rate_radps
        timeout_s = self.parameters.target_timeout_factor * straight_s + 1.0
        self._target = Target(x_m, y_m, pose.x_m, pose.y_m, t_s, timeout_s, kind)
        self._enter(Mode.TANGENT, pose, t_s)

    def _enter(self, mode: Mode, pose: Pose, t_s: float) -> None:
        self._mode = mode
        self._mode_changes += 1
        self._turned_rad = 0.0
        self._anchor = (pose.x_m, pose.y_m)
        self._boundary_seen_s = t_s
        self._lap_start = None
        if mode is not Mode.TANGENT:
            self._target = None
        if mode is Mode.CIRCLE:
            self._circle_direction = self._either_side()

    def _count_turning(self, pose: Pose) -> None:
        if self._last_yaw_rad is not None:
            self._turned_rad += wrap_rad(pose.yaw_rad - self._last_yaw_rad)
        self._last_yaw_rad = pose.yaw_rad

    def _escapes(self) -> bool:
        return self._target is not None and self._target.kind is TargetKind.OPEN

    def _target_bearing_rad(self, pose: Pose) -> float:
        assert self._target is not None  # noqa: S101 - R2 is entered only with a target
        dx_m, dy_m = self._target.x_m - pose.x_m, self._target.y_m - pose.y_m
        return wrap_rad(math.atan2(dy_m, dx_m) - pose.yaw_rad)

    def _either_side(self) -> int:
        return 1 if self._rng.random() < 0.5 else -1


def _world(pose: Pose, bearing_rad: float, range_m: float) -> tuple[float, float]:
    """A point given in polar coordinates about the vehicle, in the world frame."""
    direction_rad = pose.yaw_rad + bearing_rad
    return pose.x_m + range_m * math.cos(direction_rad), pose.y_m + range_m * math.sin(direction_rad)


def _is_finite(measurement: Measurement, pose: Pose) -> bool:
    """Whether everything that steers can be a number; what is not known (None) may be, the laws have a rule for it."""
    steering = (measurement.d_m, measurement.d_bearing_rad, measurement.d_front_m, measurement.d_dot_mps)
    where = (pose.x_m, pose.y_m, pose.yaw_rad, pose.vx_mps, pose.vy_mps)
    return all(value is None or abs(value) < ABSURD for value in (*steering, *where))
