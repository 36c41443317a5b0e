"""The navigation graph: places that are one, places that stay apart, what becomes of exits, and its bounds."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.control.exits import GLIMPSED_S
from companion.control.graph import EdgeKind, Graph, Left
from companion.control.graph_building import MOST_POINTS, STEP_M, NavigationGraph
from companion.control.recognition import LEVEL_M, MOST_M, SAME_M, moved_m, tolerance_m
from companion.control.target import Target, TargetKind
from companion.mapping.files.graph_file import read_graph, write_graph
from companion.model import Mode, Pose
from tests.control.scene import Scene, box, fly, measurement
from tests.control.stages import NEVER, ORIGIN, navigator_with

TICK_S, SPEED_MPS, H_M = 0.1, 1.0, 1.5
QUARTER = math.pi / 2.0
SQUARE = ((10.0, 0.0), (10.0, 10.0), (0.0, 10.0), (0.0, 0.0))


class Walk:
    """A vehicle that is led by hand, and its graph."""

    def __init__(self, graph: NavigationGraph | None = None) -> None:
        self.graph = graph or NavigationGraph()
        self.pose = Pose(0.0, 0.0, 0.0, H_M, 0.0)
        self.gamma = 0
        self.drift_m = np.zeros(2)
        self.way_m = 0.0
        self.tick()

    def tick(self) -> None:
        """One sampling period on the spot; the wall is abeam."""
        seen = replace(
            measurement(None, h_m=H_M, d_bearing_rad=self.gamma * QUARTER if self.gamma else None),
            ground_slope=0.0,
        )
        self.graph.fly(seen, self.told, self.pose.t_s)
        self.pose = replace(self.pose, t_s=self.pose.t_s + TICK_S)

    @property
    def told(self) -> Pose:
        """The pose as the drifting estimate has it."""
        return replace(self.pose, x_m=self.pose.x_m + self.drift_m[0], y_m=self.pose.y_m + self.drift_m[1])

    def to(self, x_m: float, y_m: float, z_m: float | None = None) -> None:
        """Straight there."""
        z_m = self.pose.z_m if z_m is None else z_m
        start, far_m = self.pose, math.dist((self.pose.x_m, self.pose.y_m), (x_m, y_m))
        yaw_rad = math.atan2(y_m - start.y_m, x_m - start.x_m)
        steps = max(1, round(far_m / (SPEED_MPS * TICK_S)))
        for k in range(1, steps + 1):
            share = k / steps
            self.pose = replace(
                self.pose,
                x_m=start.x_m + share * (x_m - start.x_m),
                y_m=start.y_m + share * (y_m - start.y_m),
                z_m=start.z_m + share * (z_m - start.z_m),
                yaw_rad=yaw_rad,
            )
            self.tick()
        self.way_m += math.dist((start.x_m, start.y_m, start.z_m), (x_m, y_m, z_m))

    def along(self, *corners: tuple[float, float]) -> None:
        """From corner to corner."""
        for corner in corners:
            self.to(*corner)

    def follow(self, gamma: int, yaw_rad: float | None = None) -> None:
        """R3 from here, with the wall on that side."""
        self.gamma = gamma
        if yaw_rad is not None:
            self.pose = replace(self.pose, yaw_rad=yaw_rad)
        self.tick()
        self.graph.enter(Mode.BOUNDARY, gamma, None, self.told)

    def leave_for(self, x_m: float, y_m: float, gamma: int, kind: TargetKind = TargetKind.TANGENT) -> None:
        """R2 from here, as far as its target."""
        told = self.told
        self.graph.enter(Mode.TANGENT, gamma, Target(x_m, y_m, told.x_m, told.y_m, kind), told)
        self.gamma = 0
        self.to(x_m, y_m)

    def decline(self, x_m: float, y_m: float, gamma: int = 1) -> None:
        """A draw against T_m."""
        self.graph.decline(EdgeKind.TANGENT, x_m, y_m, gamma, self.told)

    @property
    def result(self) -> Graph:
        """The graph so far."""
        return self.graph.snapshot()


def boundaries(graph: Graph) -> list[tuple[int, int, int, int]]:
    """Start, end, flown and flown back of every boundary."""
    return [(e.start.vertex, e.end.vertex, e.flown, e.flown_back) for e in graph.edges if e.kind is EdgeKind.BOUNDARY]


def is_connected(graph: Graph) -> bool:
    """Whether every vertex can be come to from the first one over edges."""
    reached, waiting = {0}, [0]
    while waiting:
        here = waiting.pop()
        for edge in graph.edges:
            ends = {edge.start.vertex, edge.end.vertex}
            if here in ends:
                waiting += ends - reached
                reached |= ends
    return len(reached) == len(graph.vertices)


# Places that are one.


def test_a_square_loop_closes() -> None:
    """Coming round a boundary on which nothing is decided is seen: one edge, from its vertex to itself."""
    walk = Walk()
    walk.follow(-1)
    walk.along((2.0, 0.0), *SQUARE, (2.0, 0.0))
    graph = walk.result
    # The place where the flight began, where the boundary begins, and where the vehicle is.
    assert len(graph.vertices) == 3
    assert boundaries(graph) == [(1, 1, 1, 0), (1, 2, 1, 0)]
    assert graph.edges[1].length_m == pytest.approx(40.0, abs=0.6)
    assert graph.edges[1].time_s == pytest.approx(40.0, abs=2.0)


def test_what_is_decided_on_the_way_is_met_again() -> None:
    """The second lap adds nothing: the same vertices and edges, each flown twice."""
    walk = Walk()
    walk.follow(-1)
    for _ in range(2):
        walk.along((6.0, 0.0))
        walk.decline(9.0, -4.0)
        walk.along((10.0, 0.0), (10.0, 6.0))
        walk.decline(14.0, 9.0)
        walk.along((10.0, 10.0), (0.0, 10.0), (0.0, 0.0))
    walk.along((1.8, 0.0))
    graph = walk.result
    assert len(graph.exits) == 2
    assert [exit_.decided for exit_ in graph.exits] == [2, 2]
    assert boundaries(graph)[:3] == [(1, 2, 2, 0), (2, 3, 2, 0), (3, 1, 2, 0)]


@pytest.mark.parametrize(("way_m", "drift_m", "same"), [(100.0, 2.3, True), (100.0, 2.8, False), (20.0, 2.0, False)])
def test_a_return_with_drift_is_recognised_as_far_as_the_way_explains_it(
    way_m: float, drift_m: float, same: bool
) -> None:
    """1.5 m, and 1 % of the way flown since: 2.5 m after 100 m."""
    side_m = way_m / 4.0
    walk = Walk()
    walk.follow(-1)
    walk.along((side_m, 0.0), (side_m, side_m), (0.0, side_m), (0.0, 0.5))
    walk.drift_m = np.array([0.0, drift_m])
    walk.along((0.0, 0.0), (3.0, 0.0))
    assert ((1, 1, 1, 0) in boundaries(walk.result)) == same


def test_drift_carries_a_vertex_along_and_nothing_else_does() -> None:
    """A place is sought where it was met last: after ten laps that drift 0.8 m each, 8 m from where it was first."""
    walk = Walk()
    walk.follow(-1)
    for _ in range(10):
        walk.along(*((4.0 * x, 4.0 * y) for x, y in SQUARE))
        walk.drift_m = walk.drift_m + np.array([0.0, 0.8])
    walk.along((2.0, 0.0))
    graph = walk.result
    assert boundaries(graph)[0][2] == 10
    assert graph.vertices[1].y_m == pytest.approx(8.0 - SAME_M, abs=0.8)
    assert moved_m(SAME_M) == 0.0


@given(way_m=st.floats(0.0, 1e6), more_m=st.floats(0.0, 1e6))
def test_the_tolerance_grows_with_the_way_and_ends(way_m: float, more_m: float) -> None:
    """Never less than what a place is without drift, never so much that another drift would be the same place."""
    assert SAME_M <= tolerance_m(way_m) <= tolerance_m(way_m + more_m) <= MOST_M


def test_both_headings_are_one_vertex() -> None:
    """The same wall followed back, on the other hand: the vertices are known, and the edge is flown back."""
    walk = Walk()
    walk.follow(-1)
    walk.along((8.0, 0.0))
    walk.decline(12.0, -3.0)
    walk.along((14.0, 0.0))
    walk.follow(1, math.pi)
    walk.along((-2.0, 0.0))
    graph = walk.result
    there = next(edge for edge in graph.edges if edge.kind is EdgeKind.BOUNDARY)
    assert (there.start.vertex, there.end.vertex, there.flown, there.flown_back) == (1, 2, 1, 1)
    assert (graph.vertices[2].met, graph.vertices[2].met_back) == (1, 1)
    assert there.end.along == 1
    assert [graph.vertices[2].along(heading) for heading in (0.3, math.pi - 0.3, 1.5)] == [1, -1, 0]


def test_the_other_wall_at_the_same_place_is_another_vertex() -> None:
    """In a narrow drift both boundaries run in one line: heading the same way, the wall is on the other side."""
    walk = Walk()
    walk.follow(-1)
    walk.along((8.0, 0.0), (8.0, 5.0), (0.0, 5.0), (-4.0, 0.0))
    walk.follow(1, 0.0)
    walk.along((8.0, 0.0))
    graph = walk.result
    assert {vertex.gamma for vertex in graph.vertices} == {-1, 0, 1}
    assert all(e.start.vertex != e.end.vertex for e in graph.edges if e.kind is EdgeKind.BOUNDARY)


@pytest.mark.parametrize(("rise_m", "same"), [(LEVEL_M - 0.3, True), (LEVEL_M + 0.3, False), (4.0, False)])
def test_levels_stay_apart(rise_m: float, same: bool) -> None:
    """What lies above each other in a mine is not one place; a step that the ground grid takes for one level is."""
    walk = Walk()
    walk.follow(-1)
    walk.along((10.0, 0.0), (10.0, 10.0), (0.0, 10.0))
    walk.to(0.0, 2.0, H_M + rise_m)
    walk.along((0.0, 0.0), (3.0, 0.0))
    assert ((1, 1, 1, 0) in boundaries(walk.result)) == same


def test_a_boundary_that_is_met_head_on_has_the_heading_of_the_wall() -> None:
    """Its arrows point along ∂S(d_s), not into the rock."""
    walk = Walk()
    walk.to(5.0, 0.0)
    seen = measurement(None, h_m=H_M, d_m=1.0, d_bearing_rad=0.1)
    walk.graph.fly(seen, walk.pose, walk.pose.t_s)
    walk.graph.enter(Mode.BOUNDARY, 1, None, walk.pose)
    assert walk.result.vertices[1].heading_rad == pytest.approx(0.1 - QUARTER)


def test_turning_on_the_spot_is_no_other_place() -> None:
    """R1 that flies nowhere ends where it began."""
    walk = Walk()
    walk.follow(-1)
    walk.along((6.0, 0.0))
    walk.graph.enter(Mode.CIRCLE, -1, None, walk.told)
    walk.gamma = 0
    for _ in range(50):
        walk.tick()
    walk.leave_for(6.0, 5.0, 1)
    circle = [edge for edge in walk.result.edges if edge.kind is EdgeKind.CIRCLE][-1]
    assert circle.start.vertex == circle.end.vertex
    assert circle.time_s == pytest.approx(50 * TICK_S, abs=2 * TICK_S)


def test_turning_twice_on_one_spot_is_one_edge_flown_twice() -> None:
    """Where no wall is, an edge from a vertex to itself is the same one flown back: it counts as flown that way."""
    walk = Walk()
    for _ in range(2):
        for _ in range(20):
            walk.tick()
        walk.graph.enter(Mode.CIRCLE, 1, None, walk.told)
    (circle,) = walk.result.edges
    assert (circle.flown, circle.flown_back) == (3, 0)


# Exits.


def test_an_exit_is_declined_until_it_is_taken() -> None:
    """A draw against it leaves it untaken; taken the next time round it is none any more."""
    walk = Walk()
    walk.follow(-1)
    walk.along((6.0, 0.0))
    walk.decline(9.0, -4.0)
    assert walk.result.counts()[2:5] == (1, 1, 1)
    walk.along(*SQUARE, (5.5, 0.0))
    walk.leave_for(9.3, -3.8, 1)
    graph = walk.result
    assert [(exit_.left, exit_.decided) for exit_ in graph.exits] == [(Left.TAKEN, 2)]
    assert graph.counts().exits_untaken == 0


def test_an_exit_that_another_way_leads_to_is_visited() -> None:
    """Whether the way came there before or after: what is there has been seen."""
    walk = Walk()
    walk.follow(-1)
    walk.along((6.0, 0.0))
    walk.decline(9.0, 4.0)
    walk.decline(30.0, 9.0)
    walk.along((10.0, 0.0), (10.0, 6.0))
    walk.decline(4.0, 0.2)
    exits = {(exit_.x_m, exit_.y_m): exit_.visited for exit_ in walk.result.exits}
    assert exits == {(9.0, 4.0): True, (30.0, 9.0): False, (4.0, 0.2): True}
    assert walk.result.counts()[3:5] == (3, 1)


def test_the_same_point_is_another_exit_from_elsewhere_and_to_the_other_side() -> None:
    """What one tangent is: T_m, Γ and the direction; seen a metre on it is the same one."""
    walk = Walk()
    walk.follow(-1)
    walk.along((4.0, 0.0))
    walk.decline(9.0, 4.0, 1)
    walk.along((5.0, 0.0))
    walk.decline(9.2, 4.0, 1)
    assert walk.result.counts().exits == 1
    walk.decline(9.2, 4.0, -1)
    assert walk.result.counts().exits == 2
    walk.along((10.0, 0.0), (10.0, 8.0))
    walk.decline(9.2, 4.0, 1)
    assert walk.result.counts().exits == 3


def test_a_tangent_out_of_reach_counts_when_it_is_seen_for_a_while() -> None:
    """An edge of noise is seen for a sample or two, or here and there: it is no exit, and no vertex either."""
    walk = Walk()
    walk.follow(-1)
    for _ in range(5):
        walk.graph.glimpse(8.0, 3.0, 1, walk.told)
        for _ in range(6):
            walk.tick()
    vertices = len(walk.result.vertices)
    assert walk.result.counts().exits == 0
    for _ in range(round(GLIMPSED_S / TICK_S) + 2):
        walk.graph.glimpse(8.0, 3.0, 1, walk.told)
        walk.tick()
    graph = walk.result
    assert [(exit_.left, exit_.decided, exit_.vertex) for exit_ in graph.exits] == [(Left.OUT_OF_REACH, 0, None)]
    assert len(graph.vertices) == vertices
    walk.decline(8.0, 3.0)
    assert [exit_.left for exit_ in walk.result.exits] == [Left.DECLINED]


# Bounds.


def test_a_long_line_keeps_its_corners() -> None:
    """Where points are thinned out, the straight goes first."""
    walk = Walk()
    walk.follow(-1)
    walk.along((40.0, 0.0), (40.0, 30.0), (80.0, 30.0))
    line_m = walk.result.edges[-1].line_m
    assert len(line_m) <= MOST_POINTS
    for corner in ((40.0, 0.0), (40.0, 30.0)):
        assert np.hypot(*(line_m[:, :2] - corner).T).min() < 0.5


_STEPS = st.lists(
    st.tuples(
        st.sampled_from(["follow", "leave", "decline", "circle", "known"]),
        st.integers(-8, 8),
        st.integers(-8, 8),
        st.sampled_from([-1, 1]),
    ),
    max_size=16,
)


def led(walk: Walk, steps: Iterable[tuple[str, int, int, int]]) -> Walk:
    """Do these things after each other, wherever they lead."""
    for what, x_m, y_m, gamma in steps:
        walk.to(float(x_m), float(y_m))
        if what == "follow":
            walk.follow(gamma)
        elif what == "circle":
            walk.graph.enter(Mode.CIRCLE, gamma, None, walk.told)
            walk.gamma = 0
        elif what == "decline":
            walk.decline(float(y_m), float(x_m), gamma)
        else:
            kind = TargetKind.TANGENT if what == "leave" else TargetKind.KNOWN
            walk.leave_for(float(y_m), float(x_m), gamma, kind)
    return walk


@settings(max_examples=40, deadline=None)
@given(steps=_STEPS)
def test_it_is_connected_and_holds_the_whole_way(steps: list[tuple[str, int, int, int]]) -> None:
    """Every metre and second belongs to an edge, and edges hang together as the way does."""
    walk = led(Walk(), steps)
    graph = walk.result
    assert is_connected(graph)
    # It is measured in steps: each of the corners, two for every thing done, may be cut by one.
    assert walk.way_m - 2 * len(steps) * STEP_M <= sum(edge.way_m for edge in graph.edges) <= walk.way_m + 1e-6
    assert sum(edge.time_s for edge in graph.edges) == pytest.approx(walk.pose.t_s - TICK_S, abs=1e-6)
    assert graph.left_out == 0


@settings(max_examples=40, deadline=None)
@given(steps=_STEPS)
def test_a_full_graph_stays_connected(steps: list[tuple[str, int, int, int]]) -> None:
    """What there is no room for is counted; the edge under way goes on to a vertex that is known."""
    walk = led(Walk(NavigationGraph(most_vertices=4, most_exits=3)), steps)
    graph = walk.result
    assert len(graph.vertices) <= 4
    assert len(graph.exits) <= 3
    assert is_connected(graph)
    whole = led(Walk(), steps).result
    assert (graph.left_out > 0) == (len(whole.vertices) > 4 or len(whole.exits) > 3)


# With the navigator.


def test_whatever_the_vehicle_flies_to_is_an_edge() -> None:
    """Protects the flight from a new kind of target that the graph does not know."""
    assert {kind.value for kind in TargetKind} <= {kind.value for kind in EdgeKind}


@pytest.mark.parametrize("wrong", [math.nan, math.inf, 1e300])
def test_heights_that_are_none_end_nothing(wrong: float, tmp_path: Path) -> None:
    """Protects the flight: the law steers without a height, so the graph goes on with the last one, and is written."""
    walk = Walk()
    walk.follow(-1)
    walk.along((6.0, 0.0))
    seen = replace(measurement(None, h_m=wrong), ground_slope=wrong)
    for x_m in range(7, 12):
        lost = replace(walk.pose, x_m=float(x_m), z_m=wrong)
        walk.graph.fly(seen, lost, walk.pose.t_s)
        walk.graph.glimpse(20.0, 3.0, 1, lost)
        walk.graph.decline(EdgeKind.TANGENT, 20.0, 0.0, 1, lost)
        walk.graph.enter(Mode.BOUNDARY, -1, None, lost)
    graph = walk.result
    assert all(vertex.z_m == H_M for vertex in graph.vertices)
    assert is_connected(graph)
    write_graph(graph, tmp_path / "graph.json")
    assert read_graph(tmp_path / "graph.json").counts() == graph.counts()


def test_a_flight_makes_a_graph_and_nothing_steers_by_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Round a block: a tangent to it and its boundary, closed. Without the graph every setpoint is the same."""
    scene = Scene(box(-40.0, -40.0, 40.0, 40.0), box(5.0, -3.5, 8.0, 0.5))
    navigator = navigator_with(period_s=0.1, law="smooth", tangent_probability=NEVER)
    track = fly(navigator, scene, ORIGIN, 120.0)
    graph, so_far = navigator.graph.snapshot(), navigator.graph.so_far()
    assert len(graph.edges) - 1 <= len(so_far.edges) <= len(graph.edges), "all but the piece under way"
    assert so_far.exits == graph.exits
    kinds = [edge.kind for edge in graph.edges]
    assert kinds[:2] == [EdgeKind.CIRCLE, EdgeKind.TANGENT]
    lap = next(edge for edge in graph.edges if edge.kind is EdgeKind.BOUNDARY and edge.start.vertex == edge.end.vertex)
    # Round the block, 14 m, at 1 m from it: 20 m.
    assert lap.length_m == pytest.approx(20.0, abs=2.0)
    assert lap.flown == 2
    flown_m = sum(math.dist((a.x_m, a.y_m), (b.x_m, b.y_m)) for a, b in zip(track.poses, track.poses[1:], strict=False))
    assert sum(edge.way_m for edge in graph.edges) == pytest.approx(flown_m, rel=0.02)
    for name in ("fly", "enter", "decline", "glimpse"):
        monkeypatch.setattr(NavigationGraph, name, lambda *_: None)
    without = fly(navigator_with(period_s=0.1, law="smooth", tangent_probability=NEVER), scene, ORIGIN, 120.0)
    assert track.setpoints == without.setpoints
