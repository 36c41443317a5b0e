"""The navigation graph G of the paper's Definition 3.5, as far as a flight has met it. Pure.

Its vertices are where tangent segments end, its edges the segments, the arcs of initial circles and what was followed
of ∂S(d_s). What the flight adds to the definition: how often and how long each edge was flown, the exits that were seen
and not taken, and edges of our extensions, which are named as such.
"""

from __future__ import annotations

import enum
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

SAME_HEADING_RAD = math.radians(45.0)
"""Headings that differ by less go the same way past a vertex: at a corner the boundary turns, and a vertex that is met
a metre sooner or later lies on another part of that arc."""


class EdgeKind(enum.StrEnum):
    """What an edge is. The first three are those of Definition 3.5."""

    CIRCLE = "circle"
    """R1: an arc of an initial circle, or a turn on the spot."""
    TANGENT = "tangent"
    """R2 along a tangent segment."""
    BOUNDARY = "boundary"
    """R3: a piece of ∂S(d_s)."""
    KNOWN = "known"
    """R2 over known ground."""
    WALL = "wall"
    """R2 to the nearest wall, after a turn without a tangent."""
    OPEN = "open"
    """R2 along the longest corridor, out of a place without room or off a boundary flown once round."""


class Left(enum.StrEnum):
    """What became of an exit."""

    TAKEN = "taken"
    DECLINED = "declined"
    """The draw was against it, each time."""
    OUT_OF_REACH = "out of reach"
    """A tangent was seen, but no free corridor to its T_m: no draw."""


class Vertex(NamedTuple):
    """A place where edges meet.

    At a tangent point one passes with either of two headings: ``heading_rad`` with the wall on Γ's side, or the
    opposite one with the wall on the other side. They are one vertex, and an `End` says which is meant.

    Attributes:
        x_m, y_m, z_m: where the vehicle was, in the world frame.
        ground_m: height of the ground below.
        heading_rad: that of ∂S(d_s), the way it was followed first.
        gamma: Γ with that heading: -1 the wall is on the right, 1 on the left; 0 where no wall was followed: such a
            place is passed with any heading.
        met, met_back: how often it was come to, with that heading and with the opposite one.
        first_s, last_s: when it was met for the first time and for the last.
    """

    x_m: float
    y_m: float
    z_m: float
    ground_m: float
    heading_rad: float
    gamma: int
    met: int
    met_back: int
    first_s: float
    last_s: float

    def along(self, heading_rad: float) -> int:
        """Whether that is its heading (1), the opposite one (-1), or neither (0)."""
        if self.gamma == 0:
            return 0
        off_rad = abs(math.remainder(heading_rad - self.heading_rad, 2.0 * math.pi))
        return (off_rad < SAME_HEADING_RAD) - (math.pi - off_rad < SAME_HEADING_RAD)

    def is_passed(self, heading_rad: float, gamma: int) -> bool:
        """Whether whoever heads there with a boundary on Γ's side, or with none (0), may be at this vertex."""
        return self.gamma == 0 if gamma == 0 else self.gamma * self.along(heading_rad) == gamma


class End(NamedTuple):
    """A vertex, and how an edge passes it: 1 with its heading, -1 with the opposite one, 0 with some other.

    The last is where the vehicle turns on the spot, as (12) lets it, and where no wall is.
    """

    vertex: int
    along: int

    @property
    def reversed(self) -> End:
        """The same end of the edge that is flown the other way."""
        return End(self.vertex, -self.along)


class Edge(NamedTuple):
    """What was flown between two vertices without another one between.

    Attributes:
        kind: which mode flew it, and why.
        start, end: of the first flight.
        gamma: Γ of a boundary, in the direction of that flight; 0 of all else.
        line_m: (n, 3) float32 places on the first flight, both ends included.
        flown, flown_back: how often it was flown, that way and the other.
        way_m, time_s: flown on it in all.
        first_s, last_s: when the first flight of it began, and the last one ended.
    """

    kind: EdgeKind
    start: End
    end: End
    gamma: int
    line_m: NDArray[np.float32]
    flown: int
    flown_back: int
    way_m: float
    time_s: float
    first_s: float
    last_s: float

    @property
    def length_m(self) -> float:
        """Of the edge: the mean of all flights of it."""
        return self.way_m / (self.flown + self.flown_back)


class Exit(NamedTuple):
    """A way off: the tangent, or the straight over known ground, that was seen from some place.

    Attributes:
        kind: tangent or known.
        left: what became of it.
        vertex: where it leaves, if a draw was taken there: an exit out of reach makes no vertex.
        from_x_m, from_y_m, from_z_m: where it was seen from.
        x_m, y_m: T_m.
        ground_m: height of the ground at T_m, as far as the slope below the vehicle tells.
        gamma: Γ of the boundary that it leads to; 0 over known ground.
        decided: how often it was taken or declined.
        visited: whether the vehicle came to T_m, by this or any other way.
        first_s, last_s: when it was seen for the first time and for the last.
    """

    kind: EdgeKind
    left: Left
    vertex: End | None
    from_x_m: float
    from_y_m: float
    from_z_m: float
    x_m: float
    y_m: float
    ground_m: float
    gamma: int
    decided: int
    visited: bool
    first_s: float
    last_s: float

    @property
    def direction_rad(self) -> float:
        """Where it leads."""
        return math.atan2(self.y_m - self.from_y_m, self.x_m - self.from_x_m)


class Counts(NamedTuple):
    """How large a graph is.

    Attributes:
        vertices, edges, exits: of each.
        exits_untaken: exits that were never taken.
        exits_unvisited: those of them to which no other way has led either.
        left_out: pieces of the way for which there was no room any more.
    """

    vertices: int
    edges: int
    exits: int
    exits_untaken: int
    exits_unvisited: int
    left_out: int


class Graph(NamedTuple):
    """G as it is at one moment; `End.vertex` counts from 0 in ``vertices``."""

    vertices: tuple[Vertex, ...] = ()
    edges: tuple[Edge, ...] = ()
    exits: tuple[Exit, ...] = ()
    left_out: int = 0

    def counts(self) -> Counts:
        """How large it is."""
        untaken = [exit_ for exit_ in self.exits if exit_.left is not Left.TAKEN]
        unvisited = sum(not exit_.visited for exit_ in untaken)
        return Counts(
            len(self.vertices), len(self.edges), len(self.exits), len(untaken), unvisited, left_out=self.left_out
        )
