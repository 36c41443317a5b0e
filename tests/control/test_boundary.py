"""R3 steers by the wall that it follows and by what lies ahead; the other side only makes it slower."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from companion.control.boundary import followed, nearest
from companion.model import Measurement, Mode, Scan
from companion.sides import Side, Sides
from tests.control.scene import BEARINGS_RAD, measurement, scan_of
from tests.control.stages import DT_S, ORIGIN, in_boundary, in_tangent, mode_of

HALF_WIDTH_M = 0.8


def seen(gamma: int, *posts: tuple[float, float]) -> Scan:
    """A straight wall at 1 m on the side of Γ, and posts of a few degrees at (x, y), where y > 0 is the other side."""
    places = [(math.atan2(-gamma * y_m, x_m), math.hypot(x_m, y_m)) for x_m, y_m in posts]

    def range_m(bearing_rad: float) -> float:
        beside = math.sin(gamma * bearing_rad)
        found = [1.0 / beside] if beside > 0.2 else []
        found += [far_m for at_rad, far_m in places if abs(bearing_rad - at_rad) < 0.05]
        return min(found, default=math.inf)

    return scan_of(range_m)


def looking(scan: Scan) -> Measurement:
    """With d of any side, as it is measured."""
    found = nearest(scan, np.ones(BEARINGS_RAD.size, np.bool_))
    assert found is not None
    return measurement(scan, d_m=found[0], d_bearing_rad=found[1], d_front_m=found[0], d_dot_mps=0.0)


@pytest.mark.parametrize("gamma", [-1, 1])
@pytest.mark.parametrize("post", [(0.0, 0.85), (0.4, 0.85), (-0.6, 0.5)])
def test_a_post_on_the_other_side_is_not_the_wall_that_is_followed(gamma: int, post: tuple[float, float]) -> None:
    """Protects from niches: at the mouth the other post was nearest, and the vehicle turned back in, 23 times."""
    found = followed(seen(gamma, post), gamma, HALF_WIDTH_M)
    assert found == pytest.approx((1.0, gamma * math.pi / 2.0), abs=0.03)


@pytest.mark.parametrize("gamma", [-1, 1])
def test_what_lies_in_the_way_counts_on_whichever_side_it_is(gamma: int) -> None:
    """Protects from flying at a post because it stands a little to the other side."""
    found = followed(seen(gamma, (0.7, 0.5)), gamma, HALF_WIDTH_M)
    assert found is not None
    assert found[0] == pytest.approx(math.hypot(0.7, 0.5), abs=0.03)


@pytest.mark.parametrize("gamma", [-1, 1])
def test_seen_from_further_on_the_wall_ahead_comes_first(gamma: int) -> None:
    """Protects from creeping up to every corner: the wall ahead was none until it was nearer than the one beside."""
    corner = seen(gamma, (1.3, 0.0))
    here, there = (followed(corner, gamma, HALF_WIDTH_M, lead_m) for lead_m in (0.0, 0.4))
    assert here == pytest.approx((1.0, gamma * math.pi / 2.0), abs=0.03)
    assert there == pytest.approx((0.9, 0.0), abs=0.06)


def test_before_a_corner_the_smooth_law_turns_away_and_never_towards_it_early() -> None:
    """Protects d_s on both: an arc before the wall that comes, and none into the edge that the vehicle has to pass."""
    pose = replace(ORIGIN, vx_mps=0.4)
    turns = {}
    for name, scan in (
        ("wall ahead", seen(-1, (1.3, 0.0))),
        # The wall on the right ends 0.3 m further on: from there it lies behind, and (7) would turn towards it.
        ("edge to pass", scan_of(lambda b: -1.0 / math.sin(b) if -2.9 < b < -math.atan2(1.0, 0.3) else math.inf)),
    ):
        navigator = in_boundary(-1, law="smooth")
        navigator.step(looking(scan), replace(pose, x_m=-0.02), 0.0)
        turns[name] = navigator.step(looking(scan), pose, DT_S).yaw_rate_radps
    assert turns["wall ahead"] > 0.5, "away from the wall on the right and the one ahead"
    assert turns["edge to pass"] == pytest.approx(0.0, abs=0.1)


@pytest.mark.parametrize("gamma", [-1, 1])
@pytest.mark.parametrize(("own_m", "other_m", "turned"), [(math.inf, 1.0, True), (4.0, 1.2, True), (2.0, 1.0, False)])
def test_at_the_target_the_wall_that_is_really_near_is_followed(
    gamma: int, own_m: float, other_m: float, turned: bool
) -> None:
    """Protects from a U-turn through the margin of the opposite wall, after a tangent that was none."""

    def range_m(bearing_rad: float) -> float:
        side = math.sin(gamma * bearing_rad)
        return own_m / side if side > 0.3 else other_m / -side if side < -0.3 else math.inf

    navigator = in_tangent(gamma, law="smooth")
    there = measurement(scan_of(range_m), d_m=other_m, d_bearing_rad=-gamma * math.pi / 2.0, d_front_m=other_m)
    navigator.step(there, replace(ORIGIN, x_m=4.0, y_m=-float(gamma)), 1.0)
    assert mode_of(navigator) is Mode.BOUNDARY
    assert navigator.status.gamma == (-gamma if turned else gamma)


def test_nothing_to_follow_is_none() -> None:
    """Protects from a wall that is not there: then it flies straight on, and R3 ends after a while."""
    assert followed(scan_of(lambda _: math.inf), 1, HALF_WIDTH_M) is None
    assert followed(seen(-1), 1, HALF_WIDTH_M) is None, "only the other side has a wall, beside"


def test_the_papers_law_takes_d_of_any_side() -> None:
    """Protects the presets of the paper's tables: they remain the paper, niches included."""
    asked = []
    for scan in (seen(1), seen(1, (0.1, 0.86))):
        told = replace(looking(scan), d_dot_mps=-0.01, sides=Sides(right=Side(0.5, 0.0)))
        asked.append(in_boundary(1, law="paper").step(told, replace(ORIGIN, vx_mps=0.5), DT_S))
    assert asked[0].yaw_rate_radps == asked[1].yaw_rate_radps == -in_boundary(1).parameters.max_yaw_rate_radps
    assert asked[0].lateral_mps == 0.0, "and its vehicle flies where it points"
    near = replace(looking(seen(1)), d_m=1.5, d_dot_mps=0.0)
    turned = in_boundary(1, law="paper").step(near, ORIGIN, DT_S).yaw_rate_radps
    assert turned > 0.0, "d is the measured one"


@pytest.mark.parametrize("gamma", [-1, 1])
def test_beside_another_wall_the_yaw_rate_is_the_one_of_the_followed_wall(gamma: int) -> None:
    """Protects the way out of a niche: with d of any side and the sign of one it turns towards the wrong wall."""
    rates = []
    for scan in (seen(gamma), seen(gamma, (0.1, 1.4))):
        navigator = in_boundary(gamma)
        pose = replace(ORIGIN, vx_mps=0.5)
        rates.append(navigator.step(looking(scan), pose, DT_S).yaw_rate_radps)
        assert mode_of(navigator) is Mode.BOUNDARY
    assert rates[0] == pytest.approx(rates[1], abs=1e-6)
    assert abs(rates[0]) < 0.1
