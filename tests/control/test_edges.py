"""Edges, the targets (10) beside them, and the corridors to them: the side of everything, and unknown is not free."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.control.edges import (
    CORRIDOR_SHARE,
    Edge,
    corridor_is_free,
    find_edges,
    has_way_on,
    lies_along_boundary,
    open_direction,
    tangent_target,
)
from companion.model import CLEAR, HIT, UNKNOWN, Pose, Scan
from tests.control.scene import (
    BEARINGS_RAD,
    BINS,
    CAMERA_RAD,
    LIMIT_M,
    Scene,
    box,
    law_parameters,
    mirrored_scan,
    scan_of,
)
from tests.control.stages import compiled

LAW = law_parameters(margin_m=1.0, edge_jump_m=2.0, edge_bearing_rad=0.6)
AHEAD = BINS // 2
"""The first bearing left of the heading: AHEAD - 1 is the first one right of it."""


def two_walls(right_m: float, left_m: float) -> Scan:
    """A wall at each side of the heading, as arcs about the vehicle; NaN is UNKNOWN."""
    return scan_of(lambda bearing_rad: right_m if bearing_rad < 0.0 else left_m)


def point(bearing_rad: float, range_m: float) -> complex:
    """Polar coordinates as a point of the plane, x ahead and y to the left."""
    return range_m * complex(math.cos(bearing_rad), math.sin(bearing_rad))


# (10).


@given(
    bearing_rad=st.floats(-3.0, 3.0),
    step_rad=st.floats(0.001, 0.05),
    near_m=st.floats(0.3, 20.0),
    jump_m=st.floats(0.1, 50.0),
    margin_m=st.floats(0.3, 5.0),
    near_is_left=st.booleans(),
)
def test_target_is_abeam_of_the_edge_at_the_margin_on_the_open_side(
    bearing_rad: float, step_rad: float, near_m: float, jump_m: float, margin_m: float, near_is_left: bool
) -> None:
    """(10): T_m is the edge point, moved by d_s at a right angle to the line of sight, away from the near wall."""
    right_m, left_m = (near_m + jump_m, near_m) if near_is_left else (near_m, near_m + jump_m)
    bearing_m_rad, range_m = tangent_target(bearing_rad, right_m, bearing_rad + step_rad, left_m, margin_m)
    middle_rad = bearing_rad + step_rad / 2.0
    edge, target = point(middle_rad, near_m), point(bearing_m_rad, range_m)
    # In the frame of the line of sight to the edge: x along it, y to its left. Rounding of some 20 m: 1e-12.
    offset = (target - edge) * complex(math.cos(middle_rad), -math.sin(middle_rad))
    assert offset.real == pytest.approx(0.0, abs=1e-12)
    assert offset.imag == pytest.approx(-margin_m if near_is_left else margin_m, abs=1e-12)
    assert range_m == pytest.approx(math.sqrt(margin_m**2 + near_m**2), rel=1e-15)


@pytest.mark.parametrize(
    ("right_m", "left_m", "gamma", "target_y_m"),
    [
        pytest.param(9.0, 4.0, 1, -1.0, id="near wall left: it will be on the left, pass it on its right"),
        pytest.param(4.0, 9.0, -1, 1.0, id="near wall right: it will be on the right, pass it on its left"),
    ],
)
def test_an_edge_ahead_has_its_target_on_the_open_side(
    right_m: float, left_m: float, gamma: int, target_y_m: float
) -> None:
    """(10) and Γ by hand: an edge 4 m straight ahead, so the target is at (4, ±1)."""
    (edge,) = find_edges(two_walls(right_m, left_m), LAW)
    assert edge.gamma == gamma
    target = point(edge.target_bearing_rad, edge.target_range_m)
    assert target.real == pytest.approx(4.0, abs=1e-12)
    assert target.imag == pytest.approx(target_y_m, abs=1e-12)
    assert edge.near_range_m == 4.0
    assert math.copysign(1.0, edge.near_bearing_rad) == gamma


#   Seen from above, x to the right, the vehicle at > looks east; the block's corner is the edge.
#
#            +-----+                                   T
#            |block|
#     >      |     |                                    +-----+
#            +-----+                             >      |     |
#                                                       |block|
#           T                                           +-----+
#     block on the left: Γ = 1, T right of it     on the right: Γ = -1, T left of it
@pytest.mark.parametrize("side", [1, -1])
def test_a_block_to_one_side_gives_the_target_past_its_corner(side: int) -> None:
    """Edge, target and corridor in a world of polygons: d_s clear of the true corner, and the way there is free."""
    low, high = sorted((side * -0.5, side * 3.0))
    scene = Scene(box(-4.0, -15.0, 30.0, 15.0), box(5.0, low, 8.0, high))
    scan = scene.scan(Pose(0.0, 0.0, 0.0, 1.5, 0.0))
    edge = next(edge for edge in find_edges(scan, LAW) if edge.gamma == side)
    corner, target = complex(5.0, side * -0.5), point(edge.target_bearing_rad, edge.target_range_m)
    # The corner lies anywhere within the degree between two bearings: up to 9 cm at 5 m.
    degree_m = 5.0 * math.radians(1.0)
    assert abs(abs(target - corner) - LAW.margin_m) <= degree_m
    assert (target - corner).imag * side < 0.0
    half_width_m = CORRIDOR_SHARE * LAW.margin_m
    assert corridor_is_free(scan, edge.target_bearing_rad, edge.target_range_m, half_width_m)
    # The other side of the corner is the block itself.
    wrong_rad = 2.0 * math.atan2(corner.imag, corner.real) - edge.target_bearing_rad
    assert not corridor_is_free(scan, wrong_rad, edge.target_range_m, half_width_m)


# What is an edge.


def test_a_jump_to_clear_counts() -> None:
    """Where the next wall is out of range the drift is wide open: HIT to CLEAR is an edge."""
    (edge,) = find_edges(two_walls(math.inf, 4.0), LAW)
    assert edge.gamma == 1


@pytest.mark.parametrize("stale_m", [0.0, 9.0])
@pytest.mark.parametrize("side", [-1, 1])
def test_a_jump_to_unknown_does_not_count(side: int, stale_m: float) -> None:
    """Nobody looked there, so nobody knows that there is a way, whatever number may stand in the range."""
    scan = two_walls(*((4.0, math.nan) if side < 0 else (math.nan, 4.0)))
    scan.ranges_m[scan.state == UNKNOWN] = stale_m
    assert find_edges(scan, LAW) == []


@pytest.mark.parametrize("width", [1, 5, AHEAD])
def test_a_jump_from_clear_does_not_count(width: int) -> None:
    """Two range limits that meet (camera and beam) are no obstacle's edge: only a HIT is."""
    scan = two_walls(4.0, 9.0)
    scan.state[AHEAD - width : AHEAD] = CLEAR
    assert find_edges(scan, LAW) == []


