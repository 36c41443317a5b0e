"""What the navigator does with inputs that are missing, not finite or absurd: it stops, and its word is a number."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.control.standing import AWAY_MPS
from companion.model import CLEAR, HIT, UNKNOWN, Input, Measurement, Mode, Pose, Scan
from tests.control.scene import BINS, measurement
from tests.control.stages import (
    DT_S,
    IN_MODE,
    ORIGIN,
    beside,
    compiled,
    edge_scan,
    in_boundary,
    navigator_with,
    random_scan,
    two_walls,
)

# What is missing stops the vehicle.


BROKEN: dict[str, Callable[[Measurement, Pose], tuple[Measurement, Pose]]] = {
    "depth missing": lambda m, p: (replace(m, missing=(Input.DEPTH,)), p),
    "pose missing": lambda m, p: (replace(m, missing=(Input.POSE,)), p),
    "no scan": lambda m, p: (replace(m, scan=None), p),
    "d": lambda m, p: (replace(m, d_m=math.nan), p),
    "infinite d": lambda m, p: (replace(m, d_m=math.inf), p),
    "rate of d": lambda m, p: (replace(m, d_dot_mps=math.nan), p),
    "x": lambda m, p: (m, replace(p, x_m=math.nan)),
    "y": lambda m, p: (m, replace(p, y_m=math.inf)),
    "yaw": lambda m, p: (m, replace(p, yaw_rad=math.nan)),
}
"""What can be wrong with one tick; a name alone means that it is not finite."""


@pytest.mark.parametrize("wrong", BROKEN)
@pytest.mark.parametrize("mode", IN_MODE)
@pytest.mark.parametrize("law", ["paper", "smooth"])
@pytest.mark.parametrize("speed_law", ["paper", "governor"])
def test_what_is_missing_or_not_finite_stops_the_vehicle(wrong: str, mode: Mode, law: str, speed_law: str) -> None:
    """No speed and no turn on a guess; the height, which is known, is still held; and then the flight goes on."""
    navigator = IN_MODE[mode](law=law, speed_law=speed_law)
    before = navigator.status
    look = replace(beside(1), h_m=1.4)
    told, pose = BROKEN[wrong](look, ORIGIN)
    setpoint = navigator.step(told, pose, DT_S)
    assert (setpoint.speed_mps, setpoint.yaw_rate_radps) == (0.0, 0.0)
    # g·(H - h) = 1/s · 0.1 m, rounded.
    assert setpoint.climb_mps == pytest.approx(0.1, abs=1e-12)
    assert navigator.status == replace(before, mode=Mode.HOLD)
    navigator.step(look, ORIGIN, 2.0 * DT_S)
    assert navigator.status == before


@pytest.mark.parametrize(
    ("told", "pose"),
    [
        pytest.param(replace(beside(1), d_bearing_rad=math.nan), ORIGIN, id="bearing of d"),
        pytest.param(replace(beside(1), d_bearing_rad=math.inf), ORIGIN, id="infinite bearing of d"),
        pytest.param(replace(beside(1), d_front_m=math.nan), ORIGIN, id="d in front"),
        pytest.param(beside(1), replace(ORIGIN, vx_mps=math.nan), id="velocity"),
    ],
)
def test_no_law_is_fed_with_what_is_not_finite(told: Measurement, pose: Pose) -> None:
    """α*, d_f and the velocity steer as d does: (12) cannot stop for a NaN, so the vehicle must."""
    navigator = in_boundary(1)
    setpoint = navigator.step(told, pose, 0.0)
    assert navigator.status.mode is Mode.HOLD
    assert (setpoint.speed_mps, setpoint.yaw_rate_radps) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("told", "pose"),
    [
        pytest.param(replace(beside(1), h_m=math.nan), ORIGIN, id="height"),
        pytest.param(replace(beside(1), roof_m=math.nan), ORIGIN, id="roof"),
        pytest.param(replace(beside(1), ground_slope=math.nan), ORIGIN, id="slope"),
        pytest.param(replace(beside(1), ground_slope=0.1), replace(ORIGIN, vx_mps=math.nan), id="velocity on a slope"),
    ],
)
def test_what_is_not_finite_is_no_reason_to_climb(told: Measurement, pose: Pose) -> None:
    """At H, with a NaN from anything that the height law uses: neither up nor down."""
    assert in_boundary(1).step(told, pose, 0.0).climb_mps == 0.0


@pytest.mark.parametrize("choice", ["coin", "frontier", "informed"])
@pytest.mark.parametrize("wrong", [math.nan, math.inf, 1e300])
def test_a_height_that_is_none_ends_no_flight(choice: str, wrong: float) -> None:
    """Protects from a known ground that asks for the level of a place of which it has no height: before, it raised."""
    for told, pose in (
        (beside(1, edge_scan(-1)), replace(ORIGIN, z_m=wrong)),
        (replace(beside(1, edge_scan(-1)), h_m=wrong, ground_slope=wrong, roof_m=wrong), ORIGIN),
        (replace(beside(1, edge_scan(-1)), h_m=None, roof_m=wrong), ORIGIN),
        (replace(beside(1, edge_scan(-1)), roof_m=wrong), ORIGIN),
    ):
        navigator = in_boundary(1, choice=choice)
        for tick in range(4):
            setpoint = navigator.step(replace(told, t_s=float(tick)), replace(pose, x_m=0.3 * tick), float(tick))
            assert all(math.isfinite(value) for value in (setpoint.speed_mps, setpoint.yaw_rate_radps))
        assert navigator.graph.snapshot().counts().vertices > 0


def test_an_edge_at_no_distance_is_no_crash() -> None:
    """A HIT at range 0, which no sensor should give: T_m of (10) is then abeam, and nothing is divided by zero."""
    navigator = navigator_with()
    setpoint = navigator.step(measurement(two_walls(0.0, 9.0)), ORIGIN, 0.0)
    assert 0.0 <= setpoint.speed_mps <= navigator.parameters.speed_mps


nasty = st.none() | st.floats() | st.sampled_from([0.0, -1.0, 1e-300, 1e300, math.nan, math.inf, -math.inf])
numbers = st.floats() | st.floats(-50.0, 50.0) | st.sampled_from([math.nan, math.inf, -math.inf])
places = st.floats(-50.0, 50.0) | st.floats(-50.0, 50.0) | st.sampled_from([1e9, math.nan, math.inf, -math.inf])


@st.composite
def nasty_scans(draw: st.DrawFn) -> Scan | None:
    """No scan, a good one, or one with numbers in it that no sensor should give."""
    kind = draw(st.sampled_from(["none", "random", "edge", "bad", "bad"]))
    if kind == "none":
        return None
    if kind == "edge":
        return edge_scan(draw(st.sampled_from([-1, 1])))
    scan = random_scan(np.random.default_rng(draw(st.integers(0, 2**32 - 1))))
    if kind == "bad":
        for _ in range(draw(st.integers(1, 5))):
            at = draw(st.integers(0, BINS - 1))
            scan.ranges_m[at : at + 3] = draw(st.sampled_from([math.nan, math.inf, -1.0, 0.0, 1e-300, 1e300]))
            scan.state[at : at + 3] = draw(st.sampled_from([HIT, CLEAR, UNKNOWN]))
    return scan


nasty_ticks = st.tuples(
    st.builds(
        Measurement,
        t_s=st.floats(0.0, 1e6),
        scan_age_s=numbers,
        scan=nasty_scans(),
        h_m=nasty,
        roof_m=nasty,
        ground_slope=nasty,
        d_m=nasty | st.floats(0.0, 5.0),
        d_bearing_rad=nasty | st.floats(-math.pi, math.pi),
        d_front_m=nasty | st.floats(0.0, 5.0),
        d_dot_mps=nasty | st.floats(-1.0, 1.0),
        ahead_m=numbers,
        ranges_age_s=numbers,
        missing=st.sampled_from([(), (), (), (Input.DEPTH,)]),
    ),
    st.builds(
        Pose,
        t_s=st.just(0.0),
        x_m=places,
        y_m=places,
        z_m=numbers,
        yaw_rad=numbers,
        roll_rad=numbers,
        pitch_rad=numbers,
        vx_mps=numbers,
        vy_mps=numbers,
        vz_mps=numbers,
    ),
)


@compiled
@given(
    mode=st.sampled_from(list(IN_MODE)),
    ticks=st.lists(nasty_ticks, min_size=1, max_size=5),
    law=st.sampled_from(["paper", "smooth"]),
    speed_law=st.sampled_from(["paper", "governor"]),
    choice=st.sampled_from(["coin", "frontier"]),
    dt_s=st.sampled_from([0.05, 1.0, 100.0]),
)
def test_a_setpoint_is_always_finite_and_within_its_limits(
    mode: Mode, ticks: list[tuple[Measurement, Pose]], law: str, speed_law: str, choice: str, dt_s: float
) -> None:
    """(2) and (3), in every mode and whatever comes in: what goes to the autopilot is a number that may be flown."""
    navigator = IN_MODE[mode](law=law, speed_law=speed_law, choice=choice)
    limits = navigator.parameters
    for i, (told, pose) in enumerate(ticks):
        setpoint = navigator.step(told, pose, i * dt_s)
        # Backward and to the side goes only what makes room, or is led back.
        assert -AWAY_MPS - 1e-9 <= setpoint.speed_mps <= limits.speed_mps
        assert abs(setpoint.lateral_mps) <= AWAY_MPS + 1e-9
        assert abs(setpoint.yaw_rate_radps) <= limits.max_yaw_rate_radps
        assert abs(setpoint.climb_mps) <= limits.max_climb_mps


def test_a_pose_beyond_all_bounds_is_no_crash() -> None:
    """A finite but absurd estimate has no cell in the known ground: it stops the vehicle as a NaN does."""
    navigator = in_boundary(1, choice="frontier")
    navigator.step(beside(1, edge_scan(-1)), replace(ORIGIN, y_m=5e18), 0.0)
    assert navigator.status.mode is Mode.HOLD
