"""Whether the vehicle leaves the boundary: decided once for each tangent in view, and once for each lap.

With the paper's probability p, or with a preference for ground that has not been seen.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, replace

from companion.control import remaining
from companion.control.edges import Edge
from companion.control.informed import WallFollowing, Way, Ways, find_ways, find_ways_but
from companion.control.known_ground import KnownGround, Place
from companion.control.left_out import LeftOut
from companion.control.parameters import Parameters
from companion.control.target import Target, world_point
from companion.model import Measurement, Pose, wrap_rad

LAP_M = 8.0
"""A closed boundary is longer than this: shorter ones are turns on the spot, which have a rule of their own."""

LAP_SETTLED_M = 2.0
"""A lap begins this far into R3, when the vehicle flies along the wall that it came to."""

LAP_CLOSED_M, LAP_CLOSED_RAD = 1.0, math.radians(60.0)
"""The vehicle has come round when it is as near as this to where it began to follow, heading the same way."""

LOOK_PERIOD_S = 0.5
"""Time between two entries into the ground that is known to be seen."""

SAME_WAY_M = 2.0
"""Ways to unseen ground that differ by less than this, four cells, do not decide."""

PLAN_PERIOD_S, REFUSED_S = 1.0, 10.0
"""Time between two looks for a way over known ground, and after one that was not taken."""

REVIVED_S = 180.0
"""Time between two tries of what was given up: meanwhile the walls are followed, and other places seen."""

THERE_M = 1.0
"""Where the way to the unseen is no longer than this, the vehicle has come to it."""

BLOCKED_S, BLOCKED_M = 3.0, 1.5
"""Where the scan does not confirm a straight, no way leads through the cells so far along it any more."""

CLAIMED_M = 6.0
"""What is unseen so near to where another vehicle is going will be seen by that one."""

MINE_SHARE = 0.5
"""What another one claims is not left to it where the straight line there is shorter than this share of its way."""

GIVEN_UP_M = 1.5
"""What is still unseen so near to where it was looked for, cannot be seen from there."""


@dataclass(slots=True)
class _Decided:
    x_m: float
    y_m: float
    gamma: int
    seen_s: float


class TangentLedger:
    """Remembers the tangents that have been decided, for as long as they stay in view.

    Args:
        same_within_m: two edges nearer to each other than this, with the same Γ, are one.
        forget_after_s: a tangent not seen for this long may be drawn for again, as the paper wants it when the vehicle
            comes round a second time.
    """

    def __init__(self, same_within_m: float, forget_after_s: float) -> None:
        self._same_within_m = same_within_m
        self._forget_after_s = forget_after_s
        self._decided: list[_Decided] = []

    def seen_before(self, x_m: float, y_m: float, gamma: int, t_s: float) -> bool:
        """Whether this edge (world position) was decided and has stayed in view since; keeps it in view if so."""
        self._decided = [known for known in self._decided if t_s - known.seen_s <= self._forget_after_s]
        for known in self._decided:
            if known.gamma == gamma and math.hypot(known.x_m - x_m, known.y_m - y_m) <= self._same_within_m:
                known.x_m, known.y_m, known.seen_s = x_m, y_m, t_s
                return True
        return False

    def decide(self, x_m: float, y_m: float, gamma: int, t_s: float) -> None:
        """Note that a draw was taken for this edge."""
        self._decided.append(_Decided(x_m, y_m, gamma, t_s))


class LapCounter:
    """Tells when the boundary has been followed once round.

    Our extension: a boundary that meets no tangent would be followed for ever, always the same way round, and what the
    camera sees only in the other direction never comes into view. So a whole lap is a decision as well.
    """

    def __init__(self) -> None:
        self._start: Pose | None = None
        self._last: Pose | None = None
        self._flown_m = 0.0

    def begin(self) -> None:
        """Forget the lap under way: the next pose is the first of another."""
        self._start = None

    def has_come_round(self, pose: Pose) -> bool:
        """Whether a lap ends at this pose, which begins the next; called with every pose in R3."""
        if self._start is None or self._last is None:
            self._start, self._flown_m = pose, 0.0
        else:
            self._flown_m += math.hypot(pose.x_m - self._last.x_m, pose.y_m - self._last.y_m)
        self._last = pose
        if self._flown_m < LAP_SETTLED_M:
            # It comes to the wall at any angle, and will not pass here like that again.
            self._start = pose
            return False
        apart_m = math.hypot(pose.x_m - self._start.x_m, pose.y_m - self._start.y_m)
        turned_rad = abs(wrap_rad(pose.yaw_rad - self._start.yaw_rad))
        if self._flown_m < LAP_M or apart_m > LAP_CLOSED_M or turned_rad > LAP_CLOSED_RAD:
            return False
        self._start, self._flown_m = pose, LAP_SETTLED_M
        return True


class Decisions(ABC):
    """The probabilities of rule R3 -> R2, by how far it is to what is looked for; the draws are the navigator's.

    Args:
        parameters: the law's settings.
        ground: what has been seen of the plan.
    """

    refusal: float
    """Probability with which a way over known ground is not taken."""
    least_straight_m: float
    """At the end of a straight the next one is flown when it is longer than this."""

    def __init__(self, parameters: Parameters, ground: KnownGround) -> None:
        self._parameters = parameters
        self._ground = ground
        self._turn_m_per_rad = parameters.speed_mps / parameters.max_yaw_rate_radps
        self._h_m: float | None = None
        self._next_look_s = -math.inf
        self._next_plan_s = -math.inf

    def see(self, measurement: Measurement, pose: Pose) -> None:
        """Note what has been seen, twice a second: that is every quarter of a metre at 0.5 m/s."""
        self.stand_over(measurement.h_m)
        if measurement.t_s >= self._next_look_s:
            self._next_look_s = measurement.t_s + LOOK_PERIOD_S
            self._ground.see(measurement, pose)

    def stand_over(self, h_m: float | None) -> None:
        """Note how high the vehicle is above the ground; what it sees others note."""
        self._h_m = h_m

    def place(self, pose: Pose) -> Place:
        """The ground below the vehicle."""
        return Place.under(pose, self._h_m)

    @abstractmethod
    def better_way(self, gamma: int, pose: Pose, t_s: float) -> Way | None:
        """A way over known ground that is shorter than following on; None where there is none.

        Args:
            gamma: Γ of the boundary that is followed.
            pose: of now.
            t_s: now.
        """

    @abstractmethod
    def onward(self, pose: Pose) -> Way | None:
        """The rest of a way over known ground, from where one of its straights has ended; None where it has ended."""

    @abstractmethod
    def has_been_seen(self, goal: Place, pose: Pose, t_s: float) -> bool:
        """Whether what a way leads to has come into view before its end, and need not be flown to."""

    @abstractmethod
    def _ways(self, place: Place) -> Ways | None:
        """Ways over known ground to what is looked for; None where nothing is known of them."""

    def side(self, pose: Pose) -> int:
        """Γ of the boundary that leads there sooner; 0 when neither does."""
        here = self.place(pose)
        ways = self._ways(here)
        if ways is None:
            return 0
        right_m, left_m = (ways.along_m(WallFollowing(here, pose.yaw_rad, gamma)) for gamma in (-1, 1))
        return (right_m > left_m) - (right_m < left_m)

    def refuse(self, t_s: float) -> None:
        """A way was not taken: none for a while."""
        self._next_plan_s = t_s + REFUSED_S

    def block_way(self, target: Target, pose: Pose, t_s: float) -> None:
        """The straight to a target on the way cannot be flown: other ways are sought, after a while."""
        self._next_plan_s = t_s + BLOCKED_S
        to_go_m = math.hypot(target.x_m - pose.x_m, target.y_m - pose.y_m)
        at = min(1.0, BLOCKED_M / to_go_m) if to_go_m > 0.0 else 1.0
        x_m, y_m = pose.x_m + at * (target.x_m - pose.x_m), pose.y_m + at * (target.y_m - pose.y_m)
        self._ground.block(replace(self.place(pose), x_m=x_m, y_m=y_m))

    def after_lap(self) -> float:
        """A lap without a tangent taken has nothing new ahead: p, or with ways the most that p_min leaves."""
        parameters = self._parameters
        return parameters.tangent_probability if parameters.choice == "coin" else 1.0 - parameters.least_probability

    def at_tangent(self, edge: Edge, gamma: int, pose: Pose) -> float:
        """Probability of leaving along this tangent: p where nothing is known, else a preference for the shorter way.

        Args:
            edge: the tangent.
            gamma: Γ of the boundary that would be followed on.
            pose: where the vehicle sees the tangent from.
        """
        p = self._parameters.tangent_probability
        by_tangent_m, by_boundary_m = self._ways_m(edge, gamma, pose)
        if abs(by_tangent_m - by_boundary_m) < SAME_WAY_M or by_tangent_m == by_boundary_m:
            return p
        least = self._parameters.least_probability
        return 1.0 - least if by_tangent_m < by_boundary_m else least

    def _ways_m(self, edge: Edge, gamma: int, pose: Pose) -> tuple[float, float]:
        """How far it is along a tangent, and along the boundary."""
        here = self.place(pose)
        ways = self._ways(here)
        if ways is None:
            return math.inf, math.inf
        x_m, y_m = world_point(pose, edge.target_bearing_rad, edge.target_range_m)
        tangent = WallFollowing(replace(here, x_m=x_m, y_m=y_m), pose.yaw_rad + edge.target_bearing_rad, edge.gamma)
        boundary = WallFollowing(here, pose.yaw_rad, gamma)
        return edge.target_range_m + ways.along_m(tangent), ways.along_m(boundary)


class Choice(Decisions):
    """The decisions of the exploring: what is looked for is what has not been seen.

    With ``choice: coin`` the known ground decides nothing.
    """

    def __init__(self, parameters: Parameters, ground: KnownGround) -> None:
        super().__init__(parameters, ground)
        self.refusal, self.least_straight_m = parameters.least_probability, parameters.margin_m
        self._next_revival_s = -math.inf
        self.claimed: tuple[tuple[Place, float, bool], ...] = ()
        """Where other vehicles are going, how far they have to go, and whether their word counts more than the own."""
        self.newest: tuple[Way, float] | None = None
        """The way to the unseen that was last found, and when."""

    def nearest_unseen(self, pose: Pose) -> Way | None:
        """The way to the nearest place that is unseen, and not left to another one; None where none is known."""
        here = self.place(pose)
        ways = self._ways(here)
        way = None if ways is None else ways.way(here, pose.yaw_rad, self._turn_m_per_rad)
        self.newest = None if way is None else (way, pose.t_s)
        return way

    def better_way(self, gamma: int, pose: Pose, t_s: float) -> Way | None:
        """As `Decisions.better_way`; asked more often than `PLAN_PERIOD_S` none, and for a while after `refuse`."""
        if self._parameters.choice != "informed" or t_s < self._next_plan_s:
            return None
        self._next_plan_s = t_s + PLAN_PERIOD_S
        here = self.place(pose)
        ways = self._ways(here)
        way = None if ways is None else ways.way(here, pose.yaw_rad, self._turn_m_per_rad)
        self.newest = None if way is None else (way, t_s)
        if ways is None or way is None:
            # Nothing else is left: what was given up may be tried from elsewhere.
            if t_s >= self._next_revival_s:
                self._next_revival_s = t_s + REVIVED_S
                self._ground.take_up_again()
            self.refuse(t_s)
            return None
        onward_m = ways.along_m(WallFollowing(here, pose.yaw_rad, gamma))
        if onward_m <= way.length_m + SAME_WAY_M:
            return None
        return way

    def has_been_seen(self, goal: Place, pose: Pose, t_s: float) -> bool:
        """As `Decisions.has_been_seen`; looked at every `PLAN_PERIOD_S`."""
        if t_s < self._next_plan_s:
            return False
        self._next_plan_s = t_s + PLAN_PERIOD_S
        ways = self._ways(self.place(pose))
        return ways is not None and not ways.is_goal(goal)

    def onward(self, pose: Pose) -> Way | None:
        """As `Decisions.onward`; where it has ended, what is still unseen is given up."""
        way = self.nearest_unseen(pose)
        if way is None:
            return None
        if math.hypot(way.goal.x_m - pose.x_m, way.goal.y_m - pose.y_m) > THERE_M:
            return way
        self._ground.give_up(way.goal, GIVEN_UP_M)
        return None

    def is_way_left(self, pose: Pose) -> bool | None:
        """Whether the ground has a way to something unseen, see `remaining.is_way_left`."""
        if self._parameters.choice == "coin":
            return None
        return remaining.is_way_left(self._ground, self.place(pose))

    def left_out(self, pose: Pose) -> Iterator[LeftOut]:
        """What was seen and not looked into, see `remaining.left_out`."""
        return remaining.left_out(self._ground, self.place(pose))

    def _ways(self, place: Place) -> Ways | None:
        if self._parameters.choice == "coin":
            return None
        taken = [goal for goal, length_m, counts_more in self.claimed if _is_theirs(place, goal, length_m, counts_more)]
        ways = find_ways_but(self._ground, place, taken, CLAIMED_M) if taken else None
        # Where nothing else is left, help: whoever claims it may never come.
        return find_ways(self._ground, place) if ways is None else ways


def _is_theirs(place: Place, goal: Place, length_m: float, counts_more: bool) -> bool:
    """Whether another vehicle that has so far to go is to go there, and not one that is at this place."""
    straight_m = math.hypot(goal.x_m - place.x_m, goal.y_m - place.y_m)
    return length_m <= straight_m or (counts_more and MINE_SHARE * length_m <= straight_m)
