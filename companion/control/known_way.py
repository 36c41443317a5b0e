"""R2 over known ground: a way flown straight by straight, each of which the scan confirms. Pure."""

from __future__ import annotations

import math

from companion.control import edges
from companion.control.decisions import Decisions
from companion.control.dogleg import dogleg
from companion.control.governor import room_m
from companion.control.informed import Way
from companion.control.known_ground import Place
from companion.control.parameters import Parameters
from companion.control.target import Target, world_point
from companion.model import Measurement, Pose, Scan

AHEAD_RAD = math.radians(60.0)
"""Within this bearing a way goes on as the same one, when what it led to has come into view."""

FACED_RAD, CONFIRMED_M, UNCONFIRMED_S = math.radians(10.0), 4.0, 0.5
"""A way over known ground is confirmed by the scan as soon as the vehicle faces it, as far as depth is precise. An
image with a hole in it does not end it."""

MOST_DOGLEGS = 3
"""So often one straight is gone round before its way counts as blocked."""


class KnownWay:
    """The way over known ground that is flown just now.

    Args:
        parameters: the law's settings.
        decisions: where it leads, and on.
    """

    def __init__(self, parameters: Parameters, decisions: Decisions) -> None:
        self._parameters = parameters
        self._decisions = decisions
        self._goal = Place(math.inf, math.inf, 0.0)
        self._confirmed_s = -math.inf
        self._rest: Way | None = None
        self._doglegs = 0

    def begin(self, way: Way, t_s: float) -> None:
        """Its next straight is flown from now on."""
        self._doglegs = self._doglegs if way is self._rest else 0
        self._rest = None
        self._goal = way.goal
        self._confirmed_s = t_s

    def onward(self, pose: Pose) -> Way | None:
        """A straight of the way on that is worth flying; None where there is none."""
        if self._rest is not None:
            return self._rest
        way = self._decisions.onward(pose)
        if (
            way is None
            or math.hypot(way.straight.x_m - pose.x_m, way.straight.y_m - pose.y_m) <= self._decisions.least_straight_m
        ):
            return None
        return way

    def has_led_into_view(self, pose: Pose, t_s: float) -> bool:
        """Whether what it leads to has come into view before its end."""
        return self._decisions.has_been_seen(self._goal, pose, t_s)

    def is_blocked(self, measurement: Measurement, scan: Scan, target: Target, pose: Pose, t_s: float) -> bool:
        """Whether for a while the camera has not confirmed what the known ground says; not while it turns there.

        Nor is a way one on which something is nearer than d_c: there R3 turns away.
        """
        bearing_rad = target.bearing_rad(pose)
        to_go_m = min(math.hypot(target.x_m - pose.x_m, target.y_m - pose.y_m), CONFIRMED_M)
        if self._has_room(measurement) and (
            abs(bearing_rad) > FACED_RAD or edges.corridor_is_free(scan, bearing_rad, to_go_m, self._half_width_m)
        ):
            self._confirmed_s = t_s
        return t_s - self._confirmed_s > UNCONFIRMED_S

    def go_round(
        self, measurement: Measurement, scan: Scan, target: Target, pose: Pose, t_s: float
    ) -> tuple[float, float] | None:
        """Bearing and range of a point by which it gets past what blocks a straight; None where there is none.

        What follows from there is the next straight of the way.
        """
        to_go_m = math.hypot(target.x_m - pose.x_m, target.y_m - pose.y_m)
        if self._doglegs >= MOST_DOGLEGS or not self._has_room(measurement):
            return None
        found = dogleg(scan, target.bearing_rad(pose), to_go_m, self._half_width_m)
        if found is None:
            return None
        point, end = found
        self._doglegs += 1
        self._confirmed_s = t_s
        self._rest = Way(to_go_m, Place(*world_point(pose, *end), self._goal.ground_m), self._goal)
        return point

    @property
    def _half_width_m(self) -> float:
        return self._parameters.critical_margin_m + room_m(self._parameters)

    def _has_room(self, measurement: Measurement) -> bool:
        return measurement.d_m is None or measurement.d_m >= self._parameters.critical_margin_m


def is_ahead(way: Way, pose: Pose) -> bool:
    """Whether it goes on without a turn that is a new decision."""
    return abs(way.straight.bearing_rad(pose)) <= AHEAD_RAD
