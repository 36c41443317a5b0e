"""Between walls that cannot both be kept at d_s the vehicle keeps to the middle."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from companion.control import narrow
from companion.control.governor import ROOM_M, room_m
from companion.model import Mode, Scan
from tests.control.scene import law_parameters, measurement, scan_of
from tests.control.stages import DT_S, ORIGIN, in_boundary, mode_of

FLOWN = {"margin_m": 0.56, "critical_margin_m": 0.46, "speed_mps": 0.25, "closing_saturation_m": 0.5}
SLIM = law_parameters(**FLOWN)


def between(left_m: float, right_m: float, ahead_m: float = math.inf) -> Scan:
    """A straight drift whose walls are so far to either side, and which ends so far ahead."""

    def range_m(bearing_rad: float) -> float:
        beside, along = math.sin(bearing_rad), math.cos(bearing_rad)
        found = [(left_m if beside > 0.0 else right_m) / abs(beside)] if abs(beside) > 0.1 else []
        found += [ahead_m / along] if along > 0.1 else []
        return min(found, default=math.inf)

    return scan_of(range_m)


def posts(*places: tuple[float, float]) -> Scan:
    """Posts of a few degrees at (x, y)."""
    return scan_of(
        lambda bearing_rad: min(
            (math.hypot(x, y) for x, y in places if abs(bearing_rad - math.atan2(y, x)) < 0.05), default=math.inf
        )
    )


def turning_radps(scan: Scan, gamma: int) -> float:
    """What R3 asks for in flight."""
    navigator = in_boundary(gamma, **FLOWN)
    d_m = float(scan.ranges_m[np.isfinite(scan.ranges_m)].min())
    told = measurement(scan, d_m=d_m, d_bearing_rad=math.pi / 2.0, d_front_m=d_m, d_dot_mps=0.0)
    asked = navigator.step(told, replace(ORIGIN, vx_mps=0.2), DT_S)
    assert mode_of(navigator) is Mode.BOUNDARY
    return asked.yaw_rate_radps


@pytest.mark.parametrize("gamma", [-1, 1])
def test_across_a_drift_its_width_is_seen(gamma: int) -> None:
    assert narrow.width_m(between(0.5, 0.7), gamma, SLIM) == pytest.approx(1.2, abs=0.02)


@pytest.mark.parametrize("gamma", [-1, 1])
def test_at_a_mouth_the_width_is_that_between_its_posts(gamma: int) -> None:
    """Protects the turn into a narrow drift: the far post was a wall ahead, and was turned away from."""
    assert narrow.width_m(posts((0.4, gamma * 0.4), (0.8, -gamma * 0.7)), gamma, SLIM) == pytest.approx(1.17, abs=0.05)


@pytest.mark.parametrize(
    ("scan", "why"),
    [
        (between(0.8, 0.8), "both walls can be kept at d_s"),
        (between(0.42, 0.42), "it is narrower than twice d_c"),
        (between(0.6, 0.6, ahead_m=0.5), "it is closed ahead"),
        (between(0.6, 3.0, ahead_m=0.9), "a corner is no way between its walls"),
        (posts((0.4, 0.5)), "only one side has a wall"),
        (posts(), "nothing is near"),
    ],
)
@pytest.mark.parametrize("gamma", [-1, 1])
def test_it_is_no_narrow_place_where(scan: Scan, why: str, gamma: int) -> None:
    """Protects what R3 does everywhere else: a wall ahead must stay a wall ahead."""
    assert narrow.width_m(scan, gamma, SLIM) is None, why


def test_the_wall_on_the_followed_side_is_turned_to_where_the_other_is_nearer() -> None:
    """Protects the drift that is narrower than twice d_s: by its own wall alone it flew along the other one."""
    left_radps, right_radps = turning_radps(between(0.495, 0.55), -1), turning_radps(between(0.55, 0.495), 1)
    assert left_radps < -0.005
    assert right_radps == pytest.approx(-left_radps, abs=1e-3)


@pytest.mark.parametrize("gamma", [-1, 1])
def test_in_the_middle_it_flies_straight_on(gamma: int) -> None:
    assert abs(turning_radps(between(0.55, 0.55), gamma)) < 0.05


def test_between_two_walls_both_turn_it_away_and_without_that_its_own_is_followed() -> None:
    assert narrow.sliding_mps(-0.2, -0.2) == 0.0
    assert narrow.sliding_mps(-0.2, 0.1) == -0.2
    assert narrow.sliding_mps(0.1, -0.2) == 0.2
    assert narrow.sliding_mps(0.1, 0.3) == 0.1
    assert narrow.sliding_mps(math.inf, 0.3) == math.inf


@pytest.mark.parametrize(
    ("margin_m", "critical_m", "kept_m"), [(1.0, 0.8, ROOM_M), (1.3, 0.9, ROOM_M), (0.56, 0.46, 0.03)]
)
def test_a_small_vehicle_keeps_less_more_than_d_c(margin_m: float, critical_m: float, kept_m: float) -> None:
    """Protects the presets to the last bit, and the width of narrow places from a constant."""
    kept = room_m(law_parameters(margin_m=margin_m, critical_margin_m=critical_m))
    assert kept == ROOM_M if kept_m == ROOM_M else kept == pytest.approx(kept_m)


def test_seen_from_further_on_the_mouth_is_the_same() -> None:
    scan = posts((0.8, 0.6), (0.8, -0.6))
    assert narrow.width_m(scan, 1, SLIM, lead_m=0.2) == pytest.approx(1.2, abs=0.1)
