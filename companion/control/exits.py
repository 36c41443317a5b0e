"""The exits of the navigation graph: which two sightings are one exit, and what became of it. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from companion.control.graph import SAME_HEADING_RAD, EdgeKind, End, Exit, Left
from companion.control.known_ground import Place
from companion.control.recognition import LEVEL_M, SAME_M, Places, tolerance_m
from companion.model import Pose

GLIMPSED_S, FORGOTTEN_S = 1.0, 0.5
"""A tangent out of reach counts when it is seen for so long, with no gap longer than the second, a flicker of the scan:
noise shows edges for a sample or two."""

MOST_FLOWN = 50_000
"""Square metres of the plan through which the way has led, of which so many are remembered."""

MOST_GLIMPSES = 16
"""Tangents out of reach that are looked at just now; a scan seldom shows three."""


class Sighting(NamedTuple):
    """An exit as it is seen at one moment.

    Attributes:
        kind: tangent or known.
        to: T_m and the ground there.
        gamma: Γ of the boundary that it leads to.
        pose: where it leaves.
        t_s: when.
        way_m: flown until then.
    """

    kind: EdgeKind
    to: Place
    gamma: int
    pose: Pose
    t_s: float
    way_m: float

    @property
    def direction_rad(self) -> float:
        """Where it leads."""
        return math.atan2(self.to.y_m - self.pose.y_m, self.to.x_m - self.pose.x_m)


@dataclass(slots=True)
class _Glimpse:
    x_m: float
    y_m: float
    gamma: int
    first_s: float
    last_s: float


class ExitTable:
    """All exits that were met.

    Args:
        most: so many are kept; what comes after them is left out and counted.
    """

    def __init__(self, most: int) -> None:
        self.exits: list[Exit] = []
        self.left_out = 0
        self._most = most
        self._places = Places()
        self._seen_at_m: list[float] = []
        self._glimpses: list[_Glimpse] = []
        self._flown: set[tuple[int, int, int]] = set()

    def note(self, seen: Sighting, left: Left, vertex: End | None) -> None:
        """An exit was taken or declined, or has been out of reach for a while.

        Args:
            seen: where it is.
            left: what became of it this time. Once taken, it stays taken; once there was a draw, it is within reach.
            vertex: where it leaves.
        """
        decided = int(left is not Left.OUT_OF_REACH)
        number = self._find(seen)
        if number is not None:
            old = self.exits[number]
            self.exits[number] = old._replace(
                left=min(old.left, left, key=list(Left).index),
                vertex=old.vertex or vertex,
                decided=old.decided + decided,
                last_s=seen.t_s,
            )
            self._seen_at_m[number] = seen.way_m
        elif len(self.exits) >= self._most:
            self.left_out += 1
        else:
            pose, to, t_s = seen.pose, seen.to, seen.t_s
            self._places.add(len(self.exits), to.x_m, to.y_m)
            self._seen_at_m.append(seen.way_m)
            where = pose.x_m, pose.y_m, pose.z_m, to.x_m, to.y_m, to.ground_m
            visited = self._was_at(to)
            self.exits.append(Exit(seen.kind, left, vertex, *where, seen.gamma, decided, visited, t_s, t_s))

    def glimpse(self, seen: Sighting) -> None:
        """A tangent without a free corridor was seen in this sample."""
        if self._find(seen) is not None:
            self.note(seen, Left.OUT_OF_REACH, None)
            return
        to, t_s = seen.to, seen.t_s
        self._glimpses = [known for known in self._glimpses if t_s - known.last_s <= FORGOTTEN_S][-MOST_GLIMPSES:]
        for known in self._glimpses:
            if known.gamma == seen.gamma and math.hypot(known.x_m - to.x_m, known.y_m - to.y_m) <= SAME_M:
                known.x_m, known.y_m, known.last_s = to.x_m, to.y_m, t_s
                if t_s - known.first_s >= GLIMPSED_S:
                    self._glimpses.remove(known)
                    self.note(seen, Left.OUT_OF_REACH, None)
                return
        self._glimpses.append(_Glimpse(to.x_m, to.y_m, seen.gamma, t_s, t_s))

    def visit(self, here: Place) -> None:
        """The vehicle is here: exits that lead here need not be taken any more to see what is there."""
        if len(self._flown) < MOST_FLOWN:
            self._flown.add(_cell(here))
        for number in self._places.near(here.x_m, here.y_m):
            exit_ = self.exits[number]
            near = math.hypot(exit_.x_m - here.x_m, exit_.y_m - here.y_m) <= SAME_M
            if near and not exit_.visited and abs(exit_.ground_m - here.ground_m) <= LEVEL_M:
                self.exits[number] = exit_._replace(visited=True)

    def _was_at(self, place: Place) -> bool:
        """Whether the vehicle was about there, on that level."""
        x, y, level = _cell(place)
        around = (-1, 0, 1)
        return any((x + i, y + j, level + k) in self._flown for i in around for j in around for k in around)

    def _find(self, seen: Sighting) -> int | None:
        """The nearest exit of that kind to about the same place on the same level, in about the same direction."""
        to = seen.to
        nearest_m, found = math.inf, None
        for number in self._places.near(to.x_m, to.y_m):
            exit_ = self.exits[number]
            off_m = math.hypot(exit_.x_m - to.x_m, exit_.y_m - to.y_m)
            if (
                off_m < nearest_m
                and off_m <= tolerance_m(seen.way_m - self._seen_at_m[number])
                and (exit_.kind, exit_.gamma) == (seen.kind, seen.gamma)
                and abs(exit_.ground_m - to.ground_m) <= LEVEL_M
                and abs(math.remainder(exit_.direction_rad - seen.direction_rad, 2.0 * math.pi)) < SAME_HEADING_RAD
            ):
                nearest_m, found = off_m, number
        return found


def _cell(place: Place) -> tuple[int, int, int]:
    return math.floor(place.x_m), math.floor(place.y_m), math.floor(place.ground_m / LEVEL_M)