@compiled
@given(heading_rad=st.floats(-math.pi, math.pi), beside_m=st.floats(0.4, 4.0))
def test_a_wall_at_a_slant_has_no_edge(heading_rad: float, beside_m: float) -> None:
    """Nothing is there but a straight wall, seen from anywhere near it and under any angle."""
    scene = Scene(box(-50.0, -beside_m, 50.0, 50.0))
    assert find_edges(scene.scan(Pose(0.0, 0.0, 0.0, 1.5, heading_rad)), LAW) == []


def test_the_jump_along_a_slanting_wall_is_explained_by_its_slant() -> None:
    """Far ahead the range along a wall jumps from bearing to bearing by more than r̄, and still that is no edge."""
    scan = Scene(box(-50.0, -1.0, 50.0, 50.0)).scan(Pose(0.0, 0.0, 0.0, 1.5, 0.0), limit_m=2.0 * LIMIT_M)
    assert np.max(np.abs(np.diff(scan.ranges_m[np.abs(BEARINGS_RAD) < LAW.edge_bearing_rad]))) > LAW.edge_jump_m
    assert find_edges(scan, LAW) == []


@pytest.mark.parametrize("bearing", range(AHEAD - 3, AHEAD + 3))
def test_a_remembered_jump_does_not_count(bearing: int) -> None:
    """Both ends, and the bearing behind each, must have been seen just now; what is further off may be memory."""
    scan = two_walls(4.0, 9.0)
    scan.fresh[bearing] = False
    needed = range(AHEAD - 2, AHEAD + 2)
    assert len(find_edges(scan, LAW)) == (0 if bearing in needed else 1)


def test_one_far_bearing_is_no_way_out() -> None:
    """A chink of one degree, or one flying pixel, is no edge; a gap of two is."""
    scan = two_walls(4.0, 4.0)
    scan.ranges_m[AHEAD] = 9.0
    assert find_edges(scan, LAW) == []
    scan.ranges_m[AHEAD + 1] = 9.0
    assert sorted(edge.gamma for edge in find_edges(scan, LAW)) == [-1, 1]


