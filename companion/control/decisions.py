"""Whether the vehicle leaves the boundary: decided once for each tangent in view, and once for each lap.

With the paper's probability p, or with a preference for ground that has not been seen.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from companion.control.edges import Edge
from companion.control.known_ground import KnownGround, WallFollowing
from companion.control.parameters import Parameters
from companion.control.target import world_point
from companion.model import Pose, Scan, wrap_rad

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


class Choice:
    """The probabilities of rule R3 -> R2; the draws are the navigator's.

    Args:
        parameters: the law's settings.
        ground: what has been seen of the plan; stays empty when the choice is a coin.
    """

    def __init__(self, parameters: Parameters, ground: KnownGround) -> None:
        self._parameters = parameters
        self._ground = ground
        self._next_look_s = -math.inf

    def see(self, scan: Scan, pose: Pose, t_s: float) -> None:
        """Note what has been seen, twice a second: that is every quarter of a metre."""
        if self._parameters.choice == "frontier" and t_s >= self._next_look_s:
            self._next_look_s = t_s + LOOK_PERIOD_S
            self._ground.see(scan, pose)

    def after_lap(self) -> float:
        """A lap without a tangent taken has nothing new ahead: p, or with frontier the most that p_min leaves."""
        parameters = self._parameters
        return parameters.tangent_probability if parameters.choice == "coin" else 1.0 - parameters.least_probability

    def at_tangent(self, edge: Edge, gamma: int, pose: Pose) -> float:
        """Probability of leaving along this tangent: p, or with frontier a preference for what is unseen.

        Args:
            edge: the tangent.
            gamma: Γ of the boundary that would be followed on.
            pose: where the vehicle sees the tangent from.
        """
        p = self._parameters.tangent_probability
        if self._parameters.choice == "coin":
            return p
        target = world_point(pose, edge.target_bearing_rad, edge.target_range_m)
        by_tangent_m, by_boundary_m = self._ground.way_to_unseen_m(
            (pose.x_m, pose.y_m),
            (
                WallFollowing(*target, pose.yaw_rad + edge.target_bearing_rad, edge.gamma),
                WallFollowing(pose.x_m, pose.y_m, pose.yaw_rad, gamma),
            ),
        )
        if abs(by_tangent_m - by_boundary_m) < SAME_WAY_M or by_tangent_m == by_boundary_m:
            return p
        least = self._parameters.least_probability
        return 1.0 - least if by_tangent_m < by_boundary_m else least
