"""The state machine of the paper's algorithm A1 to A4: `Navigator.step` reads like Section 3."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from companion.control import boundary, climbing, edges, laws, wall_following
from companion.control.decisions import Choice, Decisions, LapCounter, TangentLedger
from companion.control.edges import Edge
from companion.control.governor import governed_speed_mps
from companion.control.graph import EdgeKind
from companion.control.graph_building import NavigationGraph
from companion.control.homing.homing import GONE_M, Homing, WayHome
from companion.control.informed import Way
from companion.control.known_ground import CELL_M, CELL_SHARE, UPRIGHT_57_DEG, KnownGround, Outlook
from companion.control.known_way import FACED_RAD, KnownWay, is_ahead
from companion.control.left_out import LeftOut
from companion.control.panorama import Panorama
from companion.control.parameters import Parameters
from companion.control.ramp import Ramp
from companion.control.standing import Standing
from companion.control.target import Progress, Target, TargetKind, world_point
from companion.control.trail import Trail
from companion.model import ABSURD, HIT, Input, Measurement, Mode, Pose, Scan, Setpoint, wrap_rad

FORGET_TANGENT_S = 5.0
"""A tangent out of view for this long is a new one when it comes back: ten metres of flight would be too far for the
same edge to stay ahead, half a second would be a flicker of the scan."""

OBSTACLE_AHEAD_RAD = math.radians(60.0)
"""In R2 the boundary is reached when an obstacle at d_s lies within this bearing: further round it is passed by."""

STUCK_TURNS = 2.0
"""Full turns in R3 without moving on by d_s, after which the vehicle is where S has no room (below 2·d_s)."""

REST_S = 60.0
"""After an extension a lap decides nothing for so long: a pillar is gone round in less."""

ELSEWHERE_M = 0.5
"""A vehicle on its way home that turns out to be so far from where it took itself to be looks for its way anew."""

LOST_WALL_S = 3.0
"""In R3 with nothing at all in view for this long there is no boundary to follow."""


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
        outlook: what the camera sees of floor and roof.
    """

    def __init__(self, parameters: Parameters, rng: np.random.Generator, outlook: Outlook = UPRIGHT_57_DEG) -> None:
        self.parameters = parameters
        self.height_m = parameters.height_m
        """H, which law (11) changes when several vehicles share the mine."""
        self._rng = rng
        self._mode = Mode.CIRCLE
        self._gamma = self._either_side()
        self._circle_direction = self._either_side()
        self._target: Target | None = None
        half_turn_s = math.pi / parameters.max_yaw_rate_radps
        self._progress = Progress(parameters.target_timeout_factor * half_turn_s)
        self._ledger = TangentLedger(parameters.margin_m, FORGET_TANGENT_S)
        self.known_ground = KnownGround(outlook, min(CELL_M, CELL_SHARE * parameters.critical_margin_m))
        """What has been seen of the plan, and where it was flown."""
        self.graph = NavigationGraph()
        """G, as far as it has been met: nothing steers by it."""
        self.choice = Choice(parameters, self.known_ground)
        """Which way the exploring takes."""
        self.homing = Homing(parameters, self.known_ground, self.choice)
        self._decisions: Decisions = self.choice
        self._way = KnownWay(parameters, self._decisions)
        self._laps = LapCounter()
        self._ramp = Ramp(parameters.max_accel_mps2, parameters.period_s)
        self._standing = Standing(parameters)
        self._trail = Trail()
        self._panorama = Panorama()
        self._is_stuck = False
        self._pause_until_s = -math.inf
        self._turned_rad = 0.0
        self._last_yaw_rad: float | None = None
        self._anchor = (math.inf, math.inf)
        self._boundary_seen_s = -math.inf
        self._holding = False
        self._draws = 0
        self._accepted = 0
        self._mode_changes = 0
        self._extensions = 0
        self._extended_s = -math.inf
        self._waits = False

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

    def is_way_left(self, pose: Pose) -> bool | None:
        """Whether known ground has a way from here to something unseen; None where that is not known."""
        return self.choice.is_way_left(pose)

    def left_out(self, pose: Pose) -> Iterator[LeftOut]:
        """What was seen of the ground and not looked into, for a vehicle that is here at the end."""
        return self.choice.left_out(pose)

    def way_home(self, measurement: Measurement, pose: Pose, anew: bool = False) -> WayHome | None:
        """How far home is over what is known, and how long that takes; None where no way is known.

        It is searched every ten seconds, or anew; in between it grows by what is flown.
        """
        return self.homing.way_home(measurement, pose, measurement.t_s, anew)

    def go_home(self, t_s: float) -> bool:
        """From now on fly to where the flight began; False where nobody knows where that is."""
        if self.homing.homeward is not None:
            return True
        homeward = self.homing.begin(t_s)
        if homeward is None:
            return False
        self.graph.close()
        self._decisions = homeward
        self._way = KnownWay(self.parameters, homeward)
        if self._mode is Mode.TANGENT:
            self._target, self._mode = None, Mode.BOUNDARY
        return True

    @property
    def is_home(self) -> bool:
        """Whether the vehicle was told to go home and stands there."""
        return self.homing.is_home

    def wait(self, measurement: Measurement, pose: Pose, t_s: float) -> Setpoint:
        """One sampling period in the place of `step`, while a person lets it wait: it stands, and decides nothing."""
        scan = measurement.scan
        self._holding = self._waits = True
        self._last_yaw_rad = None
        wanted = Setpoint(t_s, 0.0, climbing.climb_mps(self.height_m, measurement, pose, True, self.parameters), 0.0)
        if measurement.missing or scan is None or not _is_finite(measurement, pose):
            self._standing.release()
            return self._ramp.limit(wanted)
        return self._ramp.limit(self._standing.of(wanted, scan, measurement.sides, self.homing.pose(pose)))

    def step(self, measurement: Measurement, pose: Pose, t_s: float) -> Setpoint:
        """One sampling period: switch the mode if a rule says so, then execute the laws (6), (7) and (12).

        A setpoint is always finite, what is missing stops the vehicle, speed and climb grow by ``max_accel_mps2``. Over
        a place without ground it goes back along the way that it came.
        """
        scan = measurement.scan
        readable = scan is not None and _is_finite(measurement, pose)
        if self._waits:
            self._go_on_after_waiting(t_s)
        self._holding = bool(measurement.missing) or not readable
        if self.homing.homeward is not None:
            pose = self._realigned(measurement, pose, t_s)
        climb = climbing.climb_mps(self.height_m, measurement, pose, self._holding, self.parameters)
        lost_ground = measurement.over_shaft and measurement.missing == (Input.HEIGHT,) and readable
        if lost_ground:
            self._trail.begin(pose)
            self.homing.lose_ground(pose)
        back_mps = self._trail.back_mps(pose) if lost_ground or not self._holding else None
        if self._holding or scan is None or back_mps is not None:
            self._holding = True
            self._last_yaw_rad = None
            self._standing.release()
            forward_mps, left_mps = back_mps or (0.0, 0.0)
            return self._ramp.limit(Setpoint(t_s, forward_mps, climb, 0.0, left_mps))
        self._trail.note(pose)
        self._count_turning(pose)
        self._decisions.see(measurement, pose)
        self.homing.pace(pose, self._mode is Mode.TANGENT and abs(self._target_bearing_rad(pose)) < FACED_RAD)
        self.graph.fly(measurement, pose, t_s)
        if self.homing.homeward is None:
            self.homing.fly_out(measurement, pose)
        elif self.homing.has_arrived(pose, t_s):
            if self.homing.home is not None and self.homing.to_go_m(pose) < GONE_M:
                self._standing.keep_at(self.homing.home.x_m, self.homing.home.y_m, pose.z_m)
            return self._ramp.limit(self._standing.of(Setpoint(t_s, 0.0, climb, 0.0), scan, measurement.sides, pose))
        if self._mode is Mode.CIRCLE:
            self._leave_circle(scan, pose, t_s)
        elif self._mode is Mode.TANGENT:
            self._leave_tangent(measurement, scan, pose, t_s)
        elif self._mode is Mode.BOUNDARY:
            self._leave_boundary(measurement, scan, pose, t_s)
        yaw_rate_radps = self._yaw_rate_radps(measurement, scan, pose)
        speed = self._speed_mps(measurement, scan, pose, yaw_rate_radps)
        wanted = Setpoint(t_s, speed, climb, yaw_rate_radps)
        return self._ramp.limit(self._standing.of(wanted, scan, measurement.sides, pose))

    def _go_on_after_waiting(self, t_s: float) -> None:
        """What is counted in time begins anew: it was not for want of a way that it came no further."""
        self._waits = False
        self._boundary_seen_s = t_s
        self.homing.wait(t_s)
        if self._target is not None:
            self._progress.begin(self._target, t_s)

    def _realigned(self, measurement: Measurement, pose: Pose, t_s: float) -> Pose:
        """Where it is on its way home, by the position of its way out."""
        off_m = 0.0 if self._holding else self.homing.align(measurement, pose, t_s)
        if off_m > 0.0:
            # What they keep are places by the position that was wrong.
            self._standing.release()
        if off_m > ELSEWHERE_M:
            self._trail = Trail()
            if self._mode is Mode.TANGENT:
                self._enter(Mode.BOUNDARY, pose, t_s)
        return self.homing.pose(pose)

    # The laws.

    def _yaw_rate_radps(self, measurement: Measurement, scan: Scan, pose: Pose) -> float:
        """Paper eq. (7); its d is that of any side, the smooth law's that of the wall that is followed."""
        if self._mode is Mode.CIRCLE:
            return laws.circle_yaw_rate_radps(self._circle_direction, self.parameters)
        if self._mode is Mode.TANGENT:
            return laws.tangent_yaw_rate_radps(self._target_bearing_rad(pose), self.parameters)
        if self.parameters.law != "paper":
            return wall_following.yaw_rate_radps(self._gamma, measurement, scan, pose, self.parameters)
        if measurement.d_m is None or measurement.d_dot_mps is None:
            return 0.0
        return laws.boundary_yaw_rate_radps(self._gamma, measurement.d_m, measurement.d_dot_mps, self.parameters)

    def _speed_mps(self, measurement: Measurement, scan: Scan, pose: Pose, yaw_rate_radps: float) -> float:
        """Paper eq. (12), lowered by the governor."""
        speed = laws.speed_mps(self._mode, measurement.d_front_m, self.parameters)
        if self.homing.homeward is not None:
            speed = min(speed, self.homing.most_mps(pose))
        if self._mode is Mode.TANGENT and (self._escapes() or self.parameters.speed_law == "governor"):
            speed *= max(0.0, math.cos(self._target_bearing_rad(pose)))
        if self.parameters.speed_law == "paper" or speed == 0.0:
            return speed
        gamma = self._gamma if self._mode is Mode.BOUNDARY else None
        nearest_m = math.inf if measurement.d_m is None else measurement.d_m
        return governed_speed_mps(
            *(speed, scan, nearest_m, gamma, pose.towards_mps(0.0), self.parameters),
            towards_rad=self._turns_to_rad(pose, yaw_rate_radps),
            escapes=self._escapes(),
        )

    def _turns_to_rad(self, pose: Pose, yaw_rate_radps: float) -> float:
        """Bearing to which it turns: in R2 that of T_m, in R3 as far as it comes in the time of the reaction.

        Only where it turns away from the wall that it follows: what it comes to by that may be another one. Towards
        its own wall the law turns it no further than along it.
        """
        if self._mode is Mode.TANGENT:
            return self._target_bearing_rad(pose)
        if self._mode is Mode.BOUNDARY and yaw_rate_radps * self._gamma < 0.0:
            return yaw_rate_radps * self.parameters.governor.reaction_s
        return 0.0

    # The rules.

    def _leave_circle(self, scan: Scan, pose: Pose, t_s: float) -> None:
        """R1 -> R2 at the first tangent; after a full turn without one, our extensions."""
        self._panorama.see(scan, pose)
        if self.homing.homeward is not None and not self._is_stuck and self._takes_better_way(pose, t_s):
            return
        for edge in edges.find_edges(scan, self.parameters):
            if self._corridor_is_free(scan, edge):
                self._pursue(edge, pose, t_s)
                return
            self.graph.glimpse(*_tangent_point(edge, pose), edge.gamma, pose)
        if abs(self._turned_rad) < 2.0 * math.pi:
            return
        around = self._panorama.scan(scan, pose)
        if self._is_stuck:
            self._escape(around, pose, t_s)
        else:
            self._extend(around, pose, t_s)

    def _leave_tangent(self, measurement: Measurement, scan: Scan, pose: Pose, t_s: float) -> None:
        """R2 -> R3 at T_m, past T_m, or at a boundary that comes first; R2 -> R1 when T_m comes no nearer."""
        target = self._target
        assert target is not None  # noqa: S101 - R2 is entered only with a target
        if target.is_reached(pose, self.parameters.target_radius_m):
            self._arrive(target, scan, pose, t_s)
        elif target.kind is TargetKind.KNOWN and self._way.is_blocked(measurement, scan, target, pose, t_s):
            self._go_round(measurement, scan, target, pose, t_s)
        elif self._progress.has_ended(target, pose, t_s):
            self._enter(Mode.CIRCLE, pose, t_s)
        elif self._escapes() and abs(target.bearing_rad(pose)) >= math.pi / 2.0:
            # It stands and turns away from the very wall that it escapes from, which has come first already.
            return
        elif target.kind is TargetKind.KNOWN:
            # Its corridor is looked at all the way: walls beside it are no boundary that comes first.
            if self._way.has_led_into_view(pose, t_s):
                self._go_on(scan, pose, t_s)
        elif measurement.d_bearing_rad is not None and self._boundary_comes_first(measurement):
            if target.kind is not TargetKind.WALL:
                self._gamma = 1 if measurement.d_bearing_rad > 0.0 else -1
            self._enter(Mode.BOUNDARY, pose, t_s)

    def _go_round(self, measurement: Measurement, scan: Scan, target: Target, pose: Pose, t_s: float) -> None:
        """Where a straight cannot be flown, on the way home by a point beside it; else another way is sought."""
        point = None
        if self.homing.homeward is not None:
            point = self._way.go_round(measurement, scan, target, pose, t_s)
        if point is not None:
            self._fly_to(*point, TargetKind.KNOWN, pose, t_s)
            return
        self._decisions.block_way(target, pose, t_s)
        self._enter(Mode.BOUNDARY, pose, t_s)

    def _boundary_comes_first(self, measurement: Measurement) -> bool:
        """Whether an obstacle at d_s lies ahead, or one well inside of d_s beside: R2 alone would not leave it."""
        if measurement.d_m is None or measurement.d_bearing_rad is None:
            return False
        ahead_rad = abs(measurement.d_bearing_rad)
        if self._escapes():
            # Where it has no room it cannot keep d_s: there only what stands in its way ends it.
            return measurement.ahead_m < self.parameters.critical_margin_m
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
            self._look_round(pose, t_s)
            return
        if not edges.has_way_on(scan, self.parameters.critical_margin_m):
            self._look_round(pose, t_s)
            return
        rested = t_s - self._extended_s > REST_S
        if self._laps.has_come_round(pose) and rested and self._rng.random() < self._decisions.after_lap():
            self._escape(scan, pose, t_s)
            return
        if self._takes_better_way(pose, t_s):
            return
        for edge in edges.find_edges(scan, self.parameters):
            x_m, y_m = world_point(pose, edge.near_bearing_rad, edge.near_range_m)
            if self._ledger.seen_before(x_m, y_m, edge.gamma, t_s) or t_s < self._pause_until_s:
                continue
            if edge.gamma == self._gamma and edges.lies_along_boundary(scan, edge, self.parameters.margin_m):
                continue
            if not self._corridor_is_free(scan, edge):
                self.graph.glimpse(*_tangent_point(edge, pose), edge.gamma, pose)
                continue
            self._ledger.decide(x_m, y_m, edge.gamma, t_s)
            self._draws += 1
            if self._rng.random() < self._decisions.at_tangent(edge, self._gamma, pose):
                self._accepted += 1
                self._pursue(edge, pose, t_s)
            else:
                self._pause_until_s = t_s + self.parameters.pause_s
                self.graph.decline(EdgeKind.TANGENT, *_tangent_point(edge, pose), edge.gamma, pose)
            return

    def _takes_better_way(self, pose: Pose, t_s: float) -> bool:
        """R3 -> R2 over known ground, with all but p_min, where the unseen is nearer that way."""
        way = self._decisions.better_way(self._gamma, pose, t_s)
        if way is None:
            return False
        if not self._is_drawn(way, pose, t_s):
            return False
        self._go(way, pose, t_s)
        return True

    def _is_drawn(self, way: Way, pose: Pose, t_s: float) -> bool:
        """One draw for a way over known ground: taken with 1 - p_min, else none is looked for, for a while."""
        self._draws += 1
        if self._rng.random() < self._decisions.refusal:
            self._decisions.refuse(t_s)
            self.graph.decline(EdgeKind.KNOWN, way.straight.x_m, way.straight.y_m, self._gamma, pose)
            return False
        self._accepted += 1
        return True

    def _go(self, way: Way, pose: Pose, t_s: float) -> None:
        self._way.begin(way, t_s)
        self._pursue_point(way.straight.x_m, way.straight.y_m, TargetKind.KNOWN, pose, t_s)

    def _go_on(self, scan: Scan, pose: Pose, t_s: float) -> None:
        """What a way led to has come into view: on to what is unseen then, ahead as the same way, else by a draw."""
        way = self._way.onward(pose)
        if way is not None and not is_ahead(way, pose) and not self._is_drawn(way, pose, t_s):
            way = None
        self._go_or_follow(way, scan, pose, t_s)

    def _arrive(self, target: Target, scan: Scan, pose: Pose, t_s: float) -> None:
        """At T_m the boundary is followed; at the end of a straight over known ground the next one is flown."""
        if target.kind is TargetKind.KNOWN:
            self._go_or_follow(self._way.onward(pose), scan, pose, t_s)
        else:
            self._follow(scan, pose, t_s)

    def _go_or_follow(self, way: Way | None, scan: Scan, pose: Pose, t_s: float) -> None:
        if way is not None:
            self._go(way, pose, t_s)
            return
        self._gamma = self._decisions.side(pose) or self._gamma
        self._follow(scan, pose, t_s)

    def _follow(self, scan: Scan, pose: Pose, t_s: float) -> None:
        """The boundary on Γ's side, unless it is the other one at which the vehicle is."""
        if boundary.is_on_the_other_side(scan, self._gamma, self.parameters):
            self._gamma = -self._gamma
        self._enter(Mode.BOUNDARY, pose, t_s)

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
        self._count_extension(t_s)
        room_m = float(scan.ranges_m[nearest]) - self.parameters.margin_m
        if room_m <= self.parameters.target_radius_m:
            self._enter(Mode.BOUNDARY, pose, t_s)
        else:
            self._fly_to(float(scan.bearings_rad[nearest]), room_m, TargetKind.WALL, pose, t_s)

    def _look_round(self, pose: Pose, t_s: float) -> None:
        """Not in the paper: where R3 has no way on, turn once round and then leave, unless a tangent shows before."""
        self._enter(Mode.CIRCLE, pose, t_s)
        self._is_stuck = True

    def _escape(self, scan: Scan, pose: Pose, t_s: float) -> None:
        """Not in the paper: leave along the longest corridor that the body fits through."""
        bearing_rad, length_m = edges.open_direction(scan, self.parameters.critical_margin_m)
        length_m -= self.parameters.margin_m
        if length_m <= self.parameters.target_radius_m:
            self._enter(Mode.CIRCLE, pose, t_s)
            return
        self._count_extension(t_s)
        self._fly_to(bearing_rad, length_m, TargetKind.OPEN, pose, t_s)

    def _count_extension(self, t_s: float) -> None:
        """Whatever the law helps itself with begins with a side that is drawn."""
        self._extensions += 1
        self._extended_s = t_s
        self._gamma = self._either_side()

    def _fly_to(self, bearing_rad: float, distance_m: float, kind: TargetKind, pose: Pose, t_s: float) -> None:
        self._pursue_point(*world_point(pose, bearing_rad, distance_m), kind, pose, t_s)

    def _pursue_point(self, x_m: float, y_m: float, kind: TargetKind, pose: Pose, t_s: float) -> None:
        self._target = Target(x_m, y_m, pose.x_m, pose.y_m, kind)
        self._progress.begin(self._target, t_s)
        self._enter(Mode.TANGENT, pose, t_s)

    def _enter(self, mode: Mode, pose: Pose, t_s: float) -> None:
        self._mode = mode
        self._mode_changes += 1
        self._turned_rad = 0.0
        self._anchor = (pose.x_m, pose.y_m)
        self._boundary_seen_s = t_s
        self._laps.begin()
        if mode is not Mode.TANGENT:
            self._target = None
        self.graph.enter(mode, self._gamma, self._target, pose)
        if mode is Mode.CIRCLE:
            self._circle_direction = self._either_side()
            self._panorama.begin()
            self._is_stuck = False

    def _count_turning(self, pose: Pose) -> None:
        if self._last_yaw_rad is not None:
            self._turned_rad += wrap_rad(pose.yaw_rad - self._last_yaw_rad)
        self._last_yaw_rad = pose.yaw_rad

    def _escapes(self) -> bool:
        return self._target is not None and self._target.kind is TargetKind.OPEN

    def _target_bearing_rad(self, pose: Pose) -> float:
        assert self._target is not None  # noqa: S101 - R2 is entered only with a target
        return self._target.bearing_rad(pose)

    def _either_side(self) -> int:
        return 1 if self._rng.random() < 0.5 else -1


def _tangent_point(edge: Edge, pose: Pose) -> tuple[float, float]:
    return world_point(pose, edge.target_bearing_rad, edge.target_range_m)


def _is_finite(measurement: Measurement, pose: Pose) -> bool:
    """Whether everything that steers can be a number; what is not known (None) may be, the laws have a rule for it."""
    steering = (measurement.d_m, measurement.d_bearing_rad, measurement.d_front_m, measurement.d_dot_mps)
    return pose.is_finite_in_plane and all(value is None or abs(value) < ABSURD for value in steering)