@pytest.mark.parametrize(("jump_m", "edges"), [(1.99, 0), (2.01, 1)])
def test_the_jump_must_exceed_the_threshold(jump_m: float, edges: int) -> None:
    """|r_i - r_{i+1}| > r̄, the corrected sign of the rule, at its limit."""
    assert len(find_edges(two_walls(4.0, 4.0 + jump_m), LAW)) == edges


@pytest.mark.parametrize(("bearing_rad", "edges"), [(0.55, 1), (-0.55, 1), (0.65, 0), (-0.65, 0), (2.0, 0)])
def test_an_edge_counts_only_near_the_heading(bearing_rad: float, edges: int) -> None:
    """|α| < ᾱ = 0.6 rad at both ends: that is what makes it an exit direction (Definition 3.6)."""
    scan = scan_of(lambda bearing: 4.0 if bearing < bearing_rad else 9.0)
    # The other end of the far wall, at ±π, is never near the heading.
    assert len(find_edges(scan, LAW)) == edges


def test_the_nearest_edge_comes_first() -> None:
    """The rules take the first that will do, so the order is part of the meaning."""
    ranges_m = {-3: 7.0, -2: 3.0, -1: 9.9, 0: 5.0, 1: 2.0, 2: 9.0}
    scan = scan_of(lambda bearing: ranges_m.get(math.floor(bearing / 0.15), 4.0))
    near = [edge.near_range_m for edge in find_edges(scan, LAW)]
    assert near == sorted(near)
    assert len(set(near)) > 1


blocks = st.lists(
    st.tuples(
        st.integers(1, 12),
        st.sampled_from([HIT, HIT, HIT, CLEAR, UNKNOWN]),
        st.floats(0.5, 9.5),
        st.sampled_from([True, True, True, False]),
    ),
    min_size=10,
    max_size=30,
)
"""Stretches of a scan: how many degrees, what is known, how far, whether seen just now."""


