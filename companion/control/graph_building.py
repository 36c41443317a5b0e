"""The navigation graph while it is flown: what becomes a vertex, and where one is come back to. Pure.

Nothing steers by it here: it listens to the navigator, and draws no random number.
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass, field, replace

import numpy as np

from companion.control.exits import ExitTable, Sighting
from companion.control.graph import Edge, EdgeKind, End, Graph, Left, Vertex
from companion.control.known_ground import Place
from companion.control.recognition import LEVEL_M, Places, moved_m, tolerance_m
from companion.control.target import Target
from companion.model import ABSURD, Measurement, Mode, Pose, wrap_rad

STEP_M = 0.25
"""The way is measured, and places are looked for, in steps of this length: shorter ones would sum the noise of the
estimate to a way that nobody flew."""

AWAY_M = 4.0
"""After this much of an edge its own beginning may be its end as well: a closed boundary is longer (8 m)."""

MOST_POINTS = 64
"""Of the line of an edge; more are thinned out where it is straightest."""

MOST_VERTICES, MOST_EDGES, MOST_EXITS = 2048, 8192, 4096
"""A mine of kilometres, in 15 MB. Where there is no room for a vertex, the edge under way goes on to a known one."""

_Point = tuple[float, float, float]


@dataclass(slots=True)
class _Leg:
    """An edge that is being flown."""

    kind: EdgeKind
    gamma: int
    start: End
    from_m: float
    from_s: float
    points: list[_Point] = field(default_factory=list)


class NavigationGraph:
    """Definition 3.5, built from what the navigator does.

    A decision and a change of mode happen at a vertex: a known one, where it is near enough for the way flown since it
    was met (`recognition.tolerance_m`), on the same level and passed with one of its two headings; else a new one. A
    boundary that is followed past a known vertex ends an edge there, so that a loop closes.

    Args:
        most_vertices, most_edges, most_exits: what it keeps at most.
    """

    def __init__(
        self, most_vertices: int = MOST_VERTICES, most_edges: int = MOST_EDGES, most_exits: int = MOST_EXITS
    ) -> None:
        self._most_vertices = most_vertices
        self._most_edges = most_edges
        self._vertices: list[Vertex] = []
        self._met_at_m: list[float] = []
        self._places = Places()
        self._edges: list[Edge] = []
        self._numbers: dict[tuple[EdgeKind, End, End, int], int] = {}
        self._exits = ExitTable(most_exits)
        self._is_open = True
        self._leg: _Leg | None = None
        self._near: tuple[int, float] | None = None
        self._here = Pose(0.0, 0.0, 0.0, 0.0, 0.0)
        self._t_s = 0.0
        self._h_m: float | None = None
        self._slope = 0.0
        self._wall_bearing_rad: float | None = None
        self._way_m = 0.0
        self._left_out = 0

    # What the navigator tells.

    def close(self) -> None:
        """The exploring is over: what is flown from now on is known already, and not entered."""
        self._is_open = False

    def fly(self, measurement: Measurement, pose: Pose, t_s: float) -> None:
        """Every sampling period in which the navigator steers, before what it decides in it."""
        if not self._is_open:
            return
        self._t_s = t_s
        pose = self._known(pose)
        if measurement.h_m is not None and abs(measurement.h_m) < ABSURD:
            self._h_m = measurement.h_m
        slope = measurement.ground_slope
        self._slope = slope if slope is not None and abs(slope) < ABSURD else 0.0
        self._wall_bearing_rad = measurement.d_bearing_rad
        if self._leg is None:
            self._here = pose
            start = self._vertex_at(pose, 0)
            if start is not None:
                self._begin(EdgeKind.CIRCLE, 0, End(start, 0))
        elif self._from_here_m(pose) >= STEP_M:
            self._advance(self._leg, pose)
            self._exits.visit(self._place(pose))
            if self._leg.kind is EdgeKind.BOUNDARY:
                self._come_by(self._leg, pose)

    def enter(self, mode: Mode, gamma: int, target: Target | None, pose: Pose) -> None:
        """The navigator changes its mode here.

        Args:
            mode: the new one.
            gamma: Γ, of the boundary that it follows or flies to.
            target: of R2.
            pose: of now.
        """
        leg, pose = self._leg, self._known(pose)
        if leg is None or not self._is_open:
            return
        self._advance(leg, pose)
        kind = _kind(mode, target)
        follows = gamma if kind is EdgeKind.BOUNDARY else 0
        number = self._vertex_at(pose, follows or leg.gamma)
        if number is None:
            return
        self._end(leg, number, pose)
        start = End(number, self._along(number, follows, pose, target))
        if leg.kind in (EdgeKind.BOUNDARY, EdgeKind.CIRCLE) and kind in (EdgeKind.TANGENT, EdgeKind.KNOWN):
            assert target is not None  # noqa: S101 - both are kinds of R2
            self._note_exit(kind, Left.TAKEN, target.x_m, target.y_m, gamma, pose, start)
        self._begin(kind, follows, start)

    def decline(self, kind: EdgeKind, x_m: float, y_m: float, gamma: int, pose: Pose) -> None:
        """A draw at T_m was against it: the boundary is followed on, and this is a vertex of it.

        Args:
            kind: tangent or known.
            x_m: T_m.
            y_m: T_m.
            gamma: Γ of the boundary that it would have led to.
            pose: of now.
        """
        leg, pose = self._leg, self._known(pose)
        if leg is None or not self._is_open:
            return
        self._advance(leg, pose)
        number = self._vertex_at(pose, leg.gamma)
        leaves = None
        if number is not None:
            if number != leg.start.vertex or self._is_away(leg):
                self._end(leg, number, pose)
                self._begin(leg.kind, leg.gamma, End(number, self._along(number, leg.gamma, pose)))
            heading_rad = math.atan2(y_m - pose.y_m, x_m - pose.x_m)
            leaves = End(number, self._vertices[number].along(heading_rad))
        self._note_exit(kind, Left.DECLINED, x_m, y_m, gamma, pose, leaves)

    def glimpse(self, x_m: float, y_m: float, gamma: int, pose: Pose) -> None:
        """A tangent was seen, and no free corridor to its T_m."""
        if not self._is_open:
            return
        self._exits.glimpse(self._sighting(EdgeKind.TANGENT, x_m, y_m, gamma, self._known(pose)))

    def so_far(self) -> Graph:
        """The graph without the piece that is being flown. Costs microseconds."""
        left_out = self._left_out + self._exits.left_out
        return Graph(tuple(self._vertices), tuple(self._edges), tuple(self._exits.exits), left_out)

    def snapshot(self) -> Graph:
        """The graph as it is now, while the flight goes on."""
        return copy.deepcopy(self).finish()

    def finish(self) -> Graph:
        """The whole graph, when nothing more is flown: where the vehicle is counts as a vertex."""
        leg, self._leg = self._leg, None
        if leg is not None:
            self._advance(leg, self._here)
            number = self._vertex_at(self._here, leg.gamma)
            if number is not None:
                self._end(leg, number, self._here)
        return self.so_far()

    # What becomes of it.

    def _begin(self, kind: EdgeKind, gamma: int, start: End) -> None:
        here = self._here
        self._leg = _Leg(kind, gamma, start, self._way_m, self._t_s, [(here.x_m, here.y_m, here.z_m)])
        self._near = None

    def _end(self, leg: _Leg, number: int, pose: Pose) -> None:
        """The edge under way ends at a vertex."""
        end = End(number, self._along(number, leg.gamma, pose))
        there, back = (leg.kind, leg.start, end, leg.gamma), (leg.kind, end.reversed, leg.start.reversed, -leg.gamma)
        is_back = there not in self._numbers and back in self._numbers
        known = self._numbers.get(back if is_back else there)
        if known is None and len(self._edges) >= self._most_edges:
            self._left_out += 1
            return
        if known is None:
            known = self._numbers[there] = len(self._edges)
            line_m = np.array(leg.points, np.float32)
            self._edges.append(Edge(*there, line_m, 0, 0, 0.0, 0.0, leg.from_s, self._t_s))
        edge = self._edges[known]
        self._edges[known] = edge._replace(
            flown=edge.flown + (not is_back),
            flown_back=edge.flown_back + is_back,
            way_m=edge.way_m + self._way_m - leg.from_m,
            time_s=edge.time_s + self._t_s - leg.from_s,
            last_s=self._t_s,
        )

    def _come_by(self, leg: _Leg, pose: Pose) -> None:
        """A known vertex that the boundary leads past ends the edge, as soon as it comes no nearer any more."""
        but = None if self._is_away(leg) else leg.start.vertex
        near, self._near = self._near, self._find(pose, leg.gamma, but)
        if near is None or (self._near is not None and self._near[1] < near[1]):
            return
        number = near[0]
        self._meet(number, leg.gamma, pose)
        self._end(leg, number, pose)
        self._begin(leg.kind, leg.gamma, End(number, self._along(number, leg.gamma, pose)))

    def _vertex_at(self, pose: Pose, gamma: int) -> int | None:
        """The vertex here, a new one where none is known; None where there is no room for one."""
        leg = self._leg
        if leg is not None and gamma == 0 and not self._is_away(leg):
            # It turned on the spot, or circled.
            start = self._vertices[leg.start.vertex]
            if math.hypot(start.x_m - pose.x_m, start.y_m - pose.y_m) <= tolerance_m(0.0):
                return leg.start.vertex
        found = self._find(pose, gamma, None)
        if found is not None:
            self._meet(found[0], gamma, pose)
            return found[0]
        if len(self._vertices) >= self._most_vertices:
            self._left_out += 1
            return None
        self._places.add(len(self._vertices), pose.x_m, pose.y_m)
        self._met_at_m.append(self._way_m)
        heading_rad, ground_m = self._heading_rad(gamma, pose), self._place(pose).ground_m
        where = pose.x_m, pose.y_m, pose.z_m, ground_m
        self._vertices.append(Vertex(*where, heading_rad, gamma, 1, 0, self._t_s, self._t_s))
        return len(self._vertices) - 1

    def _find(self, pose: Pose, gamma: int, but: int | None) -> tuple[int, float] | None:
        """The nearest vertex that this place may be, and how far it is off."""
        ground_m, heading_rad = self._place(pose).ground_m, self._heading_rad(gamma, pose)
        best: tuple[int, float] | None = None
        for number in self._places.near(pose.x_m, pose.y_m):
            vertex = self._vertices[number]
            off_m = math.hypot(vertex.x_m - pose.x_m, vertex.y_m - pose.y_m)
            if (
                number != but
                and (best is None or off_m < best[1])
                and off_m <= tolerance_m(self._way_m - self._met_at_m[number])
                and abs(vertex.ground_m - ground_m) <= LEVEL_M
                and vertex.is_passed(heading_rad, gamma)
            ):
                best = number, off_m
        return best

    def _meet(self, number: int, gamma: int, pose: Pose) -> None:
        """A vertex was come back to; what only drift explains moves it."""
        vertex = self._vertices[number]
        off_m = math.hypot(pose.x_m - vertex.x_m, pose.y_m - vertex.y_m)
        share = moved_m(off_m) / off_m if off_m > 0.0 else 0.0
        x_m, y_m = vertex.x_m + share * (pose.x_m - vertex.x_m), vertex.y_m + share * (pose.y_m - vertex.y_m)
        self._places.move(number, (vertex.x_m, vertex.y_m), (x_m, y_m))
        self._met_at_m[number] = self._way_m
        back = vertex.gamma * gamma < 0
        self._vertices[number] = vertex._replace(
            x_m=x_m, y_m=y_m, met=vertex.met + (not back), met_back=vertex.met_back + back, last_s=self._t_s
        )

    def _note_exit(
        self, kind: EdgeKind, left: Left, x_m: float, y_m: float, gamma: int, pose: Pose, vertex: End | None
    ) -> None:
        leads_to = gamma if kind is EdgeKind.TANGENT else 0
        self._exits.note(self._sighting(kind, x_m, y_m, leads_to, pose), left, vertex)

    def _sighting(self, kind: EdgeKind, x_m: float, y_m: float, gamma: int, pose: Pose) -> Sighting:
        return Sighting(kind, self._place(pose, x_m, y_m), gamma, pose, self._t_s, self._way_m)

    def _advance(self, leg: _Leg, pose: Pose) -> None:
        """Measure the way, and draw the line of the edge."""
        self._way_m += self._from_here_m(pose)
        self._here = pose
        leg.points.append((pose.x_m, pose.y_m, pose.z_m))
        if len(leg.points) > MOST_POINTS:
            points = leg.points
            del points[min(range(1, len(points) - 1), key=lambda k: _bend_m2(points[k - 1], points[k], points[k + 1]))]

    def _known(self, pose: Pose) -> Pose:
        """The pose with the last height that can be one: the law steers without it, and nothing here may end that."""
        return pose if abs(pose.z_m) < ABSURD else replace(pose, z_m=self._here.z_m)

    def _from_here_m(self, pose: Pose) -> float:
        here = self._here
        return math.dist((here.x_m, here.y_m, here.z_m), (pose.x_m, pose.y_m, pose.z_m))

    def _is_away(self, leg: _Leg) -> bool:
        return self._way_m - leg.from_m > AWAY_M

    def _heading_rad(self, gamma: int, pose: Pose) -> float:
        """That of ∂S(d_s) here, across the bearing of its wall; the vehicle may come to it at any angle."""
        bearing_rad = self._wall_bearing_rad
        if bearing_rad is None or bearing_rad * gamma <= 0.0:
            return pose.yaw_rad
        return wrap_rad(pose.yaw_rad + bearing_rad - gamma * math.pi / 2.0)

    def _along(self, number: int, gamma: int, pose: Pose, target: Target | None = None) -> int:
        """How a vertex is passed: with the wall of a boundary, else by where the vehicle heads or is to fly."""
        vertex = self._vertices[number]
        if gamma != 0:
            return vertex.gamma * gamma
        bearing_rad = 0.0 if target is None else target.bearing_rad(pose)
        return vertex.along(pose.yaw_rad + bearing_rad)

    def _place(self, pose: Pose, x_m: float | None = None, y_m: float | None = None) -> Place:
        """The ground below the vehicle, or as its slope goes on to another place."""
        below = Place.under(pose, self._h_m)
        if x_m is None or y_m is None:
            return below
        ahead_m = (x_m - pose.x_m) * math.cos(pose.yaw_rad) + (y_m - pose.y_m) * math.sin(pose.yaw_rad)
        return Place(x_m, y_m, below.ground_m + self._slope * ahead_m)


def _kind(mode: Mode, target: Target | None) -> EdgeKind:
    if mode is Mode.BOUNDARY:
        return EdgeKind.BOUNDARY
    return EdgeKind.CIRCLE if target is None else EdgeKind(target.kind.value)


def _bend_m2(a: _Point, b: _Point, c: _Point) -> float:
    """Twice the area of the triangle in plan: how much is lost when the middle one goes."""
    return abs((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))
