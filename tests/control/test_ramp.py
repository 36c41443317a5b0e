"""The ramp: a commanded velocity never jumps up, and never waits to come down."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.control.navigator import Navigator
from companion.control.ramp import LONGEST_GAP_S, Ramp
from companion.model import Input, Mode, Setpoint
from tests.control.scene import Scene, box, fly, law_parameters, measurement
from tests.control.stages import ORIGIN, edge_scan

ACCEL_MPS2, DT_S = 1.0, 0.05
ROUNDING_MPS = 1e-9

wanted = st.builds(
    Setpoint,
    t_s=st.just(0.0),
    speed_mps=st.floats(-2.0, 2.0) | st.floats(),
    climb_mps=st.floats(-1.0, 1.0) | st.floats(),
    yaw_rate_radps=st.floats(-1.0, 1.0) | st.floats(),
)
gaps_s = st.floats(0.0, 0.6) | st.sampled_from([DT_S, 0.0, -1.0, 0.5, 0.501, 60.0, math.nan, math.inf])


def kept_mps(last: float, now: float) -> float:
    """What of the last velocity still goes the same way."""
    return abs(last) if math.copysign(1.0, last) == math.copysign(1.0, now) else 0.0


@given(ticks=st.lists(st.tuples(gaps_s, wanted), max_size=30), accel_mps2=st.floats(0.2, 5.0))
def test_it_never_grows_faster_never_brakes_later_and_is_always_a_number(
    ticks: list[tuple[float, Setpoint]], accel_mps2: float
) -> None:
    """The three promises to the gate and to the wall, whatever is asked for and however the ticks come."""
    ramp = Ramp(accel_mps2, DT_S)
    t_s, last = 0.0, Setpoint(-math.inf, 0.0, 0.0, 0.0)
    for gap_s, asked in ticks:
        t_s = t_s + gap_s if math.isfinite(t_s) else 0.0
        now = ramp.limit(replace(asked, t_s=t_s))
        passed_s = t_s - last.t_s
        rested = not passed_s <= LONGEST_GAP_S
        most_mps = accel_mps2 * (DT_S if rested else max(passed_s, 0.0))
        for want, before, after in (
            (asked.speed_mps, last.speed_mps, now.speed_mps),
            (asked.climb_mps, last.climb_mps, now.climb_mps),
        ):
            assert math.isfinite(after)
            assert abs(after) <= (0.0 if rested else kept_mps(before, after)) + most_mps + ROUNDING_MPS
            if not math.isfinite(want):
                assert after == 0.0
                continue
            assert abs(after) <= abs(want)
            assert after == 0.0 or math.copysign(1.0, after) == math.copysign(1.0, want)
            if not rested and abs(want) <= kept_mps(before, want):
                assert after == want
        assert now.yaw_rate_radps == (asked.yaw_rate_radps if math.isfinite(asked.yaw_rate_radps) else 0.0)
        last = now


def test_a_constant_wish_is_reached_in_a_straight_line() -> None:
    """0.5 m/s at 1 m/s² take ten periods, and then it is exactly what the law wants."""
    ramp = Ramp(ACCEL_MPS2, DT_S)
    speeds = [ramp.limit(Setpoint(DT_S * i, 0.5, -0.2, 0.6)).speed_mps for i in range(12)]
    assert speeds[:10] == pytest.approx([0.05 * (i + 1) for i in range(10)])
    assert speeds[10:] == [0.5, 0.5]


def test_it_stops_and_turns_round_at_once() -> None:
    """From climbing to sinking: zero is passed without waiting, and the way down begins there."""
    ramp = Ramp(ACCEL_MPS2, DT_S)
    for i in range(8):
        ramp.limit(Setpoint(DT_S * i, 0.4, 0.4, 0.0))
    turned = ramp.limit(Setpoint(DT_S * 8, 0.0, -0.4, 0.0))
    assert turned.speed_mps == 0.0
    assert turned.climb_mps == pytest.approx(-ACCEL_MPS2 * DT_S)


def test_after_a_pause_it_begins_at_rest() -> None:
    """Somebody else flew meanwhile, or the vehicle was held: what it was told before is not what it does."""
    ramp = Ramp(ACCEL_MPS2, DT_S)
    for i in range(20):
        ramp.limit(Setpoint(DT_S * i, 0.5, 0.0, 0.0))
    again_s = DT_S * 19 + LONGEST_GAP_S + 0.01
    assert ramp.limit(Setpoint(again_s, 0.5, 0.0, 0.0)).speed_mps == pytest.approx(ACCEL_MPS2 * DT_S)


def test_missed_ticks_are_made_good() -> None:
    """A tick that came late by four periods has their growth too: the vehicle is not slower for a busy computer."""
    ramp = Ramp(ACCEL_MPS2, DT_S)
    ramp.limit(Setpoint(0.0, 0.5, 0.0, 0.0))
    assert ramp.limit(Setpoint(5 * DT_S, 0.5, 0.0, 0.0)).speed_mps == pytest.approx(6 * ACCEL_MPS2 * DT_S)


def test_after_a_hold_the_navigator_begins_at_zero() -> None:
    """The whole law: an input was missing for one tick, and the speed before is not taken up where it was left."""
    navigator = Navigator(law_parameters(choice="coin", speed_law="paper"), np.random.default_rng(0))
    seen = measurement(edge_scan(1))
    speeds = [navigator.step(seen, ORIGIN, DT_S * i).speed_mps for i in range(15)]
    assert navigator.status.mode is Mode.TANGENT
    assert speeds[0] == pytest.approx(DT_S * navigator.parameters.max_accel_mps2)
    assert speeds[-1] == navigator.parameters.speed_mps
    assert navigator.step(replace(seen, missing=(Input.DEPTH,)), ORIGIN, DT_S * 15).speed_mps == 0.0
    assert navigator.step(seen, ORIGIN, DT_S * 16).speed_mps == pytest.approx(speeds[0])


@pytest.mark.parametrize("accel_mps2", [0.2, 1.0])
def test_a_flight_keeps_to_it(accel_mps2: float) -> None:
    """What the safety gate will check of every setpoint of a flight, with stops before walls in it."""
    navigator = Navigator(law_parameters(max_accel_mps2=accel_mps2), np.random.default_rng(3))
    track = fly(navigator, Scene(box(0.0, 0.0, 9.0, 6.0)), replace(ORIGIN, x_m=4.0, y_m=3.0), 60.0)
    speeds = np.array([setpoint.speed_mps for setpoint in track.setpoints])
    period_s = navigator.parameters.period_s
    assert speeds.max() == navigator.parameters.speed_mps
    assert np.diff(speeds, prepend=0.0).max() <= accel_mps2 * period_s + ROUNDING_MPS