def scan_of_blocks(stretches: list[tuple[int, np.uint8, float, bool]]) -> Scan:
    """The stretches side by side about the heading; the rest is UNKNOWN."""
    ranges, state, fresh = np.zeros(BINS), np.full(BINS, UNKNOWN, np.uint8), np.zeros(BINS, np.bool_)
    at = max(0, AHEAD - sum(width for width, *_ in stretches) // 2)
    for width, kind, range_m, just_now in stretches:
        ranges[at : at + width] = {int(HIT): range_m, int(CLEAR): LIMIT_M}.get(int(kind), 0.0)
        state[at : at + width] = kind
        fresh[at : at + width] = just_now
        at += width
    return Scan(BEARINGS_RAD.copy(), ranges, state, fresh)


def as_rows(edges: list[Edge]) -> list[list[float]]:
    """Edges as sorted rows of numbers, so that those of two scans can be compared."""
    return sorted(
        [e.near_range_m, e.near_bearing_rad, e.target_range_m, e.target_bearing_rad, float(e.gamma)] for e in edges
    )


@compiled
@given(stretches=blocks)
def test_a_mirrored_scan_has_the_mirrored_edges(stretches: list[tuple[int, np.uint8, float, bool]]) -> None:
    """Left and right exchanged: bearings and Γ change sign, ranges stay, and no edge is lost or gained."""
    scan = scan_of_blocks(stretches)
    turned = [
        replace(
            edge,
            near_bearing_rad=-edge.near_bearing_rad,
            target_bearing_rad=-edge.target_bearing_rad,
            gamma=-edge.gamma,
        )
        for edge in find_edges(scan, LAW)
    ]
    # The wrap of an angle rounds differently on either side of zero, by a few times 2^-53 of π.
    np.testing.assert_allclose(as_rows(find_edges(mirrored_scan(scan), LAW)), as_rows(turned), atol=1e-14)


@compiled
@given(stretches=blocks)
def test_every_edge_is_what_an_edge_is(stretches: list[tuple[int, np.uint8, float, bool]]) -> None:
    """Near end HIT, far end known and more than r̄ further, Γ on the near side, whatever the scan looks like."""
    scan = scan_of_blocks(stretches)
    for edge in find_edges(scan, LAW):
        near = int(np.argmin(np.abs(scan.bearings_rad - edge.near_bearing_rad)))
        far = near - edge.gamma
        assert scan.state[near] == HIT
        assert scan.state[far] != UNKNOWN
        assert scan.ranges_m[far] - scan.ranges_m[near] > LAW.edge_jump_m
        assert abs(edge.near_bearing_rad) < LAW.edge_bearing_rad
        assert edge.target_range_m > edge.near_range_m


# Corridors.


@compiled
@given(
    bearing=st.integers(0, BINS - 1),
    range_m=st.floats(0.1, 9.9),
    axis_rad=st.floats(-math.pi, math.pi),
    length_m=st.floats(0.5, 8.0),
    half_width_m=st.floats(0.3, 3.0),
)
def test_a_corridor_is_closed_by_a_point_in_its_rectangle_only(
    bearing: int, range_m: float, axis_rad: float, length_m: float, half_width_m: float
) -> None:
    """Definition 3.4: one HIT, everything else seen free; the corridor as the rectangle that it is."""
    scan = two_walls(math.inf, math.inf)
    scan.ranges_m[bearing], scan.state[bearing] = range_m, HIT
    there = point(float(scan.bearings_rad[bearing]) - axis_rad, range_m)
    # Points within rounding of the rectangle's border may go either way.
    border_m = min(abs(there.real - length_m), abs(abs(there.imag) - half_width_m), abs(there.real))
    inside = 0.0 < there.real < length_m and abs(there.imag) < half_width_m
    if border_m > 1e-9:
        assert corridor_is_free(scan, axis_rad, length_m, half_width_m) != inside


@pytest.mark.parametrize("axis_rad", [0.0, 0.7, -2.5, math.pi, -math.pi])
def test_a_corridor_over_unknown_ground_is_refused(axis_rad: float) -> None:
    """Unknown is not free, wherever the corridor points, also across the seam of the bearings."""
    scan = two_walls(math.inf, math.inf)
    assert corridor_is_free(scan, axis_rad, 5.0, 0.9)
    off = np.abs((scan.bearings_rad - axis_rad + math.pi) % (2.0 * math.pi) - math.pi)
    scan.state[int(np.argmin(off))], scan.ranges_m[int(np.argmin(off))] = UNKNOWN, 0.0
    assert not corridor_is_free(scan, axis_rad, 5.0, 0.9)


def test_a_corridor_may_pass_unknown_ground_beside_and_behind() -> None:
    """What the camera cannot see at its sides must not close the way ahead, or no tangent could ever be flown."""
    scan = scan_of(lambda bearing_rad: math.inf if abs(bearing_rad) <= CAMERA_RAD / 2.0 else math.nan)
    assert corridor_is_free(scan, 0.0, 5.0, 0.9)


def test_a_corridor_beyond_the_range_limit_is_refused() -> None:
    """CLEAR says nothing about what is behind the limit."""
    scan = two_walls(math.inf, math.inf)
    assert corridor_is_free(scan, 0.0, LIMIT_M - 0.5, 0.9)
    assert not corridor_is_free(scan, 0.0, LIMIT_M + 0.5, 0.9)


@compiled
@given(stretches=blocks, axis_rad=st.floats(-0.6, 0.6), length_m=st.floats(0.5, 9.0), half_m=st.floats(0.3, 1.5))
def test_a_corridor_is_free_or_not_alike_in_the_mirror(
    stretches: list[tuple[int, np.uint8, float, bool]], axis_rad: float, length_m: float, half_m: float
) -> None:
    """Neither side is treated differently."""
    scan = scan_of_blocks(stretches)
    here = corridor_is_free(scan, axis_rad, length_m, half_m)
    assert here == corridor_is_free(mirrored_scan(scan), -axis_rad, length_m, half_m)


# The edge of the wall that is being followed.


#                               a wall on the right that ends at a corner: following it leads round that corner anyway,
#      >     . . . . T          T lies on the way there
#      +===wall===+
@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize("heading_rad", [0.0, 0.5])
def test_the_end_of_the_followed_wall_lies_along_the_boundary(side: int, heading_rad: float) -> None:
    """A tangent that following the wall flies anyway is no decision, however the vehicle points just now."""
    low, high = sorted((-side * 1.0, -side * 4.0))
    scene = Scene(box(-30.0, -12.0, 30.0, 12.0), box(0.0, low, 5.0, high))
    yaw_rad = side * heading_rad
    scan = scene.scan(Pose(0.0, 0.0, 0.0, 1.5, yaw_rad))
    # The wall's own corner is at 5 m ahead, d_s beside the vehicle's way: the target is at (5, 0) in the world.
    near_rad = -side * math.atan2(1.0, 5.0) - yaw_rad
    assert lies_along_boundary(scan, Edge(near_rad, math.hypot(5.0, 1.0), -yaw_rad, 5.0, -side), LAW.margin_m)
    # Nothing is there to be followed the other way, nor on the other hand.
    for elsewhere_rad in (math.pi - yaw_rad, side * 1.0 - yaw_rad):
        assert not lies_along_boundary(scan, Edge(near_rad, 5.0, elsewhere_rad, 5.0, -side), LAW.margin_m)


@pytest.mark.parametrize("side", [-1, 1])
def test_a_tangent_across_the_room_does_not_lie_along_the_boundary(side: int) -> None:
    """A pillar away from the wall that is being followed is a decision, on either side."""
    low, high = sorted((-side * 8.0, -side * 6.0))
    scene = Scene(box(-30.0, -12.0, 30.0, 12.0), box(3.0, low, 5.0, high))
    scan = scene.scan(Pose(0.0, 0.0, -side * 11.0, 1.5, side * math.pi / 4.0), CAMERA_RAD)
    found = find_edges(scan, LAW)
    assert sorted(edge.gamma for edge in found) == [-1, 1]
    assert not any(lies_along_boundary(scan, edge, LAW.margin_m) for edge in found)


# The way out.


@pytest.mark.parametrize("heading_deg", [0.0, 50.0, -120.0, 179.0])
def test_the_open_direction_is_along_the_drift(heading_deg: float) -> None:
    """The longest corridor of a drift that is closed at one end leads to the other."""
    scene = Scene(box(-1.0, -1.2, 8.0, 1.2))
    heading_rad = math.radians(heading_deg)
    bearing_rad, length_m = open_direction(scene.scan(Pose(0.0, 0.0, 0.0, 1.5, heading_rad)), 0.7)
    end = point(heading_rad + bearing_rad, length_m)
    # The corridor of half-width 0.7 m may lie askew within the drift's 1.2 m: half a metre over its 8 m.
    assert abs(end.imag) <= 1.2 - 0.7
    assert 7.0 < end.real <= 8.0


def test_there_is_no_open_direction_in_a_shaft() -> None:
    """Where the body does not fit there is no way out, and none may be invented: 0 m beyond the wall."""
    scene = Scene(box(-0.5, -0.5, 0.5, 0.5))
    _, length_m = open_direction(scene.scan(Pose(0.0, 0.0, 0.0, 1.5, 0.3)), 0.4)
    # The far corner is 0.71 m away, and no corridor can be longer than the ray to it.
    assert length_m <= math.hypot(0.5, 0.5)


def test_nothing_known_has_no_open_direction() -> None:
    """Unknown is not free."""
    assert open_direction(two_walls(math.nan, math.nan), 0.7)[1] == 0.0


@pytest.mark.parametrize("heading_deg", [0.0, 100.0, -179.0])
@pytest.mark.parametrize(("d_m", "way_on"), [(0.55, True), (0.45, False)])
def test_one_flat_wall_lets_fly_on_down_to_a_limit(heading_deg: float, d_m: float, way_on: bool) -> None:
    """d_f looks at 270°: 0.7 m of wall fit into the 90° behind only from further than 0.7/√2 = 0.495 m away."""
    scene = Scene(box(d_m, -20.0, 40.0, 20.0))
    assert has_way_on(scene.scan(Pose(0.0, 0.0, 0.0, 1.5, math.radians(heading_deg))), 0.7) is way_on


@pytest.mark.parametrize("side", [-1, 1])
def test_a_corner_or_a_gap_nearer_than_d_c_leaves_no_way_on(side: int) -> None:
    """Two walls within d_c leave no heading with d_f >= d_c, whatever the turn; further away they do."""
    pose = Pose(0.0, 0.0, 0.0, 1.5, 0.4)
    low_m, high_m = sorted((side * 0.6, -side * 20.0))
    corner = box(-20.0, low_m, 0.6, high_m)
    gap = box(-20.0, -0.6, 20.0, 0.6)
    for walls in (corner, gap):
        assert not has_way_on(Scene(walls).scan(pose), 0.7)
        assert has_way_on(Scene(walls).scan(pose), 0.5)


def test_open_ground_has_a_way_on() -> None:
    """Nothing near holds nobody back."""
    assert has_way_on(two_walls(math.inf, math.inf), 0.7)
