"""How likely the vehicle leaves the boundary: the paper's p, or a preference for ground that has not been seen."""

from __future__ import annotations

import math

from companion.control.edges import Edge
from companion.control.known_ground import KnownGround, WallFollowing
from companion.control.parameters import Parameters
from companion.control.target import world_point
from companion.model import Pose, Scan

LOOK_PERIOD_S = 0.5
"""Time between two entries into the ground that is known to be seen."""

SAME_WAY_M = 2.0
"""Ways to unseen ground that differ by less than this, four cells, do not decide."""


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
